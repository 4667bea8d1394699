import assert from 'node:assert/strict';
import test from 'node:test';
import { momentOf, verdict, abnormal, abnormalEvent, bucketAt, bucketText, columns, faultsText, firstScale, frameMs, hashOf, pictureAt, placeOf, spanOf, stopOf, usual, windowAt } from '../static/lib/history.js';

const MIN = 60_000;
const bucket = (t_ms, more = {}) => ({ t_ms, recorded_s: 60, may_move_s: 0, in_place_s: 0, stop_s: {}, r_min: null, r_mean: null, r_max: null, z_min: null, z_mean: null, z_max: null, ...more });

test('no line goes across what was not recorded', () => {
  const buckets = [bucket(0, { r_mean: 5 }), bucket(MIN, { r_mean: 6 }), bucket(5 * MIN, { r_mean: 7 })];
  const [t, mean] = columns(buckets, MIN, ['r_mean']);
  assert.deepEqual(t, [0, 60, 119.999, 120, 300, 359.999]);
  assert.deepEqual(mean, [5, 6, 6, null, 7, 7]);
  assert.deepEqual(columns([], MIN, ['r_mean', 'z_mean']), [[], [], []]);
  assert.deepEqual(columns([bucket(0)], MIN, ['r_mean'])[1], [null, null]);
});

test('the bucket of a moment, and none in a gap', () => {
  const buckets = [bucket(0), bucket(MIN), bucket(5 * MIN)];
  const found = [-1, 0, MIN - 1, MIN, 2 * MIN, 5 * MIN, 6 * MIN - 1, 6 * MIN].map((at) => bucketAt(buckets, MIN, at)?.t_ms ?? null);
  assert.deepEqual(found, [null, 0, 0, MIN, null, 5 * MIN, 5 * MIN, null]);
  assert.equal(bucketAt([], MIN, 5), null);
});

test('a bucket in words says what was not recorded', () => {
  assert.equal(bucketText(null, MIN), 'nothing recorded');
  const full = bucketText(bucket(0, { r_min: 100, r_mean: 154.5, r_max: 180, may_move_s: 30, stop_s: { target_reached: 20, vision_stale: 10 } }), MIN);
  assert.match(full, /R 100 to 180.px, mean 15[45]/);
  assert.match(full, /Z –/);
  assert.match(full, /may move 30.s/);
  assert.match(full, /stop 20.s \(target reached\), 10.s \(vision stale\)/);
  assert.doesNotMatch(full, /not recorded/);
  assert.match(bucketText(bucket(0, { recorded_s: 15 }), MIN), /not recorded 45.s/);
});

test('stop for a fault is told from stop in place', () => {
  assert.deepEqual(stopOf(bucket(0, { stop_s: { target_reached: 20, vision_stale: 10, plc_lost: 1 } })), { all: 31, fault: 11 });
  assert.ok(abnormal('sensor_fault') && abnormal('ranger_down') && abnormal('moved'));
  const left = { begun_ms: 1000, length_s: 60, unintended: false, faults: [], interrupted: false, to_position_s: 9, end: 'clear' };
  const rolled = { ...left, begun_ms: 100_000, unintended: true };
  const bad = (t_ms, kind = 'moved') => abnormalEvent({ t_ms, kind }, [left, rolled]);
  assert.deepEqual([bad(30_000), bad(130_000), bad(130_000, 'rolling'), bad(90_000), bad(0, 'sensor_fault')], [false, true, true, false, true]);
  assert.deepEqual([left, rolled, { ...left, to_position_s: null }, { ...left, end: 'gateway_off' }].map(usual), [true, false, false, false]);
  assert.ok(!abnormal('operator_mark') && !abnormal('no_target') && !abnormal('start'));
});

