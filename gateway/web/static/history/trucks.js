// The last trucks of a bay, the newest first; a press asks why at the moment that matters.

import { html } from '../lib/page.js';
import { moment, number, stamp } from '../lib/format.js';
import { text } from '../lib/lang.js';
import { BAD, hashOf, momentOf, usual, verdict } from '../lib/history.js';
import { useFetched } from '../operator/hooks.js';
import { pictureUrl } from './visits.js';

const SHOWN = 6;

/** `lastMs`: the end of what is recorded, null: nothing is, undefined: not known yet; it is asked for anew when that has grown, about once a minute. */
export function LastTrucks({ bay, lastMs }) {
  const at = `/api/bays/${encodeURIComponent(bay)}`;
  const [view, wrong] = useFetched(`${at}/visits?since_ms=0&limit=${SHOWN}`, lastMs, 0, typeof lastMs === 'number');
  const visits = view?.bay === bay && lastMs !== null ? view.visits : [];
  const odd = visits.filter((visit) => visit.unintended || visit.faults.length);
  const kinds = [...BAD].map((kind) => `&kind=${kind}`).join('');
  const [marks] = useFetched(`${at}/history-events?since_ms=${odd.at(-1)?.begun_ms}&limit=1000${kinds}`, lastMs, 0, odd.length > 0);
  const events = marks?.bay === bay ? marks.events : [];
  if (lastMs === null || wrong) return '';
  return html`<section class="panel trucks" aria-labelledby="trucks-title">
    <header><h2 id="trucks-title">Last trucks</h2><span class="small muted">a press asks why</span></header>
    <ol>${visits.map((visit) => html`<li key=${visit.begun_ms}><a href=${`/history${hashOf({ bay, atMs: momentOf(visit, events), scale: 'quarter', why: true })}`}>
      <span class="photo">${visit.picture && html`<img loading="lazy" alt=${text('when in place, {0}', stamp(visit.picture.t_ms))} src=${pictureUrl(bay, visit.picture, 160)} />`}</span>
      <span class="told"><b>${moment(visit.begun_ms)}</b>
        <span class="small">${text('in place {0}', number(visit.in_place_s, 0, 's'))}</span>
        <span class=${usual(visit) ? 'small' : `tag ${visit.unintended ? 'bad' : visit.faults.length ? 'warn' : ''}`}>${verdict(visit)}</span></span></a></li>`)}${/* places of those to come, so that nothing moves */ Array.from({ length: SHOWN - visits.length }, (_, n) => html`<li key=${n}></li>`)}
    </ol>
  </section>`;
}

/** The same where nobody knows how far the records go; without recordings it is nothing. */
export function RecordedTrucks({ bay }) {
  const [records, wrong] = useFetched(`/api/bays/${encodeURIComponent(bay)}/records`, '', 60_000); // as often as the index grows
  return html`<${LastTrucks} bay=${bay} lastMs=${records?.bay === bay ? records.last_ms : wrong ? null : undefined} />`;
}
