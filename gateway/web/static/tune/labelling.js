// The label of a picture: where its marker is. Proposed by the robust method, corrected by dragging or by keys.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { get } from '../lib/api.js';

const RIM = 0.25; // of the radius: so near the rim a pointer takes hold of it
const WIDTH_PX = 1280;
const KEYS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, -1, 0], ArrowDown: [0, 1, 0], '+': [0, 0, 1], '=': [0, 0, 1], '-': [0, 0, -1], _: [0, 0, -1] };
const FIELDS = [['u_px', 'u'], ['v_px', 'v'], ['radius_px', 'R']];
const tenth = (value) => Math.round(value * 10) / 10;

/** A circle in a picture, to be seen on any ground. @param {{circle: any, kind: string, size: any}} props */
export function Ring({ circle, kind, size }) {
  if (!circle) return null;
  const wide = size.width_px / 320;
  const arm = Math.min(circle.radius_px / 4, 6 * wide);
  const shape = (stroke) => html`<g class=${stroke} stroke-width=${stroke === 'halo' ? 2.6 * wide : 1.2 * wide}>
    <circle cx=${circle.u_px + 0.5} cy=${circle.v_px + 0.5} r=${circle.radius_px} />
    <path d=${`M${circle.u_px + 0.5 - arm} ${circle.v_px + 0.5}h${2 * arm}M${circle.u_px + 0.5} ${circle.v_px + 0.5 - arm}v${2 * arm}`} /></g>`;
  return html`<g class="ring">${shape('halo')}${shape(kind)}</g>`;
}

/** The same circle, kept where a label may be. */
const within = (circle, size) => ({
  u_px: tenth(Math.min(size.width_px - 1, Math.max(0, circle.u_px))),
  v_px: tenth(Math.min(size.height_px - 1, Math.max(0, circle.v_px))),
  radius_px: tenth(Math.min(Math.max(size.width_px, size.height_px), Math.max(1, circle.radius_px))),
});

export function Labelling({ url, picture, label, drop, close, busy }) {
  const [found, setFound] = useState(null); // the proposal, and the picture's size
  const [circle, setCircle] = useState(picture.marker);
  const [failed, setFailed] = useState('');
  const overlay = useRef(null);
  const held = useRef(null);
  const heading = useRef(null);
  useEffect(() => {
    heading.current?.focus();
    if (picture.missing) return;
    get(`${url}/proposal`, { timeoutMs: 20_000 }).then(
      (answer) => {
        setFound(answer);
        if (!picture.labelled) setCircle((was) => was ?? answer.marker);
      },
      (error) => setFailed(error.message),
    );
  }, []);
  const set = (next) => setCircle(within(next, found));
  const middle = () => ({ u_px: found.width_px / 2, v_px: found.height_px / 2, radius_px: Math.min(found.width_px, found.height_px) / 6 });
  const place = (event) => {
    const room = overlay.current.getBoundingClientRect();
    return { u: ((event.clientX - room.left) / room.width) * found.width_px - 0.5, v: ((event.clientY - room.top) / room.height) * found.height_px - 0.5 };
  };
  const down = (event) => {
    event.preventDefault();
    overlay.current.focus({ preventScroll: true }); // it would move away under the pointer
    overlay.current.setPointerCapture(event.pointerId);
    const { u, v } = place(event);
    const away = circle ? Math.hypot(u - circle.u_px, v - circle.v_px) : Infinity;
    if (circle && Math.abs(away - circle.radius_px) <= Math.max(RIM * circle.radius_px, found.width_px / 100)) held.current = { rim: true };
    else if (circle && away < circle.radius_px) held.current = { du: circle.u_px - u, dv: circle.v_px - v };
    else {
      held.current = { rim: true };
      set({ u_px: u, v_px: v, radius_px: 1 });
    }
  };
  const move = (event) => {
    const hold = held.current;
    if (!hold) return;
    const { u, v } = place(event);
    setCircle((was) => {
      const next = hold.rim ? { ...was, radius_px: Math.hypot(u - was.u_px, v - was.v_px) } : { ...was, u_px: u + hold.du, v_px: v + hold.dv };
      return within(next, found);
    });
  };
  const up = () => {
    held.current = null;
  };
  const keyed = (event) => {
    const by = KEYS[event.key];
    if (!by || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    const step = event.shiftKey && event.key.startsWith('Arrow') ? 10 : 1;
    const from = circle ?? middle();
    set({ u_px: from.u_px + step * by[0], v_px: from.v_px + step * by[1], radius_px: from.radius_px + step * by[2] });
  };
  const typed = (key) => (event) => {
    const value = Number(event.target.value);
    if (event.target.value.trim() !== '' && Number.isFinite(value)) set({ ...(circle ?? middle()), [key]: value });
  };
  const buttons = html`<div class="row">
    <button type="button" class="primary" disabled=${busy || !found || !circle} onClick=${() => label(circle)}>Marker here</button>
    <button type="button" disabled=${busy || picture.missing} onClick=${() => label(null)}>No marker</button>
    <button type="button" disabled=${busy} onClick=${drop}>Remove picture</button>
    <button type="button" onClick=${close}>Close</button></div>`;
  return html`<section class="labelling" aria-labelledby="labelling-title">
    <h3 id="labelling-title" tabindex="-1" ref=${heading}>What is in this picture? <span class="small mono" translate="no">${picture.file}</span></h3>
    ${failed && html`<p class="notice bad" role="alert">${failed}</p>`}
    ${picture.missing && html`<p class="notice warn">This picture has a label, but its file is gone.</p>`}
    ${!picture.missing && found && html`<div class="place"><div class="stack"><img class="shot" alt="the picture that is labelled" src=${`${url}?width=${Math.min(found.width_px, WIDTH_PX)}`} />
      <svg ref=${overlay} class="overlay" viewBox=${`0 0 ${found.width_px} ${found.height_px}`} tabindex="0" role="application"
        aria-label="the marker's circle; arrow keys move it, Shift by ten, plus and minus change its radius" onPointerDown=${down} onPointerMove=${move} onPointerUp=${up} onPointerCancel=${up} onKeyDown=${keyed}>
        <${Ring} circle=${circle} kind="label" size=${found} /></svg></div>
      <div><p class="hint">Drag inside the circle to move it, at its rim to change its size, or outside to draw another one from its centre. It goes round the rim of the marker, also where that is hidden.</p>
      <div class="row">${FIELDS.map(([key, name]) => html`<label class="small">${name} <input class="field" inputmode="decimal" size="6" value=${circle ? circle[key] : ''} onChange=${typed(key)} /> <span class="unit">px</span></label>`)}
        ${found.marker
          ? html`<button type="button" disabled=${busy} onClick=${() => setCircle(found.marker)}>As the robust method finds it</button>`
          : html`<span class="small muted">The robust method is sure of no marker here.</span>`}</div>${buttons}</div></div>`}
    ${!picture.missing && !found && !failed && html`<p class="muted">Loading…</p>`}
    ${(picture.missing || !found) && buttons}
  </section>`;
}
