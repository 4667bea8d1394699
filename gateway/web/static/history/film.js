// One visit again: its kept pictures as a film, with the trend of the visit beside it.

import { html, useEffect, useState } from '../lib/page.js';
import { below } from '../lib/address.js';
import { clock, number, stamp, words } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { frameMs, pictureAt, spanOf } from '../lib/history.js';
import { useAnswer } from './answers.js';
import { Timeline } from './timeline.js';
import { pictureUrl } from './visits.js';

const AROUND_MS = 5000; // before the truck came and after it had gone
const LONGEST_MS = 2 * 3_600_000; // of the values that are read from the recording itself
const POINTS = 240;
const SPEEDS = [0.5, 1, 2, 4];

export function Film({ bay, visit, pictures: allowed, technician, ask, close }) {
  const at = `/api/bays/${encodeURIComponent(bay)}`;
  const sinceMs = Math.max(0, visit.begun_ms - AROUND_MS);
  const untilMs = visit.begun_ms + Math.round(1000 * visit.length_s) + AROUND_MS;
  const span = `since_ms=${sinceMs}&until_ms=${untilMs}`;
  const values = useAnswer(untilMs - sinceMs <= LONGEST_MS ? `${at}/values?${span}&points=${POINTS}` : `${at}/trend?${span}&points=${POINTS}`, { timeoutMs: 110_000 });
  const kept = useAnswer(allowed === 'not_for_you' ? null : `${at}/kept-pictures?${span}&limit=1000`);
  const pictures = kept.answer?.pictures ?? [];
  const [n, setN] = useState(0);
  const [playing, setPlaying] = useState(false);
  const [speed, setSpeed] = useState(1);
  const shown = pictures[Math.min(n, pictures.length - 1)] ?? null;
  const url = (picture) => pictureUrl(bay, picture, 640);

  useEffect(() => {
    setN(0);
    setPlaying(false);
  }, [visit.begun_ms]);
  useEffect(() => {
    if (pictures.length && visit.frame_ms !== null) setN(pictureAt(pictures, visit.frame_ms));
  }, [kept.answer]);
  useEffect(() => {
    if (!playing || !shown) return undefined;
    const wait = frameMs(pictures, n, speed);
    if (wait === null) {
      setPlaying(false);
      return undefined;
    }
    let timer = 0;
    let ended = false;
    const next = new Image(); // shown when it is there, and not before its time
    const due = performance.now() + wait;
    const turn = () => {
      if (!ended) timer = setTimeout(() => setN(n + 1), Math.max(0, due - performance.now()));
    };
    next.onload = turn;
    next.onerror = turn;
    next.src = below(url(pictures[n + 1]));
    return () => {
      ended = true;
      clearTimeout(timer);
    };
  }, [playing, n, speed, kept.answer]);

  const play = () => {
    if (!playing && n >= pictures.length - 1) setN(0);
    setPlaying(!playing);
  };
  const why = allowed === 'not_for_you' ? 'Kept pictures are not for this role (records.pictures_for).' : kept.wrong || (kept.busy ? 'Loading.' : 'No picture of this visit was kept.');
  return html`<section class="panel film" aria-labelledby="film-title">
    <header>
      <h2 id="film-title">${text('Visit of {0}, {1}', stamp(visit.begun_ms), number(visit.length_s, 0, 's'))}</h2>
      <div class="row compact">${shown && html`<button type="button" onClick=${() => ask(shown.t_ms)}>Why, at this picture?</button>`}${technician && html`<a class="button" href=${`${at}/visits/${visit.begun_ms}/evidence.zip`} download>Evidence</a>`}<button type="button" onClick=${close}>Close</button></div>
    </header>
    <div class="both">
      <div>
        <figure class="screen">
          ${shown ? html`<img src=${url(shown)} alt=${text('frame {0} of {1}', shown.frame_id, stamp(shown.t_ms, { ms: true }))} />` : html`<p class="no-picture"><span>${why}</span></p>`}
          <figcaption class="small row spread">${shown && html`<span class="value">${stamp(shown.t_ms, { ms: true })}</span><span>${listed([text('frame {0}, kept for {1}', shown.frame_id, shown.why.map((one) => t(words(one))).join(', ')), shown.changed], '; ')}</span>`}</figcaption>
        </figure>
        <div class="row compact controls">
          <button type="button" class="primary" disabled=${pictures.length < 2} onClick=${play}>${playing ? 'Pause' : 'Play'}</button>
          <button type="button" disabled=${n <= 0} aria-label="one picture back" onClick=${() => setN(n - 1)}>‹</button>
          <button type="button" disabled=${n >= pictures.length - 1} aria-label="one picture on" onClick=${() => setN(n + 1)}>›</button>
          <input type="range" min="0" max=${Math.max(0, pictures.length - 1)} value=${n} disabled=${pictures.length < 2} aria-label="picture"
            aria-valuetext=${shown ? text('{0} of {1}, {2}', n + 1, pictures.length, clock(shown.t_ms)) : 'none'} onInput=${(event) => { setPlaying(false); setN(Number(event.target.value)); }} />
          <span class="small nowrap">${pictures.length ? text('{0} of {1}', n + 1, pictures.length) : '0'}</span>
          <select aria-label="speed" value=${speed} onChange=${(event) => setSpeed(Number(event.target.value))}>${SPEEDS.map((one) => html`<option value=${one} selected=${one === speed}>${one} ×</option>`)}</select>
        </div>
      </div>
      <div>
        ${values.wrong && html`<p class="notice warn small" role="status">${values.wrong}</p>`}
        <${Timeline} label="visit" view=${values.answer} viewed=${spanOf(values.path)} busy=${values.busy} events=${[]} sinceMs=${sinceMs} untilMs=${untilMs} atMs=${shown?.t_ms ?? null}
          pick=${(ms) => { setPlaying(false); setN(pictureAt(pictures, ms)); }} />
        ${values.busy && html`<p class="muted small">Reading the recording.</p>`}
      </div>
    </div>
  </section>`;
}
