// The live picture: one request at a time, the next one only when the last picture stands on the page, none while the
// page is in the background.

import { below } from './address.js';
import { either, pause } from './api.js';
import { moment } from './freshness.js';
import { frameSize, frameView } from './views.js';

/** Widths that are asked for: few, so that viewers share one encoding. */
export const WIDTHS = [320, 640, 960, 1280, 1920];

/** The smallest of them that fills `cssWidth` at `ratio` device pixels per CSS pixel. */
export function widthFor(cssWidth, ratio) {
  return WIDTHS.find((width) => width >= cssWidth * ratio * 0.9) ?? WIDTHS[WIDTHS.length - 1];
}

/** Times of an answer with a picture, ms; null: it says none. @param {Response} answer @param {'Age'|'Held'} what */
export const told = (answer, what) => (answer.headers.has(`X-Frame-${what}-Ms`) ? Number(answer.headers.get(`X-Frame-${what}-Ms`)) : null);

/**
 * @typedef {object} Picture
 * @property {ImageBitmap} bitmap
 * @property {{width: number, height: number}} frame size of the frame, which may be larger than the bitmap
 * @property {number} id of the frame
 * @property {number|null} age_ms of the frame when it was sent
 * @property {import('./views.js').FrameView|null} view what was seen in this very frame; null: not known
 */

/**
 * Asks on and on until it is stopped.
 * @param {string} bay
 * @param {{width: () => number, picture: (picture: Picture, asked: import('./freshness.js').Moment, heldMs: number) => void, trouble: (why: string) => void}} page
 */
export function follow(bay, page) {
  const end = new AbortController();
  let after = -1;
  let wake = () => {};
  const shown = () => {
    if (!document.hidden) wake();
  };
  document.addEventListener('visibilitychange', shown);
  const visible = () =>
    document.hidden
      ? new Promise((/** @type {(_?: unknown) => void} */ done) => {
          wake = done;
          end.signal.addEventListener('abort', done, { once: true });
        })
      : null;
  const drawn = () => new Promise((/** @type {(_?: undefined) => void} */ done) => requestAnimationFrame(() => done()));

  (async () => {
    let failed = 0;
    while (!end.signal.aborted) {
      await visible();
      if (end.signal.aborted) break;
      try {
        const asked = moment();
        const query = `${after >= 0 ? `after=${after}&` : ''}width=${page.width()}`;
        const answer = await fetch(below(`/api/bays/${encodeURIComponent(bay)}/picture?${query}`), {
          credentials: 'same-origin',
          cache: 'no-store',
          signal: either(end.signal, 10_000),
        });
        if (answer.status === 204 || answer.status === 304) {
          failed = 0;
          await pause(50, end.signal);
          continue;
        }
        if (!answer.ok) throw new Error(answer.status === 404 || answer.status === 503 ? 'no picture' : `answer ${answer.status}`);
        const bitmap = await createImageBitmap(await answer.blob());
        const id = Number(answer.headers.get('X-Frame-Id'));
        if (Number.isFinite(id)) after = id;
        failed = 0;
        const frame = frameSize(answer.headers.get('X-Frame-Size')) ?? { width: bitmap.width, height: bitmap.height };
        page.picture({ bitmap, frame, id, age_ms: told(answer, 'Age'), view: parsed(answer.headers.get('X-Frame-View')) }, asked, told(answer, 'Held') ?? 0);
        await drawn();
      } catch (error) {
        if (end.signal.aborted) break;
        failed += 1;
        after = -1; // another start of the gateway counts its frames anew
        page.trouble(error instanceof Error && error.name !== 'TypeError' ? error.message : 'no connection');
        await pause(Math.min(3000, 300 * failed), end.signal);
      }
    }
  })();
  return () => {
    document.removeEventListener('visibilitychange', shown);
    end.abort();
  };
}

function parsed(text) {
  if (!text) return null;
  try {
    return frameView(JSON.parse(text));
  } catch {
    return null;
  }
}
