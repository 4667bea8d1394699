// The visits of the window as a table with pictures; a filter; the same as CSV.

import { html, useState } from '../lib/page.js';
import { number, px, signed, stamp, words } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { quantity } from '../lib/quantity.js';
import { distance, signedDistance } from '../lib/units.js';
import { VISIT_KINDS, faultsText, usual } from '../lib/history.js';

/** Address of a kept picture. */
export const pictureUrl = (bay, { file, place }, width) =>
  `/api/bays/${encodeURIComponent(bay)}/kept-pictures/${file}/${place}.jpg?width=${width}`;

const seconds = (value) => number(value, 0, 's');

/** Its words as shown, and in English. */
function searched(visit) {
  const english = [visit.end, visit.moved, ...visit.faults.map((fault) => fault.reason)].filter((name) => name !== 'clear').map(words);
  return [stamp(visit.begun_ms), ...english, ...english.map((word) => t(word)), faultsText(visit)].join(' ').toLowerCase();
}

export function Visits({ bay, view, wrong, busy, sinceMs, untilMs, chosen, choose }) {
  const [kind, setKind] = useState('all');
  const [wanted, setWanted] = useState('');
  const visits = view?.visits ?? [];
  const shown = visits.filter((visit) => VISIT_KINDS[kind][1](visit) && wanted.toLowerCase().split(/\s+/).every((word) => searched(visit).includes(word)));
  const odd = visits.filter((visit) => !usual(visit)).length;
  const csv = `/api/bays/${encodeURIComponent(bay)}/visits.csv?since_ms=${sinceMs}&until_ms=${untilMs}${kind === 'all' ? '' : `&what=${kind}`}`;
  return html`<section class="panel visits" aria-labelledby="visits-title">
    <header>
      <h2 id="visits-title">Visits in this time <span class="small">${view ? `${shown.length}${view.more ? ' newest' : ''}` : ''}</span>
        ${view && html` <span class="small">${listed([text('{0} as usual', visits.filter(usual).length), odd > 0 && text('{0} not', odd)])}</span>`}</h2>
      <div class="row compact">
        <select aria-label="which visits" value=${kind} onChange=${(event) => setKind(event.target.value)}>
          ${Object.entries(VISIT_KINDS).map(([key, [name]]) => html`<option value=${key} selected=${key === kind}>${name}</option>`)}
        </select>
        <input type="search" placeholder="filter" aria-label="filter visits by words" value=${wanted} onInput=${(event) => setWanted(event.target.value)} />
        <a class="button" href=${csv} download>CSV</a>
      </div>
    </header>
    ${wrong && html`<p class="notice warn small" role="status">${wrong}</p>`}
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
          <td>${visit.moved !== 'NO' && html`<span class=${`tag ${visit.unintended ? 'bad' : ''}`}>${text('moved: {0}', t(words(visit.moved)))}</span> `}
            ${visit.faults.length > 0 && html`<span class="tag warn">${faultsText(visit)}</span> `}
            ${visit.interrupted && html`<span class="tag">interrupted</span> `}
            ${listed([visit.to_position_s === null ? t('never in place') : visit.released_s === null && t('not released'), visit.end !== 'clear' && t(words(visit.end))])}</td>
        </tr>`)}
      </tbody></table>
      ${shown.length === 0 && html`<p class="muted">${busy ? 'Loading.' : visits.length ? 'No visit fits the filter.' : 'No visit ended in this time.'}</p>`}
      ${view?.more && html`<p class="muted small">There are older ones: choose a shorter time, or take the CSV file.</p>`}
    </div>
  </section>`;
}
