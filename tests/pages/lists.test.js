import assert from 'node:assert/strict';
import test from 'node:test';
import { use } from '../static/lib/lang.js';
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

test('an event in the viewer’s language, found by its words and by the English ones', () => {
  use('de', { name: 'Deutsch', direction: 'ltr', texts: { vision: 'Kamera', 'link down': 'keine Verbindung', 'sensor fault': 'Sensorfehler', 'by {0}': 'von {0}' } });
  const event = { ...EVENT, kind: 'sensor_fault', sensor: 'vision', quality: { name: 'LINK_DOWN' }, detail: 'unplugged', write: null };
  assert.equal(eventText(event), 'Kamera · keine Verbindung · unplugged');
  assert.equal(eventText(EVENT), 'recipe_select: 0 → 2 · von 10.0.0.5');
  for (const wanted of ['sensorfehler kamera', 'keine verbindung', 'sensor fault', 'vision link down']) assert.equal(matches(event, 'all', wanted), true, wanted);
  assert.equal(matches(event, 'all', 'sprache'), false);
  use('en', { name: 'English', direction: 'ltr', texts: {} });
});

test('what an event adds to its kind', () => {
  assert.equal(eventText(EVENT), 'recipe_select: 0 → 2 · by 10.0.0.5');
  assert.equal(eventText({ ...EVENT, kind: 'stop_raised', write: null, reason: { name: 'NO_TARGET', text: '' } }), 'no marker in sight');
  assert.equal(eventText({ ...EVENT, kind: 'stop_raised', write: null, reason: { name: 'NEW', text: 'something new' } }), 'something new');
  assert.equal(eventText({ ...EVENT, kind: 'sensor_fault', write: null, sensor: 'vision', quality: { name: 'STALE' }, detail: 'no result' }), 'vision · stale · no result');
});
