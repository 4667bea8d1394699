import assert from 'node:assert/strict';
import test from 'node:test';
import { barOf, nice, ticks, written } from '../static/lib/bars.js';
import { arrow, draw, fit } from '../static/lib/overlay.js';

const near = (got, wanted, message) => assert.ok(Math.abs(got - wanted) < 1e-9, `${message ?? ''} ${got} is not ${wanted}`);

test('pixel centres lie at integers: the corner of the frame is (-0.5, -0.5)', () => {
  const place = fit(640, 480, 1280, 960);
  assert.equal(place.scale, 2);
  assert.equal(place.x(-0.5), 0);
  assert.equal(place.y(-0.5), 0);
  assert.equal(place.x(639.5), 1280);
  assert.equal(place.x(319.5), 640);
});

test('a frame of another shape lies in the middle', () => {
  const place = fit(640, 480, 1000, 480);
  assert.equal(place.scale, 1);
  assert.equal(place.left, 180);
  assert.equal(place.top, 0);
});

test('the arrow points from the marker to the aim, short of both', () => {
  const found = arrow([100, 50], [200, 50], 5, 10);
  assert.deepEqual(found.start, [105, 50]);
  assert.deepEqual(found.tip, [195, 50]);
  assert.deepEqual(found.back, [185, 50]);
  assert.deepEqual([found.left, found.right], [[185, 55], [185, 45]]);
});

test('no arrow where it would be no longer than its head', () => {
  assert.equal(arrow([100, 50], [119, 50], 5, 10), null);
  assert.equal(arrow([100, 50], [100, 50], 5, 10), null);
  assert.equal(arrow([NaN, 50], [100, 50], 5, 10), null);
});

/** Notes what is painted instead of painting it. */
function brush(width = 640, height = 480) {
  const arcs = [];
  const ellipses = [];
  const nothing = () => {};
  const g = new Proxy({ canvas: { width, height }, arc: (...a) => arcs.push(a), ellipse: (...a) => ellipses.push(a) }, {
    get: (target, name) => target[name] ?? nothing,
    set: () => true,
  });
  return { g, arcs, ellipses };
}
const CIRCLE = { circle: { u: 99.5, v: 49.5, radius: 30 }, ellipse: null, predicted: null, quality: 'GOOD' };

test('the circle is drawn where it was seen', () => {
  const { g, arcs } = brush();
  draw(g, CIRCLE, null, { width: 640, height: 480 });
  assert.deepEqual(arcs[0].slice(0, 3), [100, 50, 30]);
});

test('a tilted disc is drawn as its ellipse', () => {
  const { g, arcs, ellipses } = brush(1280, 960);
  draw(g, { ...CIRCLE, ellipse: { u: 99.5, v: 49.5, major: 30, minor: 20, angle: 0.5 } }, null, { width: 640, height: 480 });
  assert.deepEqual(ellipses[0].slice(0, 5), [200, 100, 60, 40, 0.5]);
  assert.equal(arcs.length, 0);
});

test('nothing is drawn of what was not seen in this frame', () => {
  for (const view of [null, { circle: null, ellipse: null, predicted: null, quality: 'NO_TARGET' }]) {
    const { g, arcs, ellipses } = brush();
    draw(g, view, null, { width: 640, height: 480 });
    assert.equal(arcs.length + ellipses.length, 0);
  }
});

test('round numbers for the ends of scales', () => {
  assert.deepEqual([1, 1.1, 270, 299, 301, 1800, 4000, 0].map(nice), [1, 1.5, 300, 300, 400, 2000, 4000, 1]);
});

test('labels reach from 0 to the end, not too many', () => {
  for (const most of [1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 300, 400, 2000, 2500, 4000]) {
    const at = ticks(most);
    assert.equal(at[0], 0);
    assert.ok(at.length >= 3 && at.length <= 7, `${most}: ${at}`);
    assert.ok(at[at.length - 1] <= most);
  }
});

const R = { threshold: 180, hysteresis: 6, reachedAbove: true, most: 300 };
const Z = { threshold: 300, hysteresis: 20, reachedAbove: false, most: 2000 };

test('R is reached from its threshold upwards, as equation 14 has it', () => {
  assert.equal(barOf({ ...R, value: 179.99 }).reached, false);
  assert.equal(barOf({ ...R, value: 180 }).reached, true);
  assert.deepEqual(barOf({ ...R, value: 10 }).zone, [0.6, 1]);
});

test('Z is reached from its threshold downwards', () => {
  assert.equal(barOf({ ...Z, value: 300.01 }).reached, false);
  assert.equal(barOf({ ...Z, value: 300 }).reached, true);
  assert.deepEqual(barOf({ ...Z, value: 10 }).zone, [0, 0.15]);
});

test('the band lies on the far side of the threshold', () => {
  const [low, high] = barOf({ ...R, value: 177 }).band;
  near(low, 0.58);
  near(high, 0.6);
  assert.equal(barOf({ ...R, value: 177 }).inBand, true);
  assert.equal(barOf({ ...R, value: 173 }).inBand, false);
  const band = barOf({ ...Z, value: 310 }).band;
  near(band[0], 0.15);
  near(band[1], 0.16);
  assert.equal(barOf({ ...Z, value: 310 }).inBand, true);
  assert.equal(barOf({ ...R, hysteresis: 0, value: 177 }).band, null);
});

test('no value is no bar, and is neither reached nor not', () => {
  for (const value of [null, undefined, NaN]) {
    const bar = barOf({ ...R, value });
    assert.equal(bar.fill, null);
    assert.equal(bar.reached, null);
    assert.equal(bar.inBand, false);
  }
});

test('a value beyond the scale fills it and says so', () => {
  const bar = barOf({ ...R, value: 500 });
  assert.equal(bar.fill, 1);
  assert.equal(bar.beyond, true);
  assert.equal(barOf({ ...R, value: -4 }).fill, 0);
});

test('the marks of an axis read apart: decimals where they are needed, none where things are counted', () => {
  assert.deepEqual(written([0.5, 1, 1.5, 2]), ['0.5', '1.0', '1.5', '2.0']);
  assert.deepEqual(written([0, 25, 50]), ['0', '25', '50']);
  assert.deepEqual(written([0, 0.1 + 0.2]), ['0.0', '0.3']);
  assert.deepEqual(ticks(15), [0, 2.5, 5, 7.5, 10, 12.5, 15]);
  assert.deepEqual(ticks(15, true), [0, 5, 10, 15]);
  assert.deepEqual(ticks(4, true), [0, 1, 2, 3, 4]);
});
