// The operator's page: all bays, or one of them. `/#bay1` is one.

import { html, useEffect, useErrorBoundary, useRef, useState } from '../lib/page.js';
import { decoded } from '../lib/address.js';
import { called, titleOf } from '../lib/bays.js';
import { age, clock } from '../lib/format.js';
import { LIMIT_MS, OVERVIEW_LIMIT_MS } from '../lib/freshness.js';
import { beginKiosk, keepAwake, kiosk, watchIdle } from '../lib/kiosk.js';
import { text } from '../lib/lang.js';
import { titled } from '../lib/title.js';
import { start } from '../lib/start.js';
import { Top } from '../lib/top.js';
import { RecordedTrucks } from '../history/trucks.js';
import { aimOf, cameraFault, limitsOf, standing } from '../lib/views.js';
import { Alarms } from './alarms.js';
import { Bars } from './bars.js';
import { Decision } from './decision.js';
import { Events } from './events.js';
import { Health } from './health.js';
import { Age, useAtMost, useFetched, useHash, useLive, useMedia } from './hooks.js';
import { Notice } from './notice.js';
import { Overview } from './overview.js';
import { LivePicture } from './picture.js';
import { Registers } from './registers.js';
import { Health as Sign } from './signs.js';
import { Trend } from './trend.js';

/** `known`: what came last is still true. */
function Link({ live, known, began }) {
  const ageMs = live.ageMs(live.last?.alarms.age_ms);
  if (known) return html`<${Sign} state="ok" text="connected" />`;
  if (!live.connected && performance.now() - began < 2000) return html`<${Sign} state="off" text="connecting" />`;
  return html`<${Sign} state="bad" text=${live.connected ? (Number.isFinite(ageMs) ? text('no data for {0}', age(ageMs)) : 'no data') : 'NO CONNECTION'} />`;
}

function Bar({ session, bay, bays, live, known, alarms }) {
  const began = useRef(performance.now());
  const view = live.last;
  const site = view?.bays.find((one) => one.state !== null)?.state ?? {};
  const [wall, setWall] = useState(Date.now());
  useEffect(() => {
    const timer = setInterval(() => setWall(Date.now()), 1000);
    return () => clearInterval(timer);
  }, []);
  const apart = known ? Math.abs(view.server_time_ms - wall) : 0;
  const facts = html`<${Link} live=${live} known=${known} began=${began.current} />
    <span class="nowrap">${clock(wall)}${apart > 5000 ? html` <span class="tag warn" title="the gateway's clock and this computer's differ">${text('clocks {0} apart', age(apart))}</span>` : ''}</span>`;
  return html`<${Top} session=${session} title=${site.site} more=${session.bays.length === 1 && titleOf(bay) ? titleOf(bay) : site.instance ?? ''} bay=${bay} current="Live" alarms=${alarms} next="/" facts=${facts}>${bays}<//>`;
}

function BayBar({ names, bay, alarmsOf, highestOf }) {
  const at = names.indexOf(bay);
  const go = (name) => { location.hash = encodeURIComponent(name); };
  if (names.length <= 6)
    return html`<nav class="bays" aria-label="bays">
      <a href="#" class="button">All bays</a>
      ${names.map((name) => html`<a class="button" href=${`#${encodeURIComponent(name)}`} aria-current=${name === bay ? 'true' : undefined}><span translate="no">${called(name)}</span>${alarmsOf(name) > 0 ? html` <span class=${`tag ${highestOf(name)}`}>${alarmsOf(name)}</span>` : ''}</a>`)}
    </nav>`;
  return html`<nav class="bays" aria-label="bays">
    <a href="#" class="button">All bays</a>
    <button type="button" disabled=${at <= 0} onClick=${() => go(names[at - 1])}>Previous</button>
    <select aria-label="bay" value=${bay} onChange=${(event) => go(event.target.value)}>
      ${names.map((name) => html`<option translate="no" value=${name} selected=${name === bay}>${called(name)}</option>`)}
    </select>
    <button type="button" disabled=${at < 0 || at >= names.length - 1} onClick=${() => go(names[at + 1])}>Next</button>
  </nav>`;
}

