import assert from 'node:assert/strict';
import { getEventListeners } from 'node:events';
import test from 'node:test';
import { either, pause } from '../static/lib/api.js';

test('a page that asks on and on gathers no listeners at the signal that lasts as long as itself', async () => {
  const page = new AbortController();
  const asked = Array.from({ length: 100 }, () => either(page.signal, 1));
  await Promise.all(Array.from({ length: 100 }, () => pause(1, page.signal)));
  await pause(20, page.signal);
  assert.deepEqual(asked.map((signal) => signal.reason?.name), Array(100).fill('TimeoutError'));
  assert.equal(getEventListeners(page.signal, 'abort').length, 0);
});

test('the end of the page ends what waits', async () => {
  const page = new AbortController();
  const asked = either(page.signal, 60_000);
  const waiting = pause(60_000, page.signal);
  page.abort(new Error('left'));
  await waiting;
  assert.equal(asked.reason.message, 'left');
  assert.equal(either(page.signal, 60_000).aborted, true);
});
