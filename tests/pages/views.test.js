import assert from 'node:assert/strict';
import test from 'node:test';
import { waitMs } from '../static/lib/live.js';
import { WIDTHS, widthFor } from '../static/lib/pictures.js';
import {
  decisionWords, frameSize, frameView, inOrder, mayAcknowledge, movedWords, pictureHealth, placeWords, plcHealth, rangeHealth, scaleWords, standing, urgency,
  visionHealth,
} from '../static/lib/views.js';

const state = (vision, range = 'GOOD', link = 'ALIVE') => ({
  stop: false, may_move: true, ne107: { name: 'GOOD' }, plc: { link }, vision: { quality: { name: vision } }, range: { quality: { name: range } },
});

test('a frame: what was seen, and nothing of what makes no sense', () => {
  const seen = frameView({ quality: 'GOOD', circle: { u: 1, v: 2, radius_px: 3 }, predicted: null, ellipse: { u: 1, v: 2, semi_major_px: 3, semi_minor_px: 2, angle_rad: 0.1 } });
  assert.deepEqual(seen.circle, { u: 1, v: 2, radius: 3 });
  assert.equal(seen.ellipse.major, 3);
  assert.equal(frameView({ circle: { u: 1, v: null, radius_px: 3 } }).circle, null);
  assert.equal(frameView({ ellipse: { u: 1 } }).ellipse, null);
});

test('the size of a frame', () => {
  assert.deepEqual(frameSize('640x480'), { width: 640, height: 480 });
  for (const nonsense of [null, '', '0x480', '640', 'axb', '640x480x3']) assert.equal(frameSize(nonsense), null);
});

test('an empty bay is in order; a camera that is gone is not', () => {
  assert.deepEqual([visionHealth(state('NO_TARGET')), rangeHealth(state('NO_TARGET', 'NO_ECHO'))], ['ok', 'ok']);
  assert.equal(rangeHealth({ ...state('GOOD', 'NO_ECHO'), may_move: false }), 'warn');
  assert.equal(rangeHealth(state('GOOD', 'NO_ECHO')), 'ok', 'a truck arrives from beyond its range');
  for (const bad of ['STALE', 'LINK_DOWN', 'PROCESS_FAULT', 'SOMETHING_NEW']) assert.equal(visionHealth(state(bad)), 'bad');
  for (const bad of ['STALE', 'LINK_DOWN', 'STUCK', 'WRONG_VERSION', 'SOMETHING_NEW']) assert.equal(rangeHealth(state('GOOD', bad)), 'bad');
  assert.deepEqual(['ALIVE', 'UNUSED', 'WAITING', 'LOST', 'NEW'].map((link) => plcHealth(state('GOOD', 'GOOD', link))), ['ok', 'off', 'off', 'bad', 'bad']);
});

test('nothing known is never leave to move', () => {
  assert.equal(decisionWords(null), 'NOT KNOWN');
  assert.equal(decisionWords({ stop: true, may_move: false }), 'STOP');
  assert.equal(decisionWords({ stop: true, may_move: true }), 'STOP');
  assert.equal(decisionWords({ stop: true, may_move: false, in_place: true }), 'IN PLACE');
  assert.equal(decisionWords({ stop: false, may_move: true, in_place: true }), 'MAY MOVE', 'in place is never without stop');
  assert.equal(decisionWords({ stop: false, may_move: true }), 'MAY MOVE');
  assert.equal(decisionWords({ stop: false, may_move: false }), 'NO STOP, MAY NOT MOVE');
});

test('in place: seen or held, and since when', () => {
  const there = { in_place: true, held: false, in_place_ms: 125_000, held_ms: null };
  assert.equal(placeWords(null), '–');
  assert.equal(placeWords({ ...there, in_place: false }), 'no');
  assert.equal(placeWords(there), 'yes, seen 2\u202fmin 5\u202fs');
  assert.equal(placeWords({ ...there, held: true, held_ms: 35_000 }), 'yes, held 35.0\u202fs');
});