function App({ session }) {
  const hash = decoded(useHash().slice(1));
  const names = session.bays;
  const single = names.length === 1;
  const bay = names.includes(hash) ? hash : single ? names[0] : null;
  const live = useLive(bay === null ? [] : [bay], bay === null ? 1000 : 100, bay === null ? OVERVIEW_LIMIT_MS : LIMIT_MS);
  const { last: view, stateOf } = live;
  const known = live.fresh(view?.alarms.age_ms);
  const byName = new Map((view?.bays ?? []).map((one) => [one.bay, one]));
  const [shape, setShape] = useState(4 / 3); // of the picture
  const [asked, setAsked] = useState(0);
  const changed = useAtMost(view?.alarms.newest_change ?? '', 1000);
  const [alarms, wrong] = useFetched('/api/alarms', `${changed} ${asked}`, 5000);
  const list = { answer: alarms, wrong, again: () => setAsked((n) => n + 1), session };
  const byBay = !known ? {} : view?.alarms.by_bay ?? {};
  const alarmsOf = (name) => (Object.hasOwn(byBay, name) ? byBay[name] : 0);
  const highestOf = (name) => view?.alarms.highest_by_bay[name] ?? '';
  const one = bay === null ? null : byName.get(bay) ?? null;
  const state = stateOf(bay);
  const newest = view?.events_newest ?? null;
  const wide = shape > 1.5;
  const large = useMedia('(min-width: 1700px)'); // there is room for events under a wide picture, and for health beside it
  const events = html`<${Events} bay=${bay} newest=${newest} session=${session} />`;
  const health = html`<${Health} state=${state} hasRelay=${one?.relay} hasPose=${one?.pose} links=${known ? view?.links ?? null : null} />`;
  titled(bay === null ? 'Loading bays' : '{0}', called(bay ?? ''));

  return html`
    <${Bar} session=${session} bay=${bay} bays=${bay !== null && !single && html`<${BayBar} names=${names} bay=${bay} alarmsOf=${alarmsOf} highestOf=${highestOf} />`} live=${live} known=${known} alarms=${bay === null ? undefined : known ? view?.alarms ?? null : null} />
    <main id="main" tabindex="-1" class=${`page ${bay === null ? 'all' : 'one'} ${wide ? 'wide-picture' : shape < 0.9 ? 'tall-picture' : ''} ${known ? '' : 'unknown'}`}>
      <${Notice} kind="bad" loud wide say=${!known && view !== null && html`<b>NO CONNECTION TO THE GATEWAY.</b> Nothing here is live; treat the bay as STOP. Trying again.`} />
      <${Notice} kind="bad" loud wide say=${live.refusal} />
      ${bay === null
        ? html`<${Overview} names=${names} live=${live} alarmsOf=${alarmsOf} highestOf=${highestOf} />
            <div class="below"><${Alarms} bay=${null} ...${list} known=${known} /><${Events} bay=${null} newest=${newest} /></div>`
        : html`
            <h1 class="sr" translate="no">${called(bay)}</h1>
            <div class="column a"><${LivePicture} key=${bay} bay=${bay} aim=${one ? aimOf(one) : null} connected=${known} fault=${cameraFault(state)} onShape=${setShape} />${one ? html`<${Bars} state=${state} limits=${limitsOf(one)} />` : html`<div class="panel room bars-room"></div>`}${wide && large && events}</div>
            <div class="column b"><${Decision} state=${state} age=${html`<${Age} of=${live} partMs=${one?.age_ms} />`} bay=${bay} alarm=${(alarms?.alarms ?? []).some((each) => each.active && standing(each) && (each.bay === bay || each.bay === null))} />${one ? html`<${Trend} bay=${bay} state=${state} limits=${limitsOf(one)} />` : html`<div class="panel room trend-room"></div>`}</div>
            <div class="column c"><${Alarms} bay=${bay} ...${list} known=${known} /><${RecordedTrucks} bay=${bay} />${!(wide && large) && events}${large && health}</div>
            <div class="below">${!large && health}<${Registers} key=${bay} bay=${bay} /></div>`}
    </main>`;
}

/** A fault in this page must not leave an old picture standing. */
function Guarded({ session }) {
  const [fault] = useErrorBoundary((error) => {
    console.error(error);
    setTimeout(() => location.reload(), 5000);
  });
  if (!fault) return html`<${App} session=${session} />`;
  return html`<main class="page"><p class="notice bad" role="alert"><b>THIS PAGE HAS FAILED.</b> Treat every bay as STOP. It is loaded anew in 5 s.</p><p class="mono small" translate="no">${String(fault.message ?? fault)}</p></main>`;
}

if (kiosk) {
  beginKiosk();
  keepAwake();
  watchIdle();
}
start(Guarded);
