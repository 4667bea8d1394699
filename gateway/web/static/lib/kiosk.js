// A page that nobody operates, on a wall or beside a bay: `?kiosk=1` in its address. No link leads away, the pointer hides,
// the screen stays awake, and the page is loaded anew when the gateway serves others than these.

import { below } from './address.js';

export const kiosk = new URLSearchParams(globalThis.location?.search ?? '').get('kiosk') === '1';

/** Without a touch or a key for this time, the pointer and what needs one are hidden. */
const IDLE_MS = 5000;
const ASK_MS = 30_000;

/** Keeps the screen from falling asleep; browsers grant it to visible pages of this machine or over TLS. */
export function keepAwake() {
  const lock = async () => {
    if (document.hidden || !('wakeLock' in navigator)) return;
    try {
      await navigator.wakeLock.request('screen');
    } catch {
      // Not granted: the computer's own settings must keep the screen on.
    }
  };
  document.addEventListener('visibilitychange', lock); // the browser gives it up with a page that is hidden
  lock();
}

/** Marks the page as idle. @param {() => void} [idled] called each time it becomes so */
export function watchIdle(idled = () => {}) {
  let timer = 0;
  const busy = () => {
    document.body.classList.remove('idle');
    clearTimeout(timer);
    timer = setTimeout(() => {
      document.body.classList.add('idle');
      idled();
    }, IDLE_MS);
  };
  for (const kind of ['pointermove', 'pointerdown', 'keydown']) addEventListener(kind, busy);
  busy();
}

/** Which pages the gateway serves; null: it does not answer. @returns {Promise<string|null>} */
async function served() {
  try {
    const answer = await fetch(below('/api/pages'), { cache: 'no-store', signal: AbortSignal.timeout(5000) });
    return answer.ok ? (await answer.json()).digest : null;
  } catch {
    return null;
  }
}

/** Loads the page anew when the gateway was updated. Only then: it answers at that moment. */
function followUpdates() {
  let first = /** @type {string|null} */ (null);
  const ask = async () => {
    const now = await served();
    first ??= now;
    if (now !== null && now !== first) location.reload();
  };
  setInterval(ask, ASK_MS);
  addEventListener('online', ask);
  ask();
}

/** Where the address asks for it. */
export function beginKiosk() {
  if (!kiosk) return;
  document.documentElement.classList.add('kiosk');
  followUpdates();
}
