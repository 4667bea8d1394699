import assert from 'node:assert/strict';
import test from 'node:test';
import { NONE, age, clock, driverDistance, number, px, signed, words } from '../static/lib/format.js';

const N = '\u202f';

test('no value is a dash, never 0', () => {
  for (const none of [null, undefined, NaN, Infinity, '7']) assert.equal(number(none, 1, 'px'), NONE);
  assert.equal(px(null), NONE);
  assert.equal(age(null), NONE);
  assert.deepEqual(driverDistance(null), [NONE, '']);
});

test('numbers: decimals, groups, a real minus, no minus zero', () => {
  assert.equal(number(1234.56, 1, 'px'), `1234.6${N}px`);
  assert.equal(number(12345), `12${N}345`);
  assert.equal(number(1234567.25, 2), `1${N}234${N}567.25`);
  assert.equal(number(-3), '\u22123');
  assert.equal(number(-0.01, 1), '0.0');
});

test('signed numbers show both signs, and none for what rounds to 0', () => {
  assert.equal(signed(12, 0, 'px'), `+12${N}px`);
  assert.equal(signed(-12), '\u221212');
  assert.equal(signed(0.2), '0');
});

test('ages go from ms to days without a jump at the borders', () => {
  assert.equal(age(0), `0${N}ms`);
  assert.equal(age(-5), `0${N}ms`);
  assert.equal(age(999.4), `999${N}ms`);
  assert.equal(age(999.6), `1.0${N}s`);
  assert.equal(age(59_949), `59.9${N}s`);
  assert.equal(age(59_951), `1${N}min 0${N}s`);
  assert.equal(age(3_600_000), `1${N}h 0${N}min`);
  assert.equal(age(49 * 3_600_000), `2${N}d`);
});

test('the driver reads metres far away and whole centimetres near, in steps', () => {
  assert.deepEqual(driverDistance(2480), ['2.50', 'm']);
  assert.deepEqual(driverDistance(994), ['99', 'cm']);
  assert.deepEqual(driverDistance(995), ['1.00', 'm']);
  assert.deepEqual(driverDistance(-234), ['23', 'cm']);
});

test('times of day, and names of the wire as words', () => {
  const at = new Date(2026, 10, 21, 7, 5, 9, 42).getTime();
  assert.equal(clock(at), '07:05:09');
  assert.equal(clock(at, { ms: true }), '07:05:09.042');
  assert.equal(clock(at, { date: true }), '2026-11-21 07:05:09');
  assert.equal(words('NO_TARGET'), 'no target');
});
