// The history of a bay: a timeline by hour, day or month, its events, its visits, one visit as a film, and why.
// `/history#bay1/1795400040000/day` is a bay, a moment and a length.

import { html, useEffect, useErrorBoundary, useRef, useState } from '../lib/page.js';
import { called } from '../lib/bays.js';
import { stamp, words } from '../lib/format.js';
import { MARKED, SCALES, abnormalEvent, firstScale, hashOf, inputTime, placeOf, spanOf, windowAt } from '../lib/history.js';
import { listed, t, text } from '../lib/lang.js';
import { saidText } from '../lib/said.js';
import { titled } from '../lib/title.js';
import { unixOf } from '../lib/zone.js';
import { start } from '../lib/start.js';
import { Top } from '../lib/top.js';
import { useKept } from '../operator/hooks.js';
import { useAnswer } from './answers.js';
import { Film } from './film.js';
import { Timeline } from './timeline.js';
import { LastTrucks } from './trucks.js';
import { Visits } from './visits.js';
import { Why } from './why.js';

const SCROLL_MS = 200; // before the server is asked, while somebody scrolls
const POINTS = { quarter: 15, hour: 60, shift: 480, day: 480, month: 720 };

function Empty({ records, bay }) {
  return html`<section class="panel" aria-labelledby="empty-title"><h1 id="empty-title">${text('History of {0}', called(bay))}</h1>
    ${!records.recorded
      ? html`<p><b>Nothing is recorded.</b> ${text('Set {0} in the configuration to a folder that lasts, and leave {1} as it is; then start the gateway anew. What is kept, how much, and who sees it: docs/records.md.', 'state_dir', '[records] enabled = true')}</p>`
      : records.why
        ? html`<p class="notice warn"><b>The index of the records cannot be read.</b> ${records.why}</p>`
        : html`<p><b>Nothing is in the index yet.</b> It gets the newest records about once a minute.</p>`}
  </section>`;
}

function Events({ of, wrong, pick }) {
  const events = of.slice(-300).reverse();
  return html`<section class="panel events" aria-labelledby="events-title">
    <header><h2 id="events-title">Events in this time</h2><span class="small muted">a press chooses its moment</span></header>
    ${wrong && html`<p class="notice warn small" role="status">${wrong}</p>`}
    <div class="scroll" tabindex="0" role="region" aria-label="events, newest first"><table class="stack"><tbody>
      ${events.map((event) => html`<tr>
        <td class="nowrap"><button type="button" class="plain link mono" onClick=${() => pick(event.t_ms)}>${stamp(event.t_ms)}</button></td>
        <td class="nowrap">${event.bad ? html`<span class="tag bad">${words(event.kind)}</span>` : words(event.kind)}</td>
        <td>${listed([event.sensor && t(words(event.sensor)), event.quality && event.quality !== 'GOOD' && t(words(event.quality)), saidText(event)])}</td></tr>`)}
    </tbody></table>
    ${events.length === 0 && html`<p class="muted">None.</p>`}</div>
  </section>`;
}

/** Of the address; `number` grows whenever somebody goes to one, be it the same again. @param {string[]} bays */
function usePlace(bays) {
  const [place, setPlace] = useState(() => ({ ...placeOf(location.hash, bays), number: 0 }));
  useEffect(() => {
    const changed = () => setPlace(({ number }) => ({ ...placeOf(location.hash, bays), number: number + 1 }));
    addEventListener('hashchange', changed);
    return () => removeEventListener('hashchange', changed);
  }, []);
  return place;
}

