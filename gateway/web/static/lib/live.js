// The WebSocket by which a page pulls what is new: it asks for the next message when the last one has been drawn, so
// that a slow page gets fewer messages, and never old ones.

import { below } from './address.js';
import { moment } from './freshness.js';

const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 4000;
const SILENCE_MS = 5000; // a server that says nothing for this time is taken for lost, and asked anew

// Codes of the gateway's own with which it ends a link: from REFUSED on; one of them only means that this page slept.
const REFUSED = 4000;
const NO_ANSWER = 4400;

/** How long to wait before connection `tries` (0: at once), with up to a third of chance so that pages spread out. */
export function waitMs(tries, chance) {
  if (tries <= 0) return 0;
  return Math.min(LONGEST_WAIT_MS, FIRST_WAIT_MS * 2 ** (tries - 1)) * (1 - chance / 3);
}

/**
 * Keeps a link to `path` until it is closed. After each `message` call `next()` once, when it has been drawn.
 * @param {string} path with its query
 * @param {{message: (text: string, asked: import('./freshness.js').Moment) => void, state?: (open: boolean) => void,
 *          refused?: (why: string) => void}} tell `asked`: when it was asked for; `why`: in the server's words
 * @param {{restsHidden?: boolean}} [how] `restsHidden`: a lost link is made again only when the page can be seen
 */
export function open(path, tell, { restsHidden = false } = {}) {
  let socket = /** @type {WebSocket|null} */ (null);
  let tries = 0;
  let closed = false;
  let asked = moment();
  let heardMs = asked.steadyMs;
  let retry = 0;

  const ended = (mine, code, why = '') => {
    if (socket !== mine) return;
    socket = null;
    tell.state?.(false);
    if (closed) return;
    if (code >= REFUSED && code !== NO_ANSWER) tell.refused?.(why || `code ${code}`);
    tries += 1;
    if (!(restsHidden && document.hidden)) retry = setTimeout(connect, waitMs(tries, Math.random()));
  };
  const connect = () => {
    if (closed) return;
    clearTimeout(retry);
    const mine = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}${below(path)}`);
    socket = mine;
    asked = moment();
    heardMs = asked.steadyMs;
    mine.onopen = () => socket === mine && tell.state?.(true);
    mine.onmessage = (event) => {
      if (socket !== mine) return;
      heardMs = performance.now();
      tries = 0;
      tell.message(String(event.data), asked);
    };
    mine.onclose = (event) => ended(mine, event.code, event.reason);
    mine.onerror = () => {}; // a close follows
  };
  const next = () => {
    if (socket?.readyState !== WebSocket.OPEN) return;
    asked = moment();
    heardMs = asked.steadyMs;
    socket.send('next');
  };
  // A cable that was cut closes nothing: silence does. A page that did not ask waits for nothing.
  const watch = setInterval(() => {
    const mine = socket;
    if (mine && performance.now() - heardMs > SILENCE_MS && asked.steadyMs >= heardMs) {
      mine.onclose = null;
      mine.close();
      ended(mine, 0);
    }
  }, 1000);
  const awake = () => {
    if (!socket && !closed && !document.hidden) {
      tries = 0;
      connect();
    }
  };
  addEventListener('online', awake);
  addEventListener('pageshow', awake);
  document.addEventListener('visibilitychange', awake);
  connect();
  return {
    next,
    close() {
      closed = true;
      clearTimeout(retry);
      clearInterval(watch);
      removeEventListener('online', awake);
      removeEventListener('pageshow', awake);
      document.removeEventListener('visibilitychange', awake);
      const mine = socket;
      socket = null;
      mine?.close();
    },
  };
}
