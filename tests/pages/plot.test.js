import assert from 'node:assert/strict';
import test from 'node:test';
import { HEIGHT, WIDTH, dots, scales } from '../static/tune/plot.js';

test('a plot of a teach-in holds readings and lines, the larger ones above', () => {
  const at = scales([149.8, null, 150.2], [147.3, 150], 60);
  assert.equal(at.x(0), 8);
  assert.equal(at.x(60), WIDTH - 8);
  for (const value of [147.3, 150.2]) assert.ok(at.y(value) > 8 && at.y(value) < HEIGHT - 8);
  assert.ok(at.y(150.2) < at.y(147.3));
});

test('each known reading is a dot', () => {
  const at = { x: (s) => s, y: (value) => 2 * value };
  assert.equal(dots([0, 1, 2], [5, null, 7.25], at), 'M0.0 10.0h0M2.0 14.5h0');
});

test('without any reading nothing is infinite', () => {
  const at = scales([null], [], 0);
  assert.ok(Number.isFinite(at.x(0)) && Number.isFinite(at.y(0.5)));
  assert.ok(Number.isFinite(scales([5, 5], [], 60).y(5)));
});
