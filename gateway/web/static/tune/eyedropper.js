// The picture itself, to click on: which colours are there, and which ranges would admit them. Works by keyboard, too.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { number } from '../lib/format.js';
import { text } from '../lib/lang.js';
import { css, painted } from './settings.js';

const ZOOM = 10; // of the loupe
const HALF = 9; // pixels of the picture to each side in it
const SIZES = [1, 5, 9, 15, 31];

/**
 * @param {{bitmap: ImageBitmap|null, frame: {width_px: number, height_px: number}|null, pick: Function, picked: any,
 *          frameId: number|null, elsewhere: boolean, live: boolean, failed: string, robust: boolean}} props  `bitmap` may be
 *          smaller than the frame; `robust`: the method that a click is for
 */
export function Eyedropper({ bitmap, frame, frameId, elsewhere, pick, picked, failed, live, robust }) {
  const canvas = useRef(null);
  const loupe = useRef(null);
  const [at, setAt] = useState(null);
  const [size, setSize] = useState(9);
  const [mode, setMode] = useState('replace');
  const scale = bitmap && frame ? bitmap.width / frame.width_px : 1;

  useEffect(() => {
    const to = canvas.current;
    if (!to || !bitmap) return;
    Object.assign(to, { width: bitmap.width, height: bitmap.height });
    const g = to.getContext('2d');
    g.drawImage(bitmap, 0, 0);
    if (!at) return;
    const [x, y] = [(at.u + 0.5) * scale, (at.v + 0.5) * scale];
    const half = Math.max(4, (size * scale) / 2);
    const arm = half + Math.max(8, bitmap.width / 50);
    for (const [colour, wide] of /** @type {[string, number][]} */ ([['#000', 4], ['#fff', 1.8]])) {
      g.strokeStyle = colour;
      g.lineWidth = (wide * bitmap.width) / 640;
      g.strokeRect(x - half, y - half, 2 * half, 2 * half);
      g.beginPath();
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        g.moveTo(x + dx * half, y + dy * half);
        g.lineTo(x + dx * arm, y + dy * arm);
      }
      g.stroke();
    }
  }, [bitmap, at, size, scale]);

  useEffect(() => {
    const to = loupe.current;
    if (!to) return;
    const side = (2 * HALF + 1) * ZOOM;
    Object.assign(to, { width: side, height: side });
    const g = to.getContext('2d');
    g.imageSmoothingEnabled = false;
    g.fillStyle = '#888';
    g.fillRect(0, 0, side, side);
    if (!bitmap || !at) return;
    g.drawImage(bitmap, (at.u - HALF) * scale, (at.v - HALF) * scale, (2 * HALF + 1) * scale, (2 * HALF + 1) * scale, 0, 0, side, side);
    const box = size * ZOOM;
    for (const [colour, wide] of [['#000', 4], ['#fff', 2]]) {
      g.strokeStyle = colour;
      g.lineWidth = wide;
      g.strokeRect((side - box) / 2, (side - box) / 2, box, box);
    }
  }, [bitmap, at, size, scale]);

  const place = (event) => {
    const room = canvas.current.getBoundingClientRect();
    const u = Math.floor(((event.clientX - room.left) / room.width) * frame.width_px);
    const v = Math.floor(((event.clientY - room.top) / room.height) * frame.height_px);
    return { u: Math.min(frame.width_px - 1, Math.max(0, u)), v: Math.min(frame.height_px - 1, Math.max(0, v)) };
  };
  const keyed = (event) => {
    if (!frame) return;
    const now = at ?? { u: Math.round(frame.width_px / 2), v: Math.round(frame.height_px / 2) };
    const by = event.shiftKey ? 10 : 1;
    const [du, dv] = { ArrowLeft: [-by, 0], ArrowRight: [by, 0], ArrowUp: [0, -by], ArrowDown: [0, by] }[event.key] ?? [0, 0];
    if (du || dv) {
      event.preventDefault();
      setAt({ u: Math.min(frame.width_px - 1, Math.max(0, now.u + du)), v: Math.min(frame.height_px - 1, Math.max(0, now.v + dv)) });
    } else if (!elsewhere && (event.key === 'Enter' || event.key === ' ')) {
      event.preventDefault();
      setAt(now);
      pick(now, size, mode);
    }
  };
  const patch = picked?.patch;
  return html`<figure class="tile picture" data-frame=${frameId}>
      <figcaption><h3>Picture${frameId === null ? '' : frameId < 0 ? html` <span class="small">uploaded</span>` : html` <span class="small">${text('frame {0}', frameId)}</span>`}</h3><span class="small">${elsewhere ? 'not yet the chosen picture' : mode === 'led' ? 'click the LED of the beacon' : 'click the marker to take its colours'}</span></figcaption>
      ${bitmap
        ? html`<canvas ref=${canvas} class="shot" tabindex="0" role="application" aria-label="picture; arrow keys move the eyedropper, Shift by ten, Enter takes the colours there"
            aria-disabled=${elsewhere} aria-describedby="picked" onPointerMove=${(event) => event.pointerType === 'mouse' && setAt(place(event))}
            onClick=${(event) => {
              if (elsewhere) return;
              const here = place(event);
              setAt(here);
              pick(here, size, mode);
            }} onKeyDown=${keyed}></canvas>`
        : html`<div class="shot empty">no picture yet</div>`}
    </figure>
    <section class="tile eyedropper" aria-labelledby="eyedropper-title">
      <h3 id="eyedropper-title">Eyedropper</h3>
      <div class="loupe"><canvas ref=${loupe} role="img" aria-label="the picture under the pointer, enlarged"></canvas>
        <div>
          <p class="mono">${at ? `u ${at.u}  v ${at.v}` : 'u –  v –'}</p>
          <label class="small">patch <select onChange=${(event) => setSize(Number(event.target.value))} value=${size}>
            ${SIZES.map((n) => html`<option value=${n} selected=${n === size}>${n} × ${n} px</option>`)}</select></label>
          <fieldset class="small"><legend class="sr">a click</legend>
            <label class="choice"><input type="radio" name="pick-mode" checked=${mode === 'replace' || (robust && mode === 'widen')} onChange=${() => setMode('replace')} /> ${robust ? "proposes the marker's colour" : 'sets both ranges'}</label>
            ${!robust && html`<label class="choice"><input type="radio" name="pick-mode" checked=${mode === 'widen'} onChange=${() => setMode('widen')} /> widens them</label>`}
            <label class="choice"><input type="radio" name="pick-mode" checked=${mode === 'led'} onChange=${() => setMode('led')} /> is the beacon's LED</label></fieldset>
        </div></div>
      <div id="picked" aria-live="polite" class="small">
        ${failed ? html`<p class="said warning"><span aria-hidden="true">▲</span> ${failed}</p>` : ''}
        ${picked?.colour ? html`<${Marker} picked=${picked} />` : patch
          ? html`<p><span class="swatch" ref=${painted(css([patch.hue, patch.s, patch.v]))}></span>
              H <b>${patch.hue}</b> (${signedRange(patch, 0)}), S <b>${patch.s}</b> (${text('{0} to {1}', patch.low[1], patch.high[1])}), V <b>${patch.v}</b> (${text('{0} to {1}', patch.low[2], patch.high[2])})</p>
            <p>${text('these ranges admit {0} of the picture; {1} of {2} px are connected here', number(100 * picked.admitted_share, 1, '%'), picked.hanging_px, picked.admitted_px)}</p>
            ${picked.warnings.map((one) => html`<p class="said warning"><span aria-hidden="true">▲</span> ${one}</p>`)}`
          : html`<p class="muted">${mode === 'led' ? 'The patch is to be as large as its light reaches.' : live ? 'A click freezes the picture first.' : robust ? 'The patch is to lie within the marker.' : 'Ranges for the clicked patch, with room for the light to change.'}</p>`}
      </div>
    </section>`;
}