test('moved: never shown as no by mistake', () => {
  assert.deepEqual(['NO', 'DISTANCE', 'MARKER', 'NEW'].map((moved) => movedWords({ moved })), ['no', 'yes, by distance', 'yes, marker elsewhere', 'yes']);
  assert.equal(movedWords(null), '–');
});

test('what was learned of R times Z', () => {
  assert.equal(scaleWords(null), null);
  assert.equal(scaleWords(undefined), null);
  const scale = { px_mm: 56_000.4, spread: 0.0123, visits: 12, newest_ms: new Date(2026, 10, 2, 12).getTime(), jump: null };
  assert.deepEqual(scaleWords(scale), { value: '56\u202f000\u202fpx mm', rest: 'spread 1.2\u202f%, 12 visits, newest 2026-11-02', jump: '' });
  assert.equal(scaleWords({ ...scale, jump: -0.125 }).jump, 'newest differs by \u221213\u202f%');
});

test('bays in trouble come first; the rest as people count', () => {
  const ne107 = (name) => ({ ...state('GOOD'), ne107: { name } });
  const row = (name, value, alarms = 0) => ({ name, rank: urgency(value, alarms) });
  const bays = [row('bay10', ne107('GOOD')), row('bay2', ne107('GOOD')), row('bay3', ne107('MAINTENANCE_REQUIRED')), row('bay4', ne107('FAILURE')),
    row('bay5', null), row('bay6', ne107('GOOD'), 1), row('bay7', ne107('FUNCTION_CHECK')), row('bay8', ne107('OUT_OF_SPECIFICATION')), row('bay9', ne107('NEW'))];
  assert.deepEqual(inOrder(bays).map(({ name }) => name), ['bay5', 'bay9', 'bay4', 'bay7', 'bay8', 'bay6', 'bay3', 'bay2', 'bay10']);
});

test('who may acknowledge: somebody with a name, unless everybody is a technician', () => {
  assert.equal(mayAcknowledge({ role: 'viewer', name: null }), false);
  assert.equal(mayAcknowledge({ role: 'viewer', name: 'anna' }), true);
  assert.equal(mayAcknowledge({ role: 'technician', name: null }), true);
  assert.equal(mayAcknowledge({ role: 'driver', name: null }), false);
  assert.deepEqual(['normal', 'unacknowledged', 'acknowledged', 'returned', 'shelved', 'suppressed'].map((s) => standing({ state: s })), [false, true, true, true, false, false]);
});

test('a lost server is asked again soon, then less often, never all pages at once', () => {
  assert.equal(waitMs(0, 0.5), 0);
  assert.equal(waitMs(1, 0), 250);
  assert.equal(waitMs(50, 0), 4000);
  assert.ok(waitMs(50, 0.999) < 4000 && waitMs(50, 0.999) > 2600);
});

test('few widths of pictures, so that viewers share them', () => {
  assert.equal(widthFor(300, 1), 320);
  assert.equal(widthFor(640, 1), 640);
  assert.equal(widthFor(700, 1), 640); // a tenth of enlargement is not seen
  assert.equal(widthFor(500, 2), 960);
  assert.equal(widthFor(9000, 3), WIDTHS[WIDTHS.length - 1]);
});

test('the picture itself: in order, what is wrong with it, or not known', () => {
  assert.deepEqual(pictureHealth({ picture: null }), { state: 'off', text: 'not known' });
  assert.deepEqual(pictureHealth({}), { state: 'off', text: 'not known' });
  assert.deepEqual(pictureHealth({ picture: { faults: [] } }), { state: 'ok', text: 'in order' });
  assert.deepEqual(pictureHealth({ picture: { faults: ['BLURRED', 'SHIFTED'] } }), { state: 'warn', text: 'blurred, shifted' });
});