test('the address of a moment goes both ways, and nonsense is left out', () => {
  const place = { bay: 'bay 1/x', atMs: 1795400040000, scale: 'hour', why: false };
  assert.deepEqual(placeOf(hashOf(place), ['bay 1/x']), place);
  assert.deepEqual(placeOf('', ['a', 'b']), { bay: 'a', atMs: null, scale: null, why: false });
  assert.deepEqual(placeOf(hashOf({ ...place, why: true }), ['bay 1/x']), { ...place, why: true });
  assert.deepEqual(placeOf('#b/-5/year', ['a', 'b']), { bay: 'b', atMs: null, scale: null, why: false });
  assert.deepEqual(placeOf('#%/1e99/constructor', ['a']), { bay: 'a', atMs: null, scale: null, why: false });
  assert.deepEqual(placeOf('#a', []), { bay: null, atMs: null, scale: null, why: false });
});

test('a page begins with the time there is, a day at most', () => {
  const spans = [0, 9 * MIN, 15 * MIN, 16 * MIN, 61 * MIN, 9 * 60 * MIN, 90 * 24 * 60 * MIN];
  assert.deepEqual(spans.map(firstScale), ['quarter', 'quarter', 'quarter', 'hour', 'shift', 'day', 'day']);
});

test('a window has its length, whole minutes at its end, and ends at the newest', () => {
  for (const [scale, ms] of [['hour', 3_600_000], ['day', 86_400_000], ['month', 30 * 86_400_000]]) {
    const last = 1_795_400_040_000;
    const { sinceMs, untilMs } = windowAt(last - 1234, scale, last);
    assert.deepEqual([untilMs - sinceMs, untilMs % MIN, untilMs], [ms, 0, last]);
    const early = windowAt(last - 2 * ms, scale, last);
    assert.ok(Math.abs((early.sinceMs + early.untilMs) / 2 - (last - 2 * ms)) <= MIN);
  }
  assert.equal(windowAt(1000, 'hour', 10 * 3_600_000).sinceMs, 0);
});

test('a film keeps time, and does not wait through silences', () => {
  const pictures = [{ t_ms: 0 }, { t_ms: 500 }, { t_ms: 60_000 }];
  assert.deepEqual([0, 1, 2].map((n) => frameMs(pictures, n, 1)), [500, 1500, null]);
  assert.equal(frameMs(pictures, 0, 4), 125);
  assert.equal(frameMs([{ t_ms: 0 }, { t_ms: 1 }], 0, 1), 40);
  assert.deepEqual([-5, 0, 499, 500, 70_000].map((at) => pictureAt(pictures, at)), [0, 0, 0, 1, 2]);
});

test('what happened in a visit', () => {
  const visit = { faults: [{ reason: 'NO_ECHO', times: 2, seconds: 1.25 }], moved: 'NO', to_position_s: null, corrections: 2, interrupted: false };
  assert.match(faultsText(visit), /^no echo 1\.[23].s \(2 times\)$/);
});

test('a visit in a few words, and the moment to ask about', () => {
  const fine = { begun_ms: 100_000, length_s: 60, unintended: false, faults: [], interrupted: false, to_position_s: 12.5, end: 'clear' };
  const faults = [{ reason: 'NO_ECHO', times: 2, seconds: 1 }, { reason: 'CAMERA_DOWN', times: 1, seconds: 12 }];
  const rolled = { ...fine, unintended: true, faults };
  const all = [fine, rolled, { ...fine, faults }, { ...fine, to_position_s: null }, { ...fine, interrupted: true }, { ...fine, end: 'gateway_off' }];
  assert.deepEqual(all.map(verdict), ['as usual', 'moved, though it was to stand', `camera down 12${String.fromCharCode(0x202f)}s`, 'never in place', 'interrupted', 'gateway off']);
  const events = [{ t_ms: 90_000, kind: 'sensor_fault' }, { t_ms: 120_000, kind: 'sensor_fault' }, { t_ms: 140_000, kind: 'rolling' }, { t_ms: 170_000, kind: 'moved' }];
  assert.deepEqual(all.map((visit) => momentOf(visit, events)), [112_500, 140_001, 120_001, 130_000, 112_500, 112_500]);
  assert.equal(momentOf(rolled, []), 112_500);
});

test('the time that an answer is of', () => {
  assert.deepEqual(spanOf('/api/bays/bay%201/trend?since_ms=60000&until_ms=120000&points=60'), { sinceMs: 60_000, untilMs: 120_000 });
  assert.equal(spanOf(null), null);
});
