import assert from 'node:assert/strict';
import test from 'node:test';
import { between, every, isDay, plus, spans, weekday } from '../static/lib/days.js';

test('days of the calendar have no zone', () => {
  assert.equal(plus('2026-03-28', 1), '2026-03-29');
  assert.equal(plus('2026-03-29', 1), '2026-03-30');
  assert.equal(plus('2026-01-01', -1), '2025-12-31');
  assert.equal(plus('2028-02-28', 1), '2028-02-29');
  assert.equal(weekday('2026-11-23'), 'Mon');
  assert.equal(weekday('2026-11-22'), 'Sun');
  assert.equal(between('2026-11-23', '2026-11-23'), 1);
  assert.equal(between('2026-10-01', '2026-10-31'), 31);
});

test('only real days of this century are asked for', () => {
  for (const right of ['2026-11-23', '2028-02-29', '2000-01-01']) assert.ok(isDay(right), right);
  for (const wrong of [null, undefined, '', '2026-02-29', '2026-13-01', '1999-12-31', '2026-1-1', '2026-11-23T00:00', 'today']) assert.ok(!isDay(wrong), String(wrong));
});

test('the spans that people ask for end today, or with a whole month', () => {
  const found = Object.fromEntries(spans('2026-03-01').map(([name, first, last]) => [name, [first, last]]));
  assert.deepEqual(found, {
    Today: ['2026-03-01', '2026-03-01'],
    Yesterday: ['2026-02-28', '2026-02-28'],
    '7 days': ['2026-02-23', '2026-03-01'],
    '28 days': ['2026-02-02', '2026-03-01'],
    'This month': ['2026-03-01', '2026-03-01'],
    'Last month': ['2026-02-01', '2026-02-28'],
  });
});

test('as many labels as there is room for, the last of them always', () => {
  const drawn = (count, room) => Array.from({ length: count }, (_, at) => at).filter(every(count, room));
  assert.deepEqual(drawn(7, 16), [0, 1, 2, 3, 4, 5, 6]);
  assert.deepEqual(drawn(8, 4), [1, 3, 5, 7]);
  assert.equal(drawn(92, 16).length, 16);
  assert.equal(drawn(92, 16).at(-1), 91);
  assert.deepEqual(drawn(1, 0), [0]);
});
