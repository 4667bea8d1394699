import assert from 'node:assert/strict';
import test from 'node:test';
import { darkNow } from '../static/lib/ambient.js';
import { driverDistance, driverSpeed } from '../static/lib/format.js';
import { pattern } from '../static/lib/sound.js';

test('distances and speeds in both systems', () => {
  assert.deepEqual(driverDistance(1250), ['1.25', 'm']);
  assert.deepEqual(driverDistance(340), ['34', 'cm']);
  assert.deepEqual(driverDistance(1250, 'imperial'), ['4.2', 'ft']);
  assert.deepEqual(driverDistance(340, 'imperial'), ['13', 'in']);
  assert.deepEqual(driverDistance(-180, 'imperial'), ['7', 'in']);
  assert.deepEqual(driverDistance(null, 'imperial'), ['–', '']);
  assert.deepEqual(driverSpeed(120), ['12', 'cm/s']);
  assert.deepEqual(driverSpeed(-254, 'imperial'), ['10', 'in/s']);
});

test('the screen is dark below 20 lx and bright above 60 lx, and keeps its state between', () => {
  assert.equal(darkNow(null, 5), true);
  assert.equal(darkNow(true, 40), true);
  assert.equal(darkNow(true, 61), false);
  assert.equal(darkNow(false, 40), false);
  assert.equal(darkNow(null, 40), false);
  assert.equal(darkNow(null, NaN), null);
});

test('sounds: stop is low and repeats while the truck moves, slow beeps faster the nearer it is', () => {
  assert.equal(pattern('STOP', 'halt', null, false).everyMs, null);
  assert.equal(pattern('STOP', 'halt', null, true).everyMs, 1000);
  assert.ok(pattern('SLOW', 'care', 50, true).everyMs < pattern('SLOW', 'care', 400, true).everyMs);
  assert.equal(pattern('SLOW', 'care', 9000, true).everyMs, 1200);
  assert.equal(pattern('OK', 'done', 0, false).hz.length, 3);
  assert.equal(pattern('WAIT', 'wait', null, false), null);
});

test('brake sounds unlike stop: high and low in turn, without a pause, whatever the speed', () => {
  const brake = pattern('BRAKE', 'halt', null, false);
  assert.deepEqual(brake.hz, [1000, 700, 1000, 700, 1000, 700]);
  assert.ok(brake.everyMs <= brake.hz.length * brake.lengthMs * 1.4);
  assert.deepEqual(pattern('BRAKE', 'halt', null, true), brake);
});