function Bay({ bay, place, records, scale, setScale, technician }) {
  const lastMs = records.last_ms;
  const [atMs, setAtMs] = useState(place.atMs);
  const [middleMs, setMiddleMs] = useState(place.atMs ?? lastMs - SCALES[scale].ms / 2);
  const [visit, setVisit] = useState(null);
  const [asked, setAsked] = useState(place.why ? 1 : 0);
  const { sinceMs, untilMs } = windowAt(middleMs, scale, lastMs);
  const span = `since_ms=${sinceMs}&until_ms=${untilMs}`;
  const at = `/api/bays/${encodeURIComponent(bay)}`;
  const how = { waitMs: SCROLL_MS, key: untilMs >= lastMs ? lastMs : 0 }; // anew when there is more at its end
  const trend = useAnswer(`${at}/trend?${span}&points=${POINTS[scale]}`, how);
  const marks = useAnswer(`${at}/history-events?${span}&limit=1000&${MARKED.map((kind) => `kind=${kind}`).join('&')}`, how);
  const visits = useAnswer(`${at}/visits?${span}&limit=200`, how);

  const address = useRef(location.hash);
  useEffect(() => {
    if (location.hash !== address.current) return; // somebody has gone elsewhere meanwhile
    history.replaceState(null, '', hashOf({ bay, atMs: Math.round(atMs ?? middleMs), scale, why: place.why && atMs === place.atMs }));
    address.current = location.hash;
  }, [bay, atMs, middleMs, scale]);
  const events = (marks.answer?.events ?? []).map((event) => ({ ...event, bad: abnormalEvent(event, visits.answer?.visits ?? []) }));
  const go = (ms) => setMiddleMs(Math.max(0, Math.min(ms, lastMs)));
  const pan = (share) => go((sinceMs + untilMs) / 2 + share * SCALES[scale].ms);
  const choose = (ms) => {
    setAtMs(ms);
    if (ms < sinceMs || ms > untilMs) go(ms);
  };
  const rescale = (name) => {
    if (atMs !== null && atMs >= sinceMs && atMs <= untilMs) setMiddleMs(atMs);
    else if (untilMs >= lastMs) setMiddleMs(lastMs - SCALES[name].ms / 2);
    setScale(name);
  };
  const ask = (ms) => {
    if (ms !== undefined) setAtMs(ms);
    setAsked(asked + 1);
  };
  return html`
    <section class="panel past" aria-labelledby="past-title">
      <header>
        <h1 id="past-title"><span translate="no">${called(bay)}</span>: <span class="value">${`${stamp(sinceMs)} to ${stamp(untilMs)}`}</span></h1>
        <div class="row compact">
          <div class="group" role="group" aria-label="length of the timeline">
            ${Object.entries(SCALES).map(([name, { word }]) => html`<button type="button" aria-pressed=${String(scale === name)} onClick=${() => rescale(name)}>${word}</button>`)}
          </div>
          <div class="group" role="group" aria-label="scroll">
            <button type="button" disabled=${untilMs <= records.first_ms} onClick=${() => pan(-1)}>Earlier</button>
            <button type="button" disabled=${untilMs >= lastMs} onClick=${() => pan(1)}>Later</button>
            <button type="button" disabled=${untilMs >= lastMs} onClick=${() => go(lastMs)}>Newest</button>
          </div>
          <label class="small">moment <input type="datetime-local" step="1" value=${atMs === null ? '' : inputTime(atMs)}
            onChange=${(event) => { const ms = unixOf(event.target.value); if (Number.isFinite(ms)) { setAtMs(ms); go(ms); } }} /></label>
        </div>
      </header>
      ${trend.wrong && html`<p class="notice warn small" role="status">${trend.wrong}</p>`}
      <${Timeline} label="timeline" view=${trend.answer} viewed=${spanOf(trend.path)} busy=${trend.busy} events=${events} sinceMs=${sinceMs} untilMs=${untilMs} atMs=${atMs} pick=${setAtMs} pan=${pan} />
      <p class="small muted">Line: mean; band: least to largest. Hatched: not recorded. Red: stop for a fault. Scroll sideways, or with the arrow keys. ${text('Recorded from {0} to {1}.', stamp(records.first_ms), stamp(lastMs))}</p>
    </section>
    ${visit && html`<${Film} key=${visit.begun_ms} bay=${bay} visit=${visit} pictures=${records.pictures} technician=${technician} ask=${ask} close=${() => setVisit(null)} />`}
    <${Why} bay=${bay} atMs=${atMs} asked=${asked} ask=${() => ask()} />
    <${Events} of=${events} wrong=${marks.wrong} pick=${choose} />
    <${Visits} bay=${bay} every=${visits} place=${`${middleMs}/${scale}`} alarms=${records.alarms} sinceMs=${sinceMs} untilMs=${untilMs}
      chosen=${visit?.begun_ms ?? null} choose=${(one) => setVisit(one.begun_ms === visit?.begun_ms ? null : one)} />`;
}

function App({ session }) {
  const place = usePlace(session.bays);
  const { bay } = place;
  const [kept, keep] = useKept('history.scale', '');
  const wanted = place.scale ?? (Object.hasOwn(SCALES, kept) ? kept : null); // by the address, or at some time before
  const [chosen, setChosen] = useState(wanted);
  const first = useRef({ bay: '', scale: '' });
  const [again, setAgain] = useState(0);
  const records = useAnswer(bay === null ? null : `/api/bays/${encodeURIComponent(bay)}/records`, { key: again });
  useEffect(() => {
    const timer = setInterval(() => !document.hidden && setAgain((n) => n + 1), 60_000); // as often as the index grows
    return () => clearInterval(timer);
  }, []);
  useEffect(() => setChosen(wanted), [place]);
  titled(!bay ? 'History' : 'History of {0}', called(bay ?? ''));
  const setBay = (name) => { location.hash = encodeURIComponent(name); };
  const setScale = (name) => {
    keep(name);
    setChosen(name);
  };
  const view = records.answer?.bay === bay ? records.answer : null;
  if (view && view.last_ms !== null && first.current.bay !== bay) first.current = { bay, scale: firstScale(view.last_ms - view.first_ms) }; // kept while the records grow
  return html`
    <${Top} session=${session} bay=${bay} current="History" next=${location.pathname + location.search + location.hash} choose=${setBay} />
    <main id="main" tabindex="-1" class="page history">
      ${records.wrong && html`<p class="notice bad" role="alert">${records.wrong}</p>`}
      ${view && html`<${LastTrucks} bay=${bay} lastMs=${view.last_ms} />`}
      ${view && (view.last_ms === null
        ? html`<${Empty} records=${view} bay=${bay} />`
        : html`<${Bay} key=${place.number} bay=${bay} place=${place} records=${view} scale=${chosen ?? first.current.scale} setScale=${setScale} technician=${session.role === 'technician'} />`)}
      ${!view && !records.wrong && html`<p class="muted">Loading.</p>`}
    </main>`;
}

function Guarded({ session }) {
  const [fault] = useErrorBoundary((error) => console.error(error));
  if (fault) return html`<main class="page"><p class="notice bad" role="alert"><b>This page has failed.</b> Load it anew.</p><p class="mono small" translate="no">${String(fault.message ?? fault)}</p></main>`;
  return html`<${App} session=${session} />`;
}

start(Guarded);
