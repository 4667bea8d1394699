import assert from 'node:assert/strict';
import test from 'node:test';
import { shortWhy, why } from '../static/lib/reasons.js';

const FREE = { rolling: false, in_place: false, held: false, stop: false, may_move: true, phase: 'EMPTY', reason: { name: 'NONE', text: '' }, guidance: { name: 'FORWARD' } };
const said = (change) => [shortWhy({ ...FREE, ...change }), why({ ...FREE, ...change })];

test('a truck that may move: by the phase of its visit', () => {
  assert.deepEqual(said({ phase: 'ARRIVING' }), ['drives up', 'A truck arrives. It may drive up; it is still too far away for the distance sensor.']);
  assert.match(said({ phase: 'APPROACHING' }).join(': '), /^approaches: The truck may drive on to the /);
  assert.deepEqual(said({ phase: 'RELEASED' }), ['released', 'Released: the truck may leave.']);
  assert.deepEqual(said({ phase: 'LEAVING' }), ['leaves', 'The truck is on its way out.']);
  assert.deepEqual(said({}), ['may move', 'Nothing stops the truck: it may drive.']);
});

test('no stop, and it may not move: somebody withholds it', () => {
  assert.deepEqual(said({ may_move: false }), ['withheld', 'Nothing stops the truck, but it may not drive yet: the PLC or a technician withholds it.']);
});

const REACHED = { stop: true, may_move: false, reason: { name: 'TARGET_REACHED', text: '' } };

test('too far in: it must go back once it stands', () => {
  assert.deepEqual(said({ ...REACHED, guidance: { name: 'BACK' } }), ['too far in', 'The truck stands too far in: it must go back.']);
  assert.deepEqual(said({ ...REACHED, guidance: { name: 'TOO_FAR' } }), ['too far in', 'The truck is too far in and still moving: it must stop.']);
  assert.match(said({ ...REACHED, guidance: { name: 'STOP' } })[1], /It is in place once it has stood still/);
  const blind = { ...REACHED, reason: { name: 'NO_TARGET', text: '' }, guidance: { name: 'BACK' } };
  assert.equal(said(blind)[0], 'no marker in sight');
});

test('in place: loading may start or go on, unless the truck rolls', () => {
  const placed = { ...REACHED, in_place: true };
  assert.deepEqual(said(placed), ['loading may start', 'Loading may start.']);
  assert.deepEqual(said({ ...placed, held: true }), ['held, marker covered', 'In place: loading may go on. The marker is covered; the distance shows that the truck stands still.']);
  assert.equal(said({ ...FREE, rolling: true, phase: 'LEAVING' })[0], 'leaves'); // where no PLC releases trucks
  const blind = { stop: true, may_move: false, reason: { name: 'CAMERA_DOWN', text: '' }, guidance: { name: 'FAULT' } };
  assert.equal(said({ ...blind, rolling: true })[0], 'no camera');
  assert.deepEqual(said({ ...placed, held: true, rolling: true, guidance: { name: 'BRAKE' } }), ['TRUCK ROLLS', 'The truck rolls: if it is being loaded, stop loading and raise the spout.']);
});

test('nothing known, and a reason that this page does not know', () => {
  assert.deepEqual([shortWhy(null), why(null)], ['nothing known', 'Nothing new from the gateway: treat the bay as STOP.']);
  assert.deepEqual(said({ stop: true, reason: { name: 'NEW_REASON', text: 'in its own words' } }), ['new reason', 'in its own words']);
});
