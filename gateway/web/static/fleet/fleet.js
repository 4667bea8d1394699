// The fleet page: all bays whose gateways are heard, the ones to look at first. It only reads.

import { html, useEffect, useMemo, useState } from '../lib/page.js';
import { get, pause, toLogin } from '../lib/api.js';
import { age, known, NONE, number, stamp } from '../lib/format.js';
import { text } from '../lib/lang.js';
import { guarded, start } from '../lib/start.js';
import { Brand, SessionMenu } from '../lib/top.js';

const PERIOD_MS = 2000;
const MINUTE_MS = 60_000;
/** With more rows the sites are closed at first. */
const MANY = 1000;
const NE107 = {
  FAILURE: 'failure',
  FUNCTION_CHECK: 'function check',
  OUT_OF_SPECIFICATION: 'out of specification',
  MAINTENANCE_REQUIRED: 'maintenance required',
  GOOD: 'good',
};

/** Asked for again and again; rows that have not changed stay the same objects, so that they are not drawn again. */
function useFleet() {
  const [fleet, setFleet] = useState({ rows: null, wrong: '' });
  useEffect(() => {
    const end = new AbortController();
    let drawn = new Map();
    (async () => {
      while (!end.signal.aborted) {
        try {
          const got = await get('/api/fleet', { signal: end.signal });
          const rows = got.rows.map((row) => {
            const now = JSON.stringify({ ...row, heard_ms: null });
            const before = drawn.get(keyOf(row));
            return before?.now === now ? before : { ...row, now };
          });
          drawn = new Map(rows.map((row) => [keyOf(row), row]));
          setFleet({ ...got, rows, wrong: '' });
        } catch (error) {
          if (end.signal.aborted) return;
          if (error.status === 401) return toLogin();
          setFleet((before) => ({ ...before, wrong: error.name === 'TypeError' ? 'no connection' : error.message }));
        }
        await pause(PERIOD_MS, end.signal);
      }
    })();
    return () => end.abort();
  }, []);
  return fleet;
}

const keyOf = (row) => `${row.site}/${row.instance}/${row.bay}`;
const nameOf = (row) => row.bay || row.instance;
const isLive = (row) => row.life === 'online';
/** The bay's own page on its gateway. */
const pageOf = (row) => `${row.pages.split('#')[0]}#${encodeURIComponent(row.bay)}`;

/** Sites in order, each with its rows: those that are not heard first. */
function bySite(rows) {
  const sites = new Map(rows.map((row) => [row.site, []]));
  for (const row of rows) if (!isLive(row)) sites.get(row.site).push(row);
  for (const row of rows) if (isLive(row)) sites.get(row.site).push(row);
  return sites;
}

/** What of a row a search looks at. */
const searched = (row) => [row.site, row.instance, row.bay, row.title, row.version, row.life, row.ne107, row.reason, ...row.attention].join(' ').toLowerCase();

/** To the minute. */
const since = (ms) => age(Math.max(1, Math.round(ms / MINUTE_MS)) * MINUTE_MS).replace(/ 0\u202fs$/, '');

const Alarms = ({ alarms }) =>
  alarms === null ? NONE : html`<span translate="no" title=${text('active alarms: {0} high, {1} medium, {2} low', ...alarms)}>${alarms.join(' / ')}</span>`;

function Row({ row, chosen, choose, nowMs }) {
  const live = isLive(row);
  return html`<tr class=${chosen ? 'chosen' : ''} data-attention=${row.attention.length ? 'yes' : 'no'}>
    <th scope="row"><button type="button" class="plain" translate="no" aria-expanded=${String(chosen)} onClick=${() => choose(row)}>${nameOf(row)}</button>${row.title && html` <span class="muted small" translate="no">${row.title}</span>`}</th>
    <td class=${live && row.ne107 === 'GOOD' ? '' : 'mark'}>${live ? (NE107[row.ne107] ?? 'not known') : row.life}</td>
    <td class="why">${row.attention.filter((one) => one !== row.life && one !== NE107[row.ne107]).map((one) => html`<span class="mark">${one}</span>`)}</td>
    <td>${row.function_check && row.function_check !== 'OFF' ? 'yes' : ''}</td>
    <td class="number" translate="no"><${Alarms} alarms=${row.alarms} /></td>
    <td class="number" translate="no">${known(row.veil) ? number(100 * row.veil, 0, '%') : NONE}</td>
    <td class="number" translate="no">${known(row.marker_days) ? number(row.marker_days, 0, 'd') : NONE}</td>
    <td class="number" translate="no">${known(row.certificate_days) ? number(row.certificate_days, 0, 'd') : NONE}</td>
    <td class="number" translate="no">${known(row.last_visit_ms) ? since(nowMs - row.last_visit_ms) : NONE}</td>
    <td translate="no">${row.version || NONE}</td>
    <td>${row.pages && html`<a href=${pageOf(row)} rel="noreferrer">open</a>`}</td>
  </tr>`;
}

