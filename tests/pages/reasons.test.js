import assert from 'node:assert/strict';
import test from 'node:test';
import { REASONS, why } from '../static/lib/reasons.js';

const FREE = { rolling: false, in_place: false, held: false, stop: false, may_move: true, phase: 'EMPTY', reason: { name: 'NONE', text: '' }, guidance: { name: 'FORWARD' } };
const said = (change) => why({ ...FREE, ...change });

test('a truck that may move: by the phase of its visit', () => {
  assert.equal(said({ phase: 'ARRIVING' }), 'A truck arrives. It may drive up; it is still too far away for the distance sensor.');
  assert.equal(said({ phase: 'APPROACHING' }), 'The truck may drive on to the mark.');
  assert.equal(said({ phase: 'RELEASED' }), 'Released: the truck may leave.');
  assert.equal(said({ phase: 'LEAVING' }), 'The truck is on its way out.');
  assert.equal(said({}), 'Nothing stops the truck: it may drive.');
});

test('no stop, and it may not move: somebody withholds it', () => {
  assert.equal(said({ may_move: false }), 'Nothing stops the truck, but it may not drive yet: the PLC or a technician withholds it.');
});

const REACHED = { stop: true, may_move: false, reason: { name: 'TARGET_REACHED', text: '' } };

test('too far in: it must go back once it stands', () => {
  assert.equal(said({ ...REACHED, guidance: { name: 'BACK' } }), 'The truck stands too far in: it must go back.');
  assert.equal(said({ ...REACHED, guidance: { name: 'TOO_FAR' } }), 'The truck is too far in and still moving: it must stop.');
  assert.match(said({ ...REACHED, guidance: { name: 'STOP' } }), /It is in place once it has stood still/);
  const blind = { ...REACHED, reason: { name: 'NO_TARGET', text: '' }, guidance: { name: 'BACK' } };
  assert.match(said(blind), /^The camera sees no marker/);
});

test('in place: loading may start or go on, unless the truck rolls', () => {
  const placed = { ...REACHED, in_place: true };
  assert.equal(said(placed), 'Loading may start.');
  assert.equal(said({ ...placed, held: true }), 'In place: loading may go on. The marker is covered; the distance shows that the truck stands still.');
  assert.equal(said({ ...FREE, rolling: true, phase: 'LEAVING' }), 'The truck is on its way out.'); // where no PLC releases trucks
  const blind = { stop: true, may_move: false, reason: { name: 'CAMERA_DOWN', text: '' }, guidance: { name: 'FAULT' } };
  assert.equal(said({ ...blind, rolling: true }), REASONS.CAMERA_DOWN[1]);
  assert.equal(said({ ...placed, held: true, rolling: true, guidance: { name: 'BRAKE' } }), 'The truck rolls: if it is being loaded, stop loading and raise the spout.');
});

test('nothing known, and a reason that this page does not know', () => {
  assert.equal(why(null), 'Nothing new from the gateway: treat the bay as STOP.');
  assert.equal(said({ stop: true, reason: { name: 'NEW_REASON', text: 'in its own words' } }), 'in its own words');
});
