import assert from 'node:assert/strict';
import test from 'node:test';
import { GAP_S, Series } from '../static/lib/series.js';

const sample = (radius_px, stop = false, mayMove = true) => ({ radius_px, distance_mm: 700, stop, mayMove });

test('samples stand in order, none twice, none backwards', () => {
  const series = new Series();
  for (const t of [1, 1.1, 1.1, 1.05, 1.2]) series.add(t, sample(t));
  assert.deepEqual(series.row.t, [1, 1.1, 1.2]);
  assert.deepEqual(series.row.radius, [1, 1.1, 1.2]);
});

test('what comes too fast is left out, unless stop or the marker changed', () => {
  const series = new Series(600, 10);
  series.add(1, sample(50));
  series.add(1.01, sample(51));
  assert.equal(series.row.t.length, 1);
  series.add(1.02, sample(52, true));
  series.add(1.03, sample(null, true));
  assert.deepEqual(series.row.radius, [50, 52, null]);
});

test('no value is a gap, never 0 and never the last one', () => {
  const series = new Series();
  series.add(1, sample(50));
  series.add(1.2, { radius_px: null, distance_mm: undefined, stop: true, mayMove: false });
  assert.deepEqual([series.row.radius[1], series.row.distance[1]], [null, null]);
});

test('a silence breaks the line', () => {
  const series = new Series();
  series.add(1, sample(50));
  series.add(1 + GAP_S + 0.1, sample(60));
  assert.deepEqual(series.row.radius, [50, null, 60]);
  assert.deepEqual(series.row.stop, [false, null, false]);
  assert.ok(series.row.t[1] > series.row.t[0] && series.row.t[1] < series.row.t[2]);
});

test('it does not grow for ever', () => {
  const series = new Series(10, 10);
  for (let n = 0; n < 3000; n += 1) series.add(n / 10, sample(n));
  assert.ok(series.row.t.length <= 10 * 10 + 102, String(series.row.t.length));
  assert.ok(series.row.t[0] >= 299.9 - 10 - 10.3);
  const lengths = new Set(Object.values(series.row).map((column) => column.length));
  assert.equal(lengths.size, 1);
});

test('stretches for the strip: joined, cut to the window, none where nothing is known', () => {
  const series = new Series();
  for (const [t, stop] of [[0, false], [0.5, false], [1, true], [1.5, null], [2, true]]) series.add(t, sample(5, stop));
  assert.deepEqual(series.stretches('stop', 0.25, 2.5), [
    { from: 0.25, to: 1, value: false },
    { from: 1, to: 1.5, value: true },
    { from: 2, to: 2.5, value: true },
  ]);
  assert.deepEqual(series.stretches('stop', 5, 6), []);
});

test('every strip of the trend has its column', () => {
  const series = new Series();
  series.add(0, { radius_px: 1, distance_mm: 2, stop: true, in_place: true, may_move: false });
  for (const [name, value] of [['stop', true], ['in_place', true], ['may_move', false]])
    assert.deepEqual(series.stretches(name, 0, 60), [{ from: 0, to: GAP_S, value }], name);
});

test('the newest sample does not stand for the time after it', () => {
  const series = new Series();
  series.add(0, sample(5, true));
  assert.deepEqual(series.stretches('stop', 0, 60), [{ from: 0, to: GAP_S, value: true }]);
});

test('the largest value of the window', () => {
  const series = new Series();
  for (const [t, r] of [[0, 90], [0.5, 20], [1, null], [1.5, 30]]) series.add(t, sample(r));
  assert.equal(series.most('radius', 0.4), 30);
  assert.equal(series.most('radius', -1), 90);
  assert.equal(series.most('radius', 9), null);
});