const drawn = new WeakMap();

/** The row as it was drawn before, where it would look the same: then nothing of it is compared. */
function drawnRow(row, chosen, choose, minute) {
  const look = `${chosen} ${minute}`;
  const before = drawn.get(row);
  if (before?.look === look) return before.node;
  const node = html`<${Row} key=${keyOf(row)} row=${row} chosen=${chosen} choose=${choose} nowMs=${minute * MINUTE_MS} />`;
  drawn.set(row, { look, node });
  return node;
}

function useDetail(row) {
  const [detail, setDetail] = useState({ of: '', got: null, wrong: '' });
  const of = row === undefined ? '' : `${encodeURIComponent(row.site)}/${encodeURIComponent(row.instance)}`;
  useEffect(() => {
    if (of === '') return;
    const end = new AbortController();
    get(`/api/fleet/${of}`, { signal: end.signal })
      .then((got) => setDetail({ of, got, wrong: '' }))
      .catch((error) => {
        if (!end.signal.aborted) setDetail({ of, got: null, wrong: error.message });
      });
    return () => end.abort();
  }, [of, row?.now]);
  return detail.of === of ? detail : { got: null, wrong: '' };
}

const TRENDS = { veil: 'dust', visible: 'rim that is seen', contrast: "rim's contrast" };
const DAY_MS = 86_400_000;
const TREND_DAYS = 14;

/** Of one bay, what is known of the last days. */
function trendsOf(samples, bay) {
  const own = samples.filter((one) => one.bay === bay);
  const series = Object.keys(TRENDS).map((name) => ({ name, points: own.filter((one) => known(one[name])).map((one) => [one.t_ms, one[name]]) }));
  return series.filter((one) => one.points.length);
}

/** A small line: the worst of every four hours. Its height is all of a share, or of what was seen. */
function Trend({ name, points }) {
  const most = Math.max(1, ...points.map(([, value]) => value));
  const end = points[points.length - 1];
  const x = (ms) => 200 - ((end[0] - ms) / (TREND_DAYS * DAY_MS)) * 200;
  const y = (value) => 30 - (Math.max(0, value) / most) * 28;
  const line = points.map(([ms, value]) => `${x(ms).toFixed(1)},${y(value).toFixed(1)}`).join(' ');
  const first = text('{0} days ago: {1}', Math.round((end[0] - points[0][0]) / DAY_MS), number(100 * points[0][1], 0, '%'));
  return html`<div class="trend"><span>${TRENDS[name]}</span>
    <svg viewBox="0 0 200 32" role="img" aria-label=${first}><title>${first}</title><polyline points=${line} /><circle cx=${x(end[0])} cy=${y(end[1])} r="2" /></svg>
    <span class="number" translate="no">${number(100 * end[1], 0, '%')}</span></div>`;
}

/** All that is known of one gateway. */
function Detail({ row, close }) {
  const { got, wrong } = useDetail(row);
  const own = got?.status?.gateway;
  const fact = (name, value) => html`<dt>${name}</dt><dd translate="no">${value || NONE}</dd>`;
  if (row === undefined) return html`<aside class="panel detail empty" aria-label="gateway"><p class="muted">Click a bay: what is known of its gateway.</p></aside>`;
  return html`<aside class="panel detail" aria-label="gateway">
    <h2><span translate="no">${row.site} / ${row.instance}</span> <button type="button" class="plain push" onClick=${close}>Close</button></h2>
    ${wrong && html`<p class="notice bad" role="alert">${wrong}</p>`}
    ${got && html`<dl>
      ${fact('heard last', known(got.heard_ms) ? stamp(got.heard_ms) : '')}
      ${fact('configuration in force', own?.configuration?.in_force?.slice(0, 16))}
      ${fact('reviewed', own?.configuration?.reviewed?.slice(0, 16))}
      ${fact('in the inventory', got.expected?.digest.slice(0, 16))}
      ${fact('version', got.status?.version)}
      ${fact('newest update', own?.update && `${own.update.stage ?? ''} ${own.update.outcome ?? ''}`)}
      ${fact('certificates, days', own && Object.entries(own.certificate_days ?? {}).map(([name, days]) => `${name} ${days}`).join(', '))}
    </dl>
    ${trendsOf(got.trends, row.bay).map((one) => html`<${Trend} key=${one.name} ...${one} />`)}
    <h3>Changes</h3>
    ${!got.kept && html`<p class="muted">The database does not answer: only what waits to be kept.</p>`}
    ${got.changes.length ? html`<ul class="changes">${got.changes.map((one) => html`<li translate="no">${stamp(one.t_ms)} ${one.what}: ${short(one.was) || NONE} → ${short(one.now) || NONE}</li>`)}</ul>` : html`<p class="muted">none since this page's program listens</p>`}`}
  </aside>`;
}

