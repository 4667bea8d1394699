// The live picture with the corners that were found in this very frame, and why its view is not taken.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { below } from '../lib/address.js';
import { pause } from '../lib/api.js';
import { remember, remembered } from '../lib/memory.js';
import { age, number } from '../lib/format.js';
import { OVERVIEW_LIMIT_MS, moment } from '../lib/freshness.js';
import { fit } from '../lib/overlay.js';
import { widthFor } from '../lib/pictures.js';
import { tone } from '../lib/sound.js';
import { useFresh, useNow } from '../operator/hooks.js';

const PAUSE_MS = 80; // at least this long between two looks: others use the gateway's thread for pictures, too
const AGAIN_MS = 1500; // after a failure
const SOUND = 'gateway.calibration.sound';
const VERDICTS = {
  not_found: 'The board is not found: all of it must be in the picture, with its light rim.',
  too_far: 'Too far away: bring the board nearer.',
  moving: 'Hold it still.',
  blurred: 'Blurred: hold it still, in focus, in more light.',
  similar: 'Like a view that was taken: move it, tilt it, or change the distance.',
  taken: 'Taken.',
  no_picture: 'The camera gives no new picture.',
  other_size: 'The camera\u2019s picture has another size now: begin anew.',
  full: 'No more views are kept: remove some, or save.',
};
const MARK = '#8fd3ff';
const TAKEN = '#7CFC7C';
const INK = 'rgba(0,0,0,0.75)';

/** Corners as dots, the first one ringed, rows as lines. @param {CanvasRenderingContext2D} g */
function paint(g, look, columns, ratio) {
  const { width, height } = g.canvas;
  const place = fit(look.width_px, look.height_px, width, height);
  const points = look.points.map(([u, v]) => [place.x(u), place.y(v)]);
  const size = Math.max(2.5 * ratio, width / 300);
  for (const [colour, wide] of [[INK, 2.2 * ratio], [look.verdict === 'taken' ? TAKEN : MARK, ratio]]) {
    g.strokeStyle = colour;
    g.lineWidth = wide;
    g.beginPath();
    for (const [n, [x, y]] of points.entries()) {
      if (n % columns === 0) g.moveTo(x, y);
      else g.lineTo(x, y);
    }
    g.stroke();
  }
  points.forEach(([x, y], n) => {
    g.beginPath();
    g.arc(x, y, n === 0 ? 1.8 * size : size, 0, 2 * Math.PI);
    g.fillStyle = look.verdict === 'taken' ? TAKEN : n === 0 ? '#ffffff' : MARK;
    g.strokeStyle = INK;
    g.lineWidth = ratio;
    g.fill();
    g.stroke();
  });
}

export function Live({ base, send, view, looked, lost }) {
  const canvas = useRef(null);
  const byHand = useRef(false);
  const live = useFresh(OVERVIEW_LIMIT_MS);
  const look = live.last;
  useNow(250);
  const [trouble, setTrouble] = useState('');
  const [taken, setTaken] = useState(null); // number of the newest view
  const [sound, setSound] = useState(remembered(SOUND) === 'on');
  const now = useRef({ looked, sound, audio: null });
  Object.assign(now.current, { looked, sound, lost });

  useEffect(() => {
    const end = new AbortController();
    const show = async (next) => {
      const answer = await fetch(below(`${base}/look/${next.number}/picture`), { credentials: 'same-origin', cache: 'no-store', signal: end.signal });
      if (!answer.ok) return; // another page's look has replaced it: the next one follows
      const bitmap = await createImageBitmap(await answer.blob());
      const element = canvas.current;
      if (element) {
        if (element.width !== bitmap.width || element.height !== bitmap.height) Object.assign(element, { width: bitmap.width, height: bitmap.height });
        const g = element.getContext('2d');
        g.drawImage(bitmap, 0, 0);
        if (next.points.length) paint(g, next, view.board.columns, bitmap.width / Math.max(1, element.clientWidth));
      }
      bitmap.close();
    };
    (async () => {
      let after = 0;
      while (!end.signal.aborted) {
        if (document.hidden && !byHand.current) {
          await pause(300, end.signal);
          continue;
        }
        const asked = moment();
        try {
          const take = byHand.current;
          byHand.current = false;
          const width = widthFor(canvas.current?.clientWidth ?? 640, devicePixelRatio || 1);
          const next = await send('/look', { after, width_px: width, take });
          after = next.number;
          if (end.signal.aborted) return;
          if (next.frame_id !== null) await show(next);
          live.take(next, asked, next.work_ms);
          setTrouble('');
          if (next.view !== null) {
            setTaken(next.view);
            if (now.current.sound) beep(now.current);
          }
          now.current.looked(next);
        } catch (error) {
          if (end.signal.aborted) return;
          setTrouble(error.name === 'TypeError' ? 'no connection to the gateway' : error.message);
          if (error.status === 409) return now.current.lost(error.message);
          await pause(AGAIN_MS, end.signal);
        }
        await pause(Math.max(PAUSE_MS, (performance.now() - asked.steadyMs) / 2), end.signal); // two thirds of the time at most
      }
    })();
    return () => end.abort();
  }, []);

  const beep = (state) => {
    state.audio ??= new AudioContext();
    tone(state.audio, 880, 0, 0.12, { loud: 0.3, fades: true });
  };
  const withSound = (on) => {
    remember(SOUND, on ? 'on' : null);
    setSound(on);
    if (on) beep(now.current);
  };
  const verdict = look === null ? null : live.fresh(look.age_ms) ? look.verdict : 'no_picture';
  const shown = verdict === null ? 'Waiting for a picture …' : VERDICTS[verdict];
  const holding = verdict === 'moving' && look.held_s > 0;
  return html`<section class="panel live" aria-labelledby="live-title">
    <header><h2 id="live-title">Live picture</h2><span class="small muted row"><span>${`${view.width_px} x ${view.height_px} px`}</span>${look && html`<span data-age>${`picture ${age(live.ageMs(look.age_ms))} old`}</span>`}${look?.work_ms > 0 && html`<span>${`${number(look.work_ms, 0, 'ms')} a picture`}</span>`}</span></header>
    <canvas ref=${canvas} class=${`picture${verdict === 'no_picture' || trouble || (look && !live.fresh(look.age_ms)) ? ' old' : ''}`} width=${view.width_px} height=${view.height_px} role="img" aria-label="live picture of the camera with the corners found"></canvas>
    <p class=${`verdict ${verdict ?? ''}`} data-verdict=${verdict}><span aria-hidden="true">${verdict === 'taken' ? '✓' : holding ? '●' : verdict === 'similar' ? '↻' : '▲'}</span> ${holding ? 'Hold it still …' : shown}</p>
    <progress max=${look?.hold_s ?? 1} value=${holding ? look.held_s : verdict === 'taken' ? look.hold_s : 0} aria-label="held still"></progress>
    ${look?.other_board && html`<p class="notice warn" role="status">${`A checkerboard of ${look.other_board[0]} x ${look.other_board[1]} inner corners is in the picture: is that the board? The size counts inner corners, one less than squares each way.`}</p>`}
    ${trouble && html`<p class="notice bad" role="alert">${trouble}</p>`}
    <p class="sr" role="status" aria-live="polite">${taken === null ? '' : `View ${taken} taken.`}</p>
    <div class="row"><button type="button" disabled=${!look?.points.length} onClick=${() => { byHand.current = true; }}>Take this view now</button>
      <label class="row small"><input type="checkbox" checked=${sound} onChange=${(event) => withSound(event.target.checked)} /> a tone when a view is taken</label></div>
  </section>`;
}
