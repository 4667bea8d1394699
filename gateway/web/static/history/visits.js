// Visits as a table with pictures: those of the window, and older ones on demand; the server filters; the same as CSV.

import { html, useState } from '../lib/page.js';
import { get } from '../lib/api.js';
import { number, px, signed, stamp, words } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { quantity } from '../lib/quantity.js';
import { distance, signedDistance } from '../lib/units.js';
import { VISIT_KINDS, faultsText, usual } from '../lib/history.js';
import { useAnswer } from './answers.js';

const OLDER = 100; // at once

/** Address of a kept picture. */
export const pictureUrl = (bay, { file, place }, width) =>
  `/api/bays/${encodeURIComponent(bay)}/kept-pictures/${file}/${place}.jpg?width=${width}`;

const seconds = (value) => number(value, 0, 's');

/** `every`: the answer with all visits of the window; `place`: of the window; `alarms`: title by kind. */
export function Visits({ bay, every, place, alarms, sinceMs, untilMs, chosen, choose }) {
  const [kind, setKind] = useState('all');
  const [alarm, setAlarm] = useState('');
  const [loaded, setLoaded] = useState({ of: '', visits: [], more: true, wrong: '', busy: false });
  const at = `/api/bays/${encodeURIComponent(bay)}/visits`;
  const filter = `${kind === 'all' ? '' : `&what=${kind}`}${alarm && `&alarm=${alarm}`}`;
  const found = useAnswer(filter ? `${at}?since_ms=${sinceMs}&until_ms=${untilMs}&limit=200${filter}` : null);
  const { answer: view, wrong, busy } = filter ? found : every;
  const of = `${bay}/${place}${filter}`;
  const older = loaded.of === of ? loaded : { of, visits: [], more: true, wrong: '', busy: false };
  const newest = view?.visits ?? [];
  const shown = [...newest, ...older.visits.filter((visit) => visit.begun_ms < (newest.at(-1)?.begun_ms ?? Infinity))];
  const oldestMs = shown.at(-1)?.begun_ms ?? sinceMs;
  const odd = shown.filter((visit) => !usual(visit)).length;
  const csv = `${at}.csv?since_ms=${Math.min(sinceMs, oldestMs)}&until_ms=${untilMs}${filter}`;
  const load = async () => {
    setLoaded({ ...older, busy: true });
    try {
      const more = await get(`${at}?since_ms=0&until_ms=${oldestMs}&limit=${OLDER}${filter}`, { timeoutMs: 20_000 });
      setLoaded({ of, visits: [...shown, ...more.visits], more: more.more, wrong: '', busy: false });
    } catch (error) {
      setLoaded({ ...older, wrong: error.message });
    }
  };
  return html`<section class="panel visits" aria-labelledby="visits-title">
    <header>
      <h2 id="visits-title">Visits <span class="small">${view ? `${shown.length}:` : ''}</span>
        ${view && html` <span class="small">${listed([text('{0} as usual', shown.length - odd), odd > 0 && text('{0} not', odd)])}</span>`}</h2>
      <div class="row compact">
        <select aria-label="which visits" value=${kind} onChange=${(event) => setKind(event.target.value)}>
          ${Object.entries(VISIT_KINDS).map(([key, name]) => html`<option value=${key} selected=${key === kind}>${name}</option>`)}
        </select>
        <select aria-label="which alarm" value=${alarm} onChange=${(event) => setAlarm(event.target.value)}>
          <option value="" selected=${!alarm}>any alarm, or none</option>
          ${Object.entries(alarms).map(([key, title]) => html`<option value=${key} selected=${key === alarm}>${title}</option>`)}
        </select>
        <a class="button" href=${csv} download>CSV</a>
      </div>
    </header>
    ${(wrong || older.wrong) && html`<p class="notice warn small" role="status">${wrong || older.wrong}</p>`}
    <div class="scroll tall" tabindex="0" role="region" aria-label="visits, newest first">
      <table class="stack"><thead><tr><th scope="col">Picture</th><th scope="col">Arrived</th><th scope="col" class="right">Length</th><th scope="col" class="right">In place after</th><th scope="col" class="right">In place</th>
        <th scope="col" class="right">R</th><th scope="col" class="right">Z</th><th scope="col" class="right">Offset</th><th scope="col" class="right">Corrections</th><th scope="col">What else</th></tr></thead><tbody>
        ${shown.map((visit) => html`<tr key=${visit.begun_ms} class=${visit.begun_ms === chosen ? 'chosen' : ''}>
          <td class="thumb">${visit.picture && html`<img loading="lazy" width="96" height="72" alt=${text('when in place, {0}', stamp(visit.picture.t_ms))} src=${pictureUrl(bay, visit.picture, 160)} />`}</td>
          <td><button type="button" class="plain link" aria-pressed=${String(visit.begun_ms === chosen)} onClick=${() => choose(visit)}>${stamp(visit.begun_ms)}</button></td>
          <td class="right nowrap" data-name="length">${quantity(seconds(visit.length_s))}</td>
          <td class="right nowrap" data-name="in place after">${quantity(seconds(visit.to_position_s))}</td>
          <td class="right nowrap" data-name="in place">${quantity(seconds(visit.in_place_s))}</td>
          <td class="right nowrap" data-name="R">${quantity(px(visit.radius_px))}</td>
          <td class="right nowrap" data-name="Z">${quantity(distance(visit.distance_mm))}</td>
          <td class="right nowrap" data-name="offset">${quantity(visit.offset_mm === null ? signed(visit.offset_px, 1, 'px') : signedDistance(visit.offset_mm))}</td>
          <td class="right" data-name="corrections">${number(visit.corrections)}</td>
          <td>${visit.moved !== 'NO' && html`<span class=${`tag ${visit.unintended ? 'bad' : ''}`}>${visit.moved === 'DISTANCE' ? 'moved: distance' : 'moved: marker'}</span> `}
            ${visit.faults.length > 0 && html`<span class="tag warn">${faultsText(visit)}</span> `}
            ${visit.interrupted && html`<span class="tag">interrupted</span> `}
            ${listed([visit.to_position_s === null ? t('never in place') : visit.released_s === null && t('not released'), visit.end !== 'clear' && t(words(visit.end))])}</td>
        </tr>`)}
      </tbody></table>
      ${shown.length === 0 && html`<p class="muted">${busy ? 'Loading.' : filter ? 'No visit fits the filter.' : 'No visit ended in this time.'}</p>`}
      <p class="row compact"><button type="button" disabled=${!view || older.busy || !older.more} onClick=${load}>Older</button>${older.busy ? html`<span class="muted small">Loading.</span>` : !older.more && html`<span class="muted small">These are all that there are.</span>`}</p>
    </div>
  </section>`;
}