const short = (value) => (/^[0-9a-f]{64}$/.test(value) ? value.slice(0, 16) : value);

/** Each with its width: the tables of all sites have the same columns. */
const HEADS = { bay: 11.5, health: 7.5, 'look at': 9.4, 'function check': 4.5, alarms: 4.5, dust: 3.5, marker: 3.5, certificate: 4.5, 'last truck': 4.5, version: 4, pages: 3.6 };

function Site({ site, rows, open, many, chosen, choose, nowMs }) {
  const [shown, setShown] = useState(!many);
  const wrong = rows.filter((row) => row.attention.length).length;
  return html`<section class="site">
    <h2><button type="button" class="plain" aria-expanded=${String(shown || open)} onClick=${() => setShown(!shown)}><b translate="no">${site}</b> <span class="muted">${wrong ? text('{0} of {1} bays need a look', wrong, rows.length) : text('bays: {0}', rows.length)}</span></button></h2>
    ${(shown || open) && html`<table class="fleet"><thead><tr>${Object.entries(HEADS).map(([head, width]) => html`<th scope="col" style=${{ width: `${width}rem` }}>${head}</th>`)}</tr></thead>
      <tbody>${rows.map((row) => drawnRow(row, keyOf(row) === chosen, choose, Math.floor(nowMs / MINUTE_MS)))}</tbody></table>`}
  </section>`;
}

function FleetPage({ session }) {
  const fleet = useFleet();
  const [search, setSearch] = useState('');
  const [only, setOnly] = useState(false);
  const [chosen, setChosen] = useState('');
  const words = search.toLowerCase().split(/\s+/).filter(Boolean);
  const found = useMemo(
    () => (fleet.rows ?? []).filter((row) => (!only || row.attention.length) && words.every((word) => searched(row).includes(word))),
    [fleet.rows, only, search],
  );
  const sites = useMemo(() => bySite(found), [found]);
  const detail = found.find((row) => keyOf(row) === chosen);
  const count = (fleet.rows ?? []).filter((row) => row.attention.length).length;
  return html`<header class="top"><${Brand} title="Fleet" /><div class="facts push"><${SessionMenu} session=${session} /></div></header>
  <main class="page fleet" id="main" tabindex="-1">
    <h1>All bays</h1>
    ${fleet.wrong && html`<p class="notice bad" role="alert"><b>Nothing new arrives.</b> ${fleet.wrong}</p>`}
    ${fleet.rows && !fleet.wrong && !fleet.connected && html`<p class="notice bad" role="alert"><b>No connection to the broker.</b> <span translate="no">${fleet.broker}</span></p>`}
    ${fleet.kept === false && html`<p class="notice" role="alert"><b>The database does not answer.</b> What is heard is shown, and changes wait.</p>`}
    <form class="row compact" onSubmit=${(event) => event.preventDefault()}>
      <label>search <input type="search" value=${search} onInput=${(event) => setSearch(event.target.value)} /></label>
      <label><input type="checkbox" checked=${only} onChange=${(event) => setOnly(event.target.checked)} /> only what needs a look</label>
      <span role="status">${fleet.rows === null ? 'loading' : text('{0} of {1} bays need a look; {2} shown', count, fleet.rows.length, found.length)}</span>
      <span class="push muted">This page can't change anything at a bay.</span>
    </form>
    <div class="beside">
      <div class="sites">
        ${[...sites].map(([site, rows]) => html`<${Site} key=${site} site=${site} rows=${rows} open=${words.length > 0 || only} many=${fleet.rows.length > MANY} chosen=${chosen} choose=${(row) => setChosen((before) => (keyOf(row) === before ? '' : keyOf(row)))} nowMs=${fleet.now_ms} />`)}
      </div>
      <${Detail} row=${detail} close=${() => setChosen('')} />
    </div>
    ${fleet.rows?.length === 0 && html`<p class="notice">No gateway was heard yet.</p>`}
  </main>`;
}

start(guarded(FleetPage));
