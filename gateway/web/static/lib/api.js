// The gateway's HTTP side, as the pages use it.

import { below } from './address.js';

/** What the server refused, in its own words where it gave some. */
class Refused extends Error {
  /** @param {number} status @param {string} message @param {any} [body] the answer, where it was JSON */
  constructor(status, message, body) {
    super(message);
    this.status = status;
    this.body = body ?? null;
  }
}

let ended = false;

/** Ends the login, and leaves for the login page: nothing leads back to this one, whoever comes next. @param {string} csrf */
export async function logOut(csrf) {
  ended = true;
  try {
    await post('/api/logout', {}, csrf);
  } finally {
    location.assign(below('/login'));
  }
}

export function toLogin() {
  if (ended) return;
  const here = location.pathname + location.search + location.hash;
  location.assign(below(`/login?next=${encodeURIComponent(here)}`));
}

async function refusal(answer) {
  let message = '';
  let body = null;
  try {
    body = await answer.json();
    message = body.detail ?? body.error ?? body.message ?? '';
    if (typeof message !== 'string') message = JSON.stringify(message);
  } catch {
    message = '';
  }
  return new Refused(answer.status, message || `${answer.status} ${answer.statusText}`.trim(), body);
}

/**
 * GET, as JSON or as text. @param {string} path @param {{signal?: AbortSignal, timeoutMs?: number, as?: 'json'|'text'}} [how]
 */
export async function get(path, { signal, timeoutMs = 5000, as = 'json' } = {}) {
  const answer = await fetch(below(path), {
    headers: { Accept: as === 'json' ? 'application/json' : '*/*' },
    credentials: 'same-origin',
    cache: 'no-store',
    signal: either(signal, timeoutMs),
  });
  if (!answer.ok) throw await refusal(answer);
  return answer[as]();
}

/** POST JSON with the session's token against forged requests; or DELETE, without a body. */
export async function post(path, body, csrf, { timeoutMs = 10_000, method = 'POST' } = {}) {
  const answer = await fetch(below(path), {
    method,
    headers: { 'Content-Type': 'application/json', Accept: 'application/json', ...(csrf ? { 'X-CSRF-Token': csrf } : {}) },
    credentials: 'same-origin',
    body: method === 'DELETE' ? undefined : JSON.stringify(body ?? {}),
    signal: either(undefined, timeoutMs),
  });
  if (!answer.ok) throw await refusal(answer);
  const text = await answer.text();
  return text ? JSON.parse(text) : null;
}

/** A signal that fires with `signal` or after `timeoutMs`, whichever is first. It leaves no listener at `signal`, which may last as long as the page. */
export function either(signal, timeoutMs) {
  const control = new AbortController();
  const timer = setTimeout(() => {
    signal?.removeEventListener('abort', end);
    control.abort(new DOMException('no answer in time', 'TimeoutError'));
  }, timeoutMs);
  const end = () => {
    clearTimeout(timer);
    control.abort(signal.reason);
  };
  if (signal?.aborted) end();
  else signal?.addEventListener('abort', end, { once: true });
  return control.signal;
}

/** Ends after `ms`, or when `signal` fires, at which it leaves no listener. @param {number} ms @param {AbortSignal} signal */
export function pause(ms, signal) {
  return new Promise((/** @type {(_?: undefined) => void} */ done) => {
    const end = () => {
      clearTimeout(timer);
      signal.removeEventListener('abort', end);
      done();
    };
    const timer = setTimeout(end, ms);
    signal.addEventListener('abort', end);
  });
}
