import assert from 'node:assert/strict';
import test from 'node:test';
import { Freshness } from '../static/lib/freshness.js';

const WALL = 1_795_000_000_000;
const at = (ms, apart = 0) => ({ steadyMs: ms, wallMs: WALL + ms + apart });
const received = (sent, now = 1000, asked = now, held = 0) => {
  const fresh = new Freshness(500);
  fresh.received(sent, at(asked), at(now), held);
  return fresh;
};

test('nothing is known before the first answer', () => {
  assert.equal(new Freshness(500).ageMs(at(0)), Infinity);
  assert.equal(new Freshness(500).fresh(at(0)), false);
});

test('the age at sending counts, and what has passed since', () => {
  const fresh = received(120);
  assert.equal(fresh.ageMs(at(1000)), 120);
  assert.equal(fresh.ageMs(at(1380)), 500);
  assert.equal(fresh.fresh(at(1380)), true);
  assert.equal(fresh.fresh(at(1381)), false);
});

test('a state that was old when it was sent is stale at once', () => {
  assert.equal(received(501).fresh(at(1000)), false);
});

test('an answer that was long on its way is as old as the question for it', () => {
  const late = received(20, 4000, 1000);
  assert.equal(late.ageMs(at(4000)), 3020);
});

test('a part of an answer is older by its own age; of one whose age is not known nothing is', () => {
  const fresh = received(0, 1100, 1000);
  assert.equal(fresh.fresh(at(1100), 400), true);
  assert.equal(fresh.fresh(at(1101), 400), false);
  for (const nothing of [null, NaN, Infinity]) assert.equal(fresh.fresh(at(1100), nothing), false, String(nothing));
});

test('what the sender says it held the question for does not count, and no more than that', () => {
  assert.equal(received(20, 1100, 1000, 90).ageMs(at(1100)), 30);
  assert.equal(received(20, 1100, 1000, 9000).ageMs(at(1100)), 20);
  assert.equal(received(20, 1100, 1000, -50).ageMs(at(1100)), 120);
  assert.equal(received(20, 1100, 1000, NaN).ageMs(at(1100)), 120);
});

test('a wall clock that is set, either way, makes it unknown until the next answer', () => {
  for (const jump of [3_600_000, -3_600_000, 251, -251]) {
    const fresh = received(10);
    assert.equal(fresh.ageMs(at(1100, jump)), Infinity, String(jump));
    assert.equal(fresh.ageMs(at(1110)), Infinity, 'and it stays so');
    fresh.received(10, at(1200, jump), at(1200, jump));
    assert.equal(fresh.ageMs(at(1210, jump)), 20);
  }
});

test('nor is an answer known during whose way the clock was set or the machine slept', () => {
  const fresh = new Freshness(500);
  fresh.received(10, at(1000), at(1001, 60_000));
  assert.equal(fresh.ageMs(at(1001, 60_000)), Infinity);
});

test('a machine that slept while its steady clock stood still', () => {
  assert.equal(received(10).ageMs(at(1001, 60_000)), Infinity);
});

test('a steady clock that steps back', () => {
  assert.equal(received(10).ageMs(at(999)), Infinity);
});

test('small differences of the clocks: the larger time counts', () => {
  assert.equal(received(10).ageMs(at(1100, 200)), 310);
  assert.equal(received(10).ageMs(at(1300, -200)), 310);
});

test('an age that is none is never taken for a fresh one', () => {
  for (const nonsense of [NaN, Infinity, -1, null, undefined, '3']) {
    assert.equal(received(nonsense).fresh(at(1000)), false, String(nonsense));
  }
});

test('nonsense takes the place of what was fresh', () => {
  const fresh = received(10);
  fresh.received(NaN, at(1010), at(1010));
  assert.equal(fresh.fresh(at(1011)), false);
});

test('forget: the link is lost', () => {
  const fresh = received(10);
  fresh.forget();
  assert.equal(fresh.fresh(at(1001)), false);
});

test('fresh without a break: a gap begins it anew, even one that ended before anybody looked', () => {
  const fresh = received(10);
  for (const ms of [1400, 1800, 2200]) fresh.received(10, at(ms), at(ms));
  assert.equal(fresh.freshForMs(at(2300)), 1300);
  fresh.received(10, at(2691), at(2691)); // 501 ms after what was 10 ms old
  assert.equal(fresh.freshForMs(at(2700)), 9);
  assert.equal(fresh.freshForMs(at(3182)), 0); // stale
  fresh.received(600, at(3200), at(3200)); // fresh data only counts
  fresh.received(10, at(3300), at(3300));
  assert.equal(fresh.freshForMs(at(3400)), 100);
});
