import assert from 'node:assert/strict';
import test from 'node:test';
import { eventText, matches } from '../static/operator/eventwords.js';

const EVENT = {
  kind: 'plc_write', bay: 'bay1', sensor: null, quality: null, detail: '', reason: { name: 'NONE', text: 'stop is off' },
  write: { address: '10.0.0.5', subject: '', role: '', name: 'recipe_select', old: 0, new: 2 },
};

test('the filter: by group, and by all the words', () => {
  assert.equal(matches(EVENT, 'all', ''), true);
  assert.equal(matches(EVENT, 'plc', ''), true);
  assert.equal(matches(EVENT, 'sensors', ''), false);
  assert.equal(matches(EVENT, 'all', 'PLC write'), true);
  assert.equal(matches(EVENT, 'all', 'recipe 10.0.0.5'), true);
  assert.equal(matches(EVENT, 'all', 'plc nothing'), false);
  assert.equal(matches({ ...EVENT, kind: 'settings_changed' }, 'service', ''), true);
});

test('what an event adds to its kind', () => {
  assert.equal(eventText(EVENT), 'recipe_select: 0 → 2 · by 10.0.0.5');
  assert.equal(eventText({ ...EVENT, kind: 'stop_raised', write: null, reason: { name: 'NO_TARGET', text: 'no marker' } }), 'no marker');
  assert.equal(eventText({ ...EVENT, kind: 'sensor_fault', write: null, sensor: 'vision', quality: { name: 'STALE' }, detail: 'no result' }), 'vision · stale · no result');
});
