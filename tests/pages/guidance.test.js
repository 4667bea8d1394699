import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import test from 'node:test';
import { CODES, WITH_AMOUNT, column, driverView, wordOf } from '../static/lib/guidance.js';
import { PATHS } from '../static/lib/symbols.js';

const GOOD = { bay: 'bay1', code: 'WAIT', text: '', stop: true, amount_mm: null, closing_mm_s: -3.5, to_go_mm: 10, age_ms: 20 };
const told = (change) => driverView(JSON.stringify({ ...GOOD, ...change }), 'bay1');
// Written by the test that runs this: the names of gateway.core.state.GuidanceCode.
const NAMES = JSON.parse(readFileSync(new URL('../codes.json', import.meta.url), 'utf8'));

test('every code of the gateway has a sign and a kind', () => {
  assert.deepEqual(Object.keys(CODES).sort(), [...NAMES].sort());
  for (const [code, { symbol, kind }] of Object.entries(CODES)) {
    assert.ok(PATHS[symbol], `${code}: ${symbol}`);
    assert.ok(['go', 'care', 'halt', 'wait', 'done'].includes(kind));
  }
  for (const code of WITH_AMOUNT) assert.ok(CODES[code]);
});

test('a fault looks like STOP: same sign, same colour', () => {
  assert.deepEqual([CODES.FAULT.symbol, CODES.FAULT.kind], [CODES.STOP.symbol, CODES.STOP.kind]);
  assert.equal(wordOf('FAULT'), wordOf('STOP'));
  assert.equal(CODES.TOO_FAR.kind, 'halt');
});

test('a whole message is taken, whatever else it says', () => {
  assert.equal(told({}).code, 'WAIT');
  assert.equal(told({ new_field: 1 }).closing_mm_s, -3.5);
  assert.equal(driverView(JSON.stringify(GOOD), null).bay, 'bay1');
});

test('what makes no sense is no message', () => {
  for (const text of ['', '{', 'null', '7', '[]', '"STOP"']) assert.equal(driverView(text, 'bay1'), null, text);
  for (const change of [
    { bay: 'bay2' }, { bay: null }, { code: 'GO' }, { code: 'toString' }, { code: 1 }, { stop: null }, { stop: 'false' }, { stop: 0 },
    { age_ms: null }, { language: 7 }, { age_ms: -1 }, { age_ms: '20' }, { amount_mm: '3' }, { to_go_mm: undefined }, { closing_mm_s: true },
  ]) assert.equal(told(change), null, JSON.stringify(change));
});

test('while stop is on, nothing tells the truck to come nearer or to leave, whatever the message says', () => {
  for (const code of ['FORWARD', 'SLOW', 'LEFT', 'RIGHT', 'LEAVE', 'DRIVE_UP']) {
    assert.equal(told({ code, stop: true }), null);
    assert.equal(told({ code, stop: false }).code, code);
  }
  for (const code of ['BACK', 'STOP', 'OK', 'TOO_FAR', 'FAULT', 'WAIT']) assert.equal(told({ code, stop: true }).code, code);
});

test('the column: far at its foot, the stopping place at the line, past it above', () => {
  const { line } = column(0);
  assert.equal(column(3000).at, 0);
  assert.equal(column(9000).at, 0);
  assert.equal(column(0).at, line);
  assert.equal(column(0).past, false);
  assert.ok(column(100).at < line && column(-100).at > line && column(-100).past);
  assert.equal(column(-9000).at, 1);
  assert.equal(column(null).at, null);
});
