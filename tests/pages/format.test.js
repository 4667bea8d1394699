import assert from 'node:assert/strict';
import test from 'node:test';
import { stampOf } from '../static/lib/days.js';
import { NONE, age, clock, day, driverDistance, number, px, signed, stamp, words } from '../static/lib/format.js';
import { learnZone, unixOf, zoneText } from '../static/lib/zone.js';

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

test('times are of the zone of the gateway, also over a change of its clocks', () => {
  learnZone('Europe/Berlin');
  const [winter, summer] = [Date.UTC(2026, 0, 15, 11), Date.UTC(2026, 6, 1, 6, 0, 0, 7)];
  assert.deepEqual([zoneText(winter), zoneText(summer)], ['Europe/Berlin, UTC+1', 'Europe/Berlin, UTC+2']);
  // The last second of a day of 23 hours, and the first of the next.
  const midnight = Date.UTC(2026, 2, 29, 22);
  assert.deepEqual([midnight - 1000, midnight].map(day), ['2026-03-29', '2026-03-30']);
  assert.deepEqual([Date.UTC(2026, 2, 29, 0, 59, 59), Date.UTC(2026, 2, 29, 1)].map((at) => clock(at)), ['01:59:59', '03:00:00']);
  assert.equal(stamp(winter, { nowMs: winter }), '2026-01-15 12:00:00'); // as the page names it
  assert.equal(stamp(summer, { nowMs: winter, ms: true }), '2026-07-01 08:00:00.007 UTC+2');
  assert.equal(stamp(null), NONE);
  assert.equal(stampOf('2026-01-15T12:00:00+01:00', { nowMs: winter }), '2026-01-15 12:00:00');
  assert.equal(stampOf('2026-01-15 12:00:00.500+01:00', { nowMs: winter, ms: true }), '2026-01-15 12:00:00.500');
  assert.equal(stampOf(null), NONE);
  // As a field of the page has it, and back.
  for (const at of [winter, summer - 7, midnight, Date.UTC(2026, 2, 29, 0, 59, 59)]) assert.equal(unixOf(clock(at, { date: true }).replace(' ', 'T')), at);
  assert.ok(Number.isNaN(unixOf('')));
  learnZone('Asia/Kathmandu');
  assert.equal(zoneText(winter), 'Asia/Kathmandu, UTC+5:45');
  learnZone('Nowhere/Never');
  learnZone('');
  assert.equal(zoneText(winter), 'Asia/Kathmandu, UTC+5:45');
  learnZone('UTC');
  assert.equal(zoneText(winter), 'UTC');
});
