// What settings are tried on: the running picture, a frozen frame or a recording.

import { html } from '../vendor/preact-htm.js';
import { clock, number } from '../lib/format.js';

const label = (one) =>
  one.kind === 'recording'
    ? `recording ${one.name.slice(1)}, ${clock(one.taken_ms)}, ${one.frames} frames in ${number(one.seconds, 1)} s`
    : `frame ${one.name.slice(1)}, ${clock(one.taken_ms)}`;

export function SourceBar({ source, taken, freeze, record, choose, busy, working }) {
  const now = taken.find((one) => one.name === source.name);
  return html`<div class="source panel" role="group" aria-label="what settings are tried on">
    <div class="row">
      <button type="button" aria-pressed=${source.kind === 'live'} onClick=${() => choose({ kind: 'live' })}>Live</button>
      <button type="button" disabled=${busy !== ''} onClick=${freeze}>${busy === 'freeze' ? 'Freezing…' : 'Freeze'}</button>
      <button type="button" disabled=${busy !== ''} onClick=${record}>${busy === 'record' ? 'Recording…' : 'Record 3 s'}</button>
      <label class="small">kept <select disabled=${!taken.length} value=${source.name ?? ''} onChange=${(event) => {
        const one = taken.find((each) => each.name === event.target.value);
        if (one) choose({ kind: one.kind, name: one.name, frame: 0 });
      }}>
        ${source.kind === 'live' && html`<option value="" selected>${taken.length ? 'choose…' : 'none yet'}</option>`}
        ${[...taken].reverse().map((one) => html`<option value=${one.name} selected=${one.name === source.name}>${label(one)}</option>`)}
      </select></label>
      ${now?.kind === 'recording' && html`<label class="small frame">frame <input type="range" name="frame" min="0" max=${now.frames - 1} value=${source.frame}
        onInput=${(event) => choose({ ...source, frame: Number(event.target.value) })} /> <span class="mono">${source.frame + 1}/${now.frames}</span></label>`}
      <span class="working small muted" hidden=${!working} aria-hidden="true">working…</span>
    </div>
    ${now?.full && html`<p class="said warning"><span aria-hidden="true">▲</span> The recording ended early: its frames are large.</p>`}
  </div>`;
}