/** The marker's colour as the robust method measures it, and what follows from it. */
function Marker({ picked }) {
  const { colour, hue_deg: hue, hues_deg: hues, chroma, chromas, distance, keys, warnings } = picked;
  const proposed = Object.values(keys);
  const far = distance > 1 ? "Another colour than the marker's." : text("{0} of the way from the marker's colour to the limit", number(100 * distance, 0, '%'));
  return html`<p><span class="swatch" ref=${painted(colour)}></span>
      <b class="mono" translate="no">${colour}</b> ${text('hue {0} ({1} to {2}), chroma {3} ({4} to {5})', `${number(hue)}°`, `${number(hues[0])}°`, `${number(hues[1])}°`, number(chroma, 2), number(chromas[0], 2), number(chromas[1], 2))}</p>
    <p>${distance === 0 ? "Of the marker's colour: nothing is to be changed." : far}</p>
    ${warnings.map((one) => html`<p class="said warning"><span aria-hidden="true">▲</span> ${one}</p>`)}
    ${warnings.length > 0 ? html`<p>Nothing is proposed.</p>` : proposed.map((one) => html`<p>${one === null ? "Proposed, and in the settings: no marker colour, for the paper's red takes it in." : text('Proposed, and in the settings: marker colour {0}', one)}</p>`)}`;
}

/** The hues of a patch on the file's scale; they may run over red's zero. */
const signedRange = (patch, axis) => text('{0} to {1}', (patch.low[axis] + 180) % 180, (patch.high[axis] + 180) % 180);
