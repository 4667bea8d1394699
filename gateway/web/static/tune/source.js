// What settings are tried on: the running picture, a frozen frame or a recording.

import { html, useRef } from '../lib/page.js';
import { moment, number } from '../lib/format.js';
import { text } from '../lib/lang.js';

const label = (one) =>
  one.kind === 'recording'
    ? `recording ${one.name.slice(1)}, ${moment(one.taken_ms)}, ${one.frames} frames in ${number(one.seconds, 1)} s`
    : one.title ? `${one.title}, ${moment(one.taken_ms)}` : `frame ${one.name.slice(1)}, ${moment(one.taken_ms)}`;
const MAX_BYTES = 8 << 20; // of a file: as the gateway takes it
const MAX_FILES = 8; // at a time: as many as it keeps

/** A picture's file in base64. @param {File} file @returns {Promise<string>} */
export const base64 = (file) => new Promise((resolve, reject) => {
  const reader = new FileReader();
  reader.onload = () => resolve(String(reader.result).split(',')[1] ?? '');
  reader.onerror = () => reject(reader.error);
  reader.readAsDataURL(file);
});

/** What is wrong with the chosen files; empty: nothing. */
export function tooMuch(files) {
  if (files.length > MAX_FILES) return `${files.length} files: at most ${MAX_FILES} at a time are uploaded.`;
  const large = files.find((file) => file.size > MAX_BYTES);
  return large ? text('{0} is larger than {1} MiB.', large.name, MAX_BYTES >> 20) : '';
}

function UploadButton({ take, busy }) {
  const field = useRef(null);
  const chosen = (event) => {
    const files = [...event.target.files];
    event.target.value = '';
    if (files.length) take(files);
  };
  return html`<button type="button" disabled=${busy !== ''} onClick=${() => field.current.click()}>${busy === 'upload' ? 'Uploading…' : 'Upload…'}</button>
    <input ref=${field} type="file" multiple class="sr" tabindex="-1" aria-label="pictures to upload" accept="image/jpeg,image/png" onChange=${chosen} />`;
}

export function SourceBar({ source, taken, freeze, record, upload, choose, busy, working }) {
  const now = taken.find((one) => one.name === source.name);
  return html`<div class="source panel" role="group" aria-label="what settings are tried on">
    <div class="row">
      <button type="button" aria-pressed=${source.kind === 'live'} onClick=${() => choose({ kind: 'live' })}>Live</button>
      <button type="button" disabled=${busy !== ''} onClick=${freeze}>${busy === 'freeze' ? 'Freezing…' : 'Freeze'}</button>
      <button type="button" disabled=${busy !== ''} onClick=${record}>${busy === 'record' ? 'Recording…' : 'Record 3 s'}</button>
      <${UploadButton} take=${upload} busy=${busy} />
      <label class="small">kept <select disabled=${!taken.length} value=${source.name ?? ''} onChange=${(event) => {
        const one = taken.find((each) => each.name === event.target.value);
        if (one) choose({ kind: one.kind, name: one.name, frame: 0 });
      }}>
        ${source.kind === 'live' && html`<option value="" selected>${taken.length ? 'choose…' : 'none yet'}</option>`}
        ${[...taken].reverse().map((one) => html`<option value=${one.name} translate=${one.title ? 'no' : 'yes'} selected=${one.name === source.name}>${label(one)}</option>`)}
      </select></label>
      ${now?.kind === 'recording' && html`<label class="small frame">frame <input type="range" name="frame" min="0" max=${now.frames - 1} value=${source.frame}
        onInput=${(event) => choose({ ...source, frame: Number(event.target.value) })} /> <span class="mono">${source.frame + 1}/${now.frames}</span></label>`}
      <span class="working small muted" hidden=${!working} aria-hidden="true">working…</span>
    </div>
    ${now?.full && html`<p class="said warning"><span aria-hidden="true">▲</span> The recording ended early: its frames are large.</p>`}
  </div>`;
}
