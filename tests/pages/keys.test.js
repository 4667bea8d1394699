import assert from 'node:assert/strict';
import test from 'node:test';
import { allowed, applied, at, fallback, keysOf, matches, nodeAt, read, sections, shown, withChange } from '../static/setup/keys.js';

const SCHEMA = {
  properties: {
    site: { type: 'string', default: 'site1', pattern: '^[a-z0-9]{1,8}$', description: 'in topics' },
    mqtt: { anyOf: [{ $ref: '#/$defs/Mqtt' }, { type: 'null' }], default: null },
    vision: { $ref: '#/$defs/Vision', description: 'for every bay' },
    sinks: { $ref: '#/$defs/Sinks' },
    bays: { type: 'array', items: { $ref: '#/$defs/Bay' }, 'x-named-by': 'name' },
  },
  $defs: {
    Mqtt: { type: 'object', required: ['url'], properties: { url: { type: 'string' }, tls: { anyOf: [{ $ref: '#/$defs/Tls' }, { type: 'null' }] } } },
    Tls: { type: 'object', properties: { ca_file: { anyOf: [{ type: 'string' }, { type: 'null' }], default: null } } },
    Vision: { type: 'object', properties: { coast_s: { type: 'number', minimum: 0, maximum: 10, default: 0.3 } } },
    Sinks: { type: 'object', properties: {} },
    Bay: { type: 'object', properties: { name: { type: 'string' }, unit_id: { type: 'integer', default: 1 }, vision: { $ref: '#/$defs/Vision' } } },
  },
};
const WRITTEN = { site: 'a', vision: { coast_s: 0.5 }, bays: { A: { name: 'A' }, B: { name: 'B', unit_id: 2, vision: { coast_s: 1 } } } };

test('sections: the gateway, what holds for every bay, each bay, the tables', () => {
  assert.deepEqual(sections(SCHEMA, WRITTEN).map((one) => one.title), ['gateway', 'every bay', 'A', 'B', 'mqtt']);
  assert.deepEqual(sections(SCHEMA, {}).map((one) => one.title), ['gateway', 'every bay', 'bay1', 'mqtt']);
  assert.deepEqual(keysOf(SCHEMA, [], WRITTEN)[0].keys.map((one) => one.path), [['site']]);
  assert.deepEqual(keysOf(SCHEMA, ['bays', 'B'], WRITTEN)[0].keys.map((one) => one.path.at(-1)), ['name', 'unit_id']);
});

test('a table that is not there can be added, and has its keys then', () => {
  assert.deepEqual(keysOf(SCHEMA, ['mqtt'], WRITTEN).map((one) => one.absent), [true]);
  const groups = keysOf(SCHEMA, ['mqtt'], { ...WRITTEN, mqtt: {} });
  assert.deepEqual(groups.map((one) => [one.path.join('.'), Boolean(one.absent)]), [['mqtt', false], ['mqtt.tls', true]]);
  assert.equal(groups[0].keys[0].required, true);
});

test('where a value comes from', () => {
  assert.deepEqual(fallback(SCHEMA, WRITTEN, ['bays', 'A', 'vision', 'coast_s']), { value: 0.5, from: 'every bay' });
  assert.deepEqual(fallback(SCHEMA, {}, ['bays', 'A', 'vision', 'coast_s']), { value: 0.3, from: 'default' });
  assert.deepEqual(fallback(SCHEMA, WRITTEN, ['mqtt', 'tls', 'ca_file']), { value: null, from: 'default' });
});

test('changes: one for each key, none where the file says so already', () => {
  const one = withChange([], WRITTEN, ['site'], 'b');
  assert.deepEqual(one, [{ path: ['site'], value: 'b' }]);
  assert.deepEqual(withChange(one, WRITTEN, ['site'], 'c'), [{ path: ['site'], value: 'c' }]);
  assert.deepEqual(withChange(one, WRITTEN, ['site'], 'a'), []);
  const added = withChange(withChange([], WRITTEN, ['mqtt'], {}), WRITTEN, ['mqtt', 'url'], 'x');
  assert.deepEqual(at(applied(WRITTEN, added), ['mqtt', 'url']), 'x');
  assert.deepEqual(withChange(added, WRITTEN, ['mqtt'], null), []);
  assert.deepEqual(Object.keys(applied(WRITTEN, [{ path: ['bays', 'A'], value: null }]).bays), ['B']);
  assert.equal(WRITTEN.bays.A.name, 'A');
});

test('what is typed is read, or refused with what is allowed', () => {
  const seconds = nodeAt(SCHEMA, ['bays', 'B', 'vision', 'coast_s']);
  assert.deepEqual(read(seconds, ' 1,5 '), { value: 1.5 });
  assert.deepEqual(read(seconds, '11'), { wrong: 'allowed: 0 to 10' });
  assert.ok(read(seconds, '').wrong);
  assert.ok(read(nodeAt(SCHEMA, ['bays', 'A', 'unit_id']), '1.5').wrong);
  assert.ok(read(nodeAt(SCHEMA, ['site']), 'Not This').wrong);
  assert.deepEqual(read({ type: 'array', items: { type: 'string' } }, 'a b\n\n c '), { value: ['a b', 'c'] });
  const colour = { type: 'array', minItems: 3, maxItems: 3, prefixItems: [{ type: 'integer' }] };
  assert.deepEqual(read(colour, '0, 43;46'), { value: [0, 43, 46] });
  assert.deepEqual(read(colour, '0, 43'), { wrong: '3 values are expected' });
  assert.equal(shown(colour, [0, 43, 46]), '0, 43, 46');
  assert.equal(allowed(seconds), '0 to 10');
});

test('the search looks for all words in name and meaning', () => {
  const one = { path: ['mqtt', 'url'], node: { description: 'The broker' } };
  assert.equal(matches(one, 'broker url'), true);
  assert.equal(matches(one, 'broker port'), false);
  assert.equal(matches(one, 'Adresse', () => 'Adresse des Brokers'), true);
});
