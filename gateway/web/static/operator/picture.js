// The live picture with what was seen in it. Whatever is old is greyed and says so.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { age, px, words } from '../lib/format.js';
import { text } from '../lib/lang.js';
import { draw } from '../lib/overlay.js';
import { follow, widthFor } from '../lib/pictures.js';
import { useKept } from './hooks.js';

/** An older picture is not live any more, ms. */
const LIVE_MS = 1500;

/** Of one bay: for another one it is made anew (by its key), so that the picture of the one before is never shown as its own.
 * `fault`: what is wrong with the camera, in words; empty: nothing that is known. `onShape`: gets width by height.
 */
export function LivePicture({ bay, aim, connected, fault, onShape }) {
  const box = useRef(null);
  const photo = useRef(null);
  const lines = useRef(null);
  const last = useRef(null);
  const [told, setTold] = useState({ text: 'waiting for a picture', live: false, view: null, id: null, ageMs: null });
  const [overlay, setOverlay] = useKept('operator.overlay', true);
  const shown = useRef({ aim, overlay });
  shown.current = { aim, overlay };

  const repaint = () => {
    const now = last.current;
    const canvas = lines.current;
    if (!canvas || !now) return;
    const ratio = devicePixelRatio || 1;
    const room = box.current.getBoundingClientRect();
    const [width, height] = [Math.round(room.width * ratio), Math.round(room.height * ratio)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const g = canvas.getContext('2d');
    if (shown.current.overlay) draw(g, now.view, shown.current.aim, now.frame, ratio);
    else g.clearRect(0, 0, width, height);
  };

  useEffect(() => {
    let trouble = '';
    const look = () => {
      const now = last.current;
      const ageMs = now ? (now.ageMs ?? 0) + performance.now() - now.receivedMs : null;
      const live = ageMs !== null && ageMs <= LIVE_MS;
      const why = live ? '' : now === null ? trouble || 'waiting for a picture' : trouble || 'the camera sends nothing new';
      setTold({ text: why, live, view: now?.view ?? null, id: now?.id ?? null, ageMs });
    };
    const stop = follow(bay, {
      width: () => widthFor(box.current?.clientWidth ?? 640, devicePixelRatio || 1),
      picture(now) {
        last.current?.bitmap.close();
        last.current = now;
        trouble = '';
        const canvas = photo.current;
        if (!canvas) return;
        const { width, height } = now.bitmap;
        if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
        const shape = now.frame.width / now.frame.height;
        box.current.style.setProperty('--shape', shape.toFixed(4));
        onShape(shape);
        canvas.getContext('2d').drawImage(now.bitmap, 0, 0);
        repaint();
        look();
      },
      trouble(why) {
        trouble = why;
        look();
      },
    });
    const timer = setInterval(look, 250);
    const resized = new ResizeObserver(repaint);
    resized.observe(box.current);
    return () => {
      stop();
      clearInterval(timer);
      resized.disconnect();
      last.current?.bitmap.close();
    };
  }, [bay]);
  useEffect(repaint, [overlay, aim?.u_px, aim?.v_px, aim?.tolerance_px]);

  const { view, live, ageMs } = told;
  const seen = !live
    ? null
    : view === null
      ? 'not evaluated (yet)'
      : view.circle
        ? `circle u ${px(view.circle.u)}, v ${px(view.circle.v)}, R ${px(view.circle.radius)}`
        : view.predicted
          ? 'hidden: dashed is where it should be'
          : words(view.quality);
  return html`<section class="panel picture" aria-labelledby="picture-title">
    <header>
      <h2 id="picture-title">Camera</h2>
      <div class="row compact">
        <span class=${live ? 'tag' : 'tag bad'}>${live ? 'LIVE' : 'NOT LIVE'}</span>
        <span class="small value age">${live ? age(ageMs) : ''}</span>
        <label class="row small"><input type="checkbox" checked=${overlay} onChange=${(event) => setOverlay(event.target.checked)} /> show what was seen</label>
      </div>
    </header>
    <figure>
      <div class=${`view ${live ? '' : 'dead'}`} ref=${box}>
        <canvas ref=${photo} role="img" aria-label=${live ? text('Live picture of {0}', bay) : text('No live picture of {0}', bay)} width="640" height="480"></canvas>
        <canvas ref=${lines} aria-hidden="true"></canvas>
        ${!live &&
        html`<div class="no-picture">
          <p class="big">NO LIVE PICTURE</p>
          <p>${connected ? fault || told.text : 'no connection to the gateway'}</p>
          ${ageMs !== null && html`<p>${text('what is behind is {0} old', age(ageMs))}</p>`}
        </div>`}
      </div>
      <figcaption class="small">
        <span class="muted">${told.id === null ? 'no frame' : `frame ${told.id}`}</span>
        <span>${seen ?? ''}</span>
      </figcaption>
    </figure>
  </section>`;
}
