import assert from 'node:assert/strict';
import test from 'node:test';
import { Freshness } from '../static/lib/freshness.js';

const WALL = 1_795_000_000_000;
const received = (sent, at = 1000, asked = at, held = 0) => {
  const fresh = new Freshness(500);
  fresh.received(sent, at, WALL + at, asked, held);
  return fresh;
};

test('nothing is known before the first message', () => {
  assert.equal(new Freshness(500).ageMs(0, 0), Infinity);
  assert.equal(new Freshness(500).fresh(0, 0), false);
});

test('the age at sending counts, and what has passed since', () => {
  const fresh = received(120);
  assert.equal(fresh.ageMs(1000, WALL + 1000), 120);
  assert.equal(fresh.ageMs(1380, WALL + 1380), 500);
  assert.equal(fresh.fresh(1380, WALL + 1380), true);
  assert.equal(fresh.fresh(1381, WALL + 1381), false);
});

test('a state that was old when it was sent is stale at once', () => {
  assert.equal(received(501).fresh(1000, WALL + 1000), false);
});

test('a message that was long on its way is as old as the question for it', () => {
  const late = received(20, 4000, 1000);
  assert.equal(late.ageMs(4000, WALL + 4000), 3020);
});

test('what the sender says it held the question for does not count, and no more than that', () => {
  assert.equal(received(20, 1100, 1000, 90).ageMs(1100, WALL + 1100), 30);
  assert.equal(received(20, 1100, 1000, 9000).ageMs(1100, WALL + 1100), 20);
  assert.equal(received(20, 1100, 1000, -50).ageMs(1100, WALL + 1100), 120);
  assert.equal(received(20, 1100, 1000, NaN).ageMs(1100, WALL + 1100), 120);
});

test('a wall clock that is set, either way, makes it unknown until the next message', () => {
  for (const jump of [3_600_000, -3_600_000, 251, -251]) {
    const fresh = received(10);
    assert.equal(fresh.ageMs(1100, WALL + 1100 + jump), Infinity, String(jump));
    assert.equal(fresh.ageMs(1110, WALL + 1110), Infinity, 'and it stays so');
    fresh.received(10, 1200, WALL + 1200 + jump);
    assert.equal(fresh.ageMs(1210, WALL + 1210 + jump), 20);
  }
});

test('a machine that slept while its steady clock stood still', () => {
  assert.equal(received(10).ageMs(1001, WALL + 61_001), Infinity);
});

test('a steady clock that steps back', () => {
  assert.equal(received(10).ageMs(999, WALL + 999), Infinity);
});

test('small differences of the clocks: the larger time counts', () => {
  assert.equal(received(10).ageMs(1100, WALL + 1300), 310);
  assert.equal(received(10).ageMs(1300, WALL + 1100), 310);
});

test('an age that is none is never taken for a fresh one', () => {
  for (const nonsense of [NaN, Infinity, -1, null, undefined, '3']) {
    assert.equal(received(nonsense).fresh(1000, WALL + 1000), false, String(nonsense));
  }
});

test('nonsense takes the place of what was fresh', () => {
  const fresh = received(10);
  fresh.received(NaN, 1010, WALL + 1010);
  assert.equal(fresh.fresh(1011, WALL + 1011), false);
});

test('forget: the page was hidden or frozen', () => {
  const fresh = received(10);
  fresh.forget();
  assert.equal(fresh.fresh(1001, WALL + 1001), false);
});
