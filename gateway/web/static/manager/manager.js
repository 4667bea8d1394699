// The manager's page: what a bay did on some days. `/manager?bay=bay1&from=2026-11-17&to=2026-11-23`; it prints on A4.

import { html, useEffect, useState } from '../lib/page.js';
import { get, toLogin } from '../lib/api.js';
import { called } from '../lib/bays.js';
import { between, isDay, stampOf, spans } from '../lib/days.js';
import { text } from '../lib/lang.js';
import { titled } from '../lib/title.js';
import { guarded, start } from '../lib/start.js';
import { Top } from '../lib/top.js';
import { Patterns } from './charts.js';
import { Accuracy, AlarmDays, Alarms, Causes, DayTable, DayTimes, Distance, KeyFigures, ToPosition, Trucks } from './panels.js';

const TIMEOUT_MS = 60_000; // a quarter of a year, on a busy machine
const MOST_DAYS = 92;

/** What is asked for stands in the address, so that it can be kept and sent. */
function asked(session) {
  const query = new URLSearchParams(location.search);
  const bay = session.bays.includes(query.get('bay')) ? query.get('bay') : session.bays[0];
  const day = (name) => (isDay(query.get(name)) ? query.get(name) : null);
  return { bay, first: day('from'), last: day('to') };
}

function queryOf({ first, last }) {
  const query = new URLSearchParams();
  if (first) query.set('from', first);
  if (last) query.set('to', last);
  return query.toString();
}

function useStatistics(wanted) {
  const [got, setGot] = useState({ view: null, wrong: '', of: '' });
  const path = `/api/bays/${encodeURIComponent(wanted.bay)}/statistics?${queryOf(wanted)}`;
  useEffect(() => {
    const end = new AbortController();
    (async () => {
      try {
        const view = await get(path, { signal: end.signal, timeoutMs: TIMEOUT_MS });
        setGot({ view, wrong: '', of: path });
      } catch (error) {
        if (end.signal.aborted) return;
        if (error.status === 401) toLogin();
        setGot({ view: null, wrong: error.name === 'TypeError' ? 'no connection to the gateway' : error.message, of: path });
      }
    })();
    return () => end.abort();
  }, [path]);
  return { ...got, waiting: got.of !== path, path };
}

function Choice({ wanted, view, go }) {
  const first = wanted.first ?? view?.first ?? '';
  const last = wanted.last ?? view?.last ?? '';
  const pick = (name) => (event) => {
    if (!isDay(event.target.value)) return;
    const next = { ...wanted, first, last, [name]: event.target.value };
    if (next.first > next.last) next[name === 'first' ? 'last' : 'first'] = event.target.value;
    go(next);
  };
  return html`<form class="panel across choice row compact" aria-label="which days" onSubmit=${(event) => event.preventDefault()}>
    ${view && html`<div class="group" role="group" aria-label="usual spans">
      ${spans(view.made.slice(0, 10)).map(([name, from, to]) => html`<button type="button" aria-pressed=${String(first === from && last === to)} onClick=${() => go({ ...wanted, first: from, last: to })}>${name}</button>`)}</div>`}
    <label>from <input type="date" value=${first} onChange=${pick('first')} /></label>
    <label>to <input type="date" value=${last} onChange=${pick('last')} /></label>
    ${view && html`<span class="push row">
      <a class="button" href=${`/api/bays/${encodeURIComponent(wanted.bay)}/statistics.csv?${queryOf({ first, last })}`}>CSV</a>
      <button type="button" onClick=${() => print()}>Print</button>
    </span>`}
  </form>`;
}

function Head({ view }) {
  const days = between(view.first, view.last);
  return html`<div class="across head"><h1>${text('{0}: what the bay did', called(view.bay))}</h1>
    <p><span translate="no">${view.site}, ${view.instance}</span> · <b>${view.last !== view.first ? text('{0} to {1}', view.first, view.last) : view.first}</b> · ${days === 1 ? text('one day of {0}', view.time_zone) : text('{0} days of {1}', days, view.time_zone)} · ${`made ${stampOf(view.made)}`}</p></div>`;
}

function Nothing({ view }) {
  return html`<p class="notice across" role="status"><b>Nothing is recorded of these days.</b> ${view.recorded_from
    ? `There are records from ${stampOf(view.recorded_from)} to ${stampOf(view.recorded_to)}: choose days between them.`
    : text('There are no records of {0} yet: the first minute appears here about two minutes after the gateway has begun to record.', view.bay)}</p>`;
}

const Unavailable = ({ wrong }) => html`<div class="notice warn across" role="alert"><p><b>There are no figures to show</b>: ${wrong}.</p>
  ${/nothing is recorded/.test(wrong) && html`<p class="small">They are made of the gateway's records, which need a folder. In the configuration's file:</p>
  <pre class="mono small" translate="no">state_dir = "/var/lib/loading-gateway"${'\n\n'}[records]${'\n'}enabled = true</pre>`}</div>`;

function App({ session }) {
  const [wanted, setWanted] = useState(() => asked(session));
  const { view, wrong, waiting } = useStatistics(wanted);
  useEffect(() => {
    const back = () => setWanted(asked(session));
    addEventListener('popstate', back);
    return () => removeEventListener('popstate', back);
  }, []);
  const go = (next) => {
    const days = queryOf(next);
    history.pushState(null, '', `?bay=${encodeURIComponent(next.bay)}${days && `&${days}`}`);
    setWanted(next);
  };
  titled('{0}: what the bay did', called(wanted.bay));
  const tooMany = wanted.first && wanted.last && between(wanted.first, wanted.last) > MOST_DAYS;
  return html`
    <${Top} session=${session} title=${view?.site} more=${view?.instance ?? ''} bay=${wanted.bay} current="Report" choose=${(bay) => go({ ...wanted, bay })} />
    <${Patterns} />
    <main id="main" tabindex="-1" class="page manager" aria-busy=${String(waiting)}>
      <${Choice} wanted=${wanted} view=${view} go=${go} />
      ${!view && html`<h1 class="sr">${text('{0}: what the bay did', wanted.bay)}</h1>`}
      ${waiting && html`<p class="across muted" role="status">Reading the records …</p>`}
      ${!waiting && wrong && (tooMany ? html`<p class="notice warn across" role="alert">${wrong}</p>` : html`<${Unavailable} wrong=${wrong} />`)}
      ${view && html`<${Head} view=${view} />
        ${view.remarks.length > 0 && html`<div class="notice warn across" role="status">${view.remarks.map((text) => html`<p>${text}</p>`)}</div>`}
        ${view.times.recorded_s <= 0 && view.positions.trucks === 0
          ? html`<${Nothing} view=${view} />`
          : html`<${KeyFigures} view=${view} />
            <${Trucks} view=${view} /><${DayTimes} view=${view} />
            <${ToPosition} view=${view} /><${Distance} view=${view} />
            <div class="pile"><${Accuracy} view=${view} /><${Causes} view=${view} /></div>
            <div class="pile"><${AlarmDays} view=${view} /><${Alarms} view=${view} /></div>
            <${DayTable} view=${view} />`}`}
    </main>`;
}

start(guarded(App));
