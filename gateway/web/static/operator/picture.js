// The live picture with what was seen in it. Whatever is old is greyed and says so.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { px, words } from '../lib/format.js';
import { text } from '../lib/lang.js';
import { draw } from '../lib/overlay.js';
import { follow, widthFor } from '../lib/pictures.js';
import { Age, useFresh, useKept } from './hooks.js';

/** Of one bay: for another one it is made anew (by its key), so that the picture of the one before is never shown as its own.
 * `fault`: what is wrong with the camera, in words; empty: nothing that is known. `onShape`: gets width by height.
 */
export function LivePicture({ bay, aim, connected, fault, onShape }) {
  const box = useRef(null);
  const photo = useRef(null);
  const lines = useRef(null);
  const last = useRef(null);
  const picture = useFresh();
  const [trouble, setTrouble] = useState('');
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
    const stop = follow(bay, {
      width: () => widthFor(box.current?.clientWidth ?? 640, devicePixelRatio || 1),
      picture(now, asked, heldMs) {
        last.current?.bitmap.close();
        last.current = now;
        setTrouble('');
        picture.take(now, asked, heldMs);
        const canvas = photo.current;
        if (!canvas) return;
        const { width, height } = now.bitmap;
        if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
        const shape = now.frame.width / now.frame.height;
        box.current.style.setProperty('--shape', shape.toFixed(4));
        onShape(shape);
        canvas.getContext('2d').drawImage(now.bitmap, 0, 0);
        repaint();
      },
      trouble: setTrouble,
    });
    const resized = new ResizeObserver(repaint);
    resized.observe(box.current);
    return () => {
      stop();
      resized.disconnect();
      last.current?.bitmap.close();
    };
  }, [bay]);
  useEffect(repaint, [overlay, aim?.u_px, aim?.v_px, aim?.tolerance_px]);

  const { view = null, id = null, age_ms: sentMs } = picture.last ?? {};
  const live = picture.fresh(sentMs);
  const why = trouble || (id === null ? 'waiting for a picture' : 'no new picture');
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
        <${Age} of=${picture} partMs=${sentMs} />
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
          <p>${connected ? fault || why : 'no connection to the gateway'}</p>
        </div>`}
      </div>
      <figcaption class="small">
        <span class="muted">${id === null ? 'no frame' : `frame ${id}`}</span>
        <span>${seen ?? ''}</span>
      </figcaption>
    </figure>
  </section>`;
}
