// The checklist up to a bay's release for operation, and what was signed. `/setup/release?bay=NAME`. The gateway judges: what
// it sees itself ticks itself, a person confirms only what it cannot see.

import { html, useState } from '../lib/page.js';
import { get, post, toLogin } from '../lib/api.js';
import { called, chosenBay } from '../lib/bays.js';
import { NONE, clock, moment, number, px, words } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { titled } from '../lib/title.js';
import { guarded, start } from '../lib/start.js';
import { Top } from '../lib/top.js';
import { usePolled } from '../operator/hooks.js';
import { useBayState } from './devices.js';
import { Restart } from './review.js';

const LOOK_MS = 500;
const THRESHOLDS = ['fusion.radius_threshold_px', 'fusion.distance_threshold_mm', 'guidance.aim_u_px', 'guidance.aim_v_px', 'guidance.tolerance_px'];

const at = (unixS) => moment(unixS * 1000);
const on = (unixS) => clock(unixS * 1000, { date: true });

/** What was seen of each item; empty: nothing yet. `state`: of the bay now, null: not known. */
const SEEN = {
  function_check: () => '',
  camera: (_, { state }) => state && listed([t(words(state.vision.quality.name)), state.radius_px !== null && `R ${px(state.radius_px)}`, state.u !== null && `(${number(state.u)}, ${number(state.v)})`]),
  marker: ({ marker_unix_s: seen }) => seen && at(seen),
  ranger: (_, { state }) => state && listed([t(words(state.range.quality.name)), state.distance_mm !== null && `Z ${number(state.distance_mm, 0, 'mm')}`]),
  plc: (_, { polled }) => polled && text('{0}: {1} polls', polled.address, number(polled.rate_hz, 1, '/s')),
  camera_out: ({ camera_out: out }) => outage(out),
  ranger_out: ({ ranger_out, more_rangers_out }) => listed([ranger_out, ...more_rangers_out].map(outage)),
  heartbeat: ({ heartbeat: lost }) => lost && (lost.after_unix_s === null ? text('{0} polled until {1}, and not since', lost.address, at(lost.before_unix_s)) : text('{0} polled until {1}, and again from {2}', lost.address, at(lost.before_unix_s), at(lost.after_unix_s))),
  thresholds: () => '',
};
const NAMES = {
  function_check: ['Function check is on', 'may_move and in_place stay off while the bay is tried.'],
  camera: ['Camera good now', ''],
  marker: ['Marker seen', 'A truck stands before its mark, so that stop is off.'],
  ranger: ['Ranger good now', ''],
  plc: ['PLC polls', 'One of modbus.plc_addresses; where there are none, any address but this machine\u2019s: make sure that it is the PLC.'],
  camera_out: ['Camera out tried', 'Unplug the camera, look at stop, plug it in again. Good before, out for a second or longer with stop on, and good again counts.'],
  ranger_out: ['Ranger out tried', 'The same with the ranger\u2019s cable.'],
  heartbeat: ['Loss of heartbeat tried', 'Restart the gateway while the PLC polls, and look at the PLC: it must stop.'],
  thresholds: ['Thresholds in force', 'Compare them with the truck that stands there, and with what was taught in.'],
};

const outage = (out) => out && (out.good_unix_s === null ? text('{0} since {1}, stop is on', t(words(out.quality)), at(out.lost_unix_s)) : text('{0} at {1} with stop, good again at {2}', t(words(out.quality)), at(out.lost_unix_s), at(out.good_unix_s)));

const shown = (value) => (typeof value === 'string' ? value : JSON.stringify(value ?? NONE).replaceAll('"', ''));

/** `now`: what this truck gives, beside the thresholds. */
function Keys({ keys, state }) {
  const now = [px(state?.radius_px), number(state?.distance_mm, 0, 'mm'), px(state?.u), px(state?.v), ''];
  const others = Object.entries(keys).filter(([key]) => !THRESHOLDS.includes(key));
  return html`<table><thead><tr><th>key</th><th>in force</th><th>this truck now</th></tr></thead><tbody translate="no">
    ${THRESHOLDS.map((key, n) => html`<tr><td class="mono">${key}</td><td class="value">${shown(keys[key])}</td><td class="value">${now[n]}</td></tr>`)}</tbody></table>
    <details><summary>${text('{0} more keys that the signature holds for', others.length)}</summary><ul class="bare mono small" translate="no">${others.map(([key, value]) => html`<li>${`${key} = ${shown(value)}`}</li>`)}</ul></details>`;
}

function Item({ name, so, view, state, act, busy, restart, begin }) {
  const seen = SEEN[name](view.checklist, { state, polled: view.polled });
  const [title, hint] = NAMES[name];
  const lost = view.checklist.heartbeat?.after_unix_s;
  const confirm = (words) => html`<p><button type="button" disabled=${busy} onClick=${() => act({ what: 'confirm', item: name })}>${words}</button></p>`;
  return html`<li data-item=${name} data-done=${String(so)}><span class=${`tag ${so ? '' : 'warn'}`}>${so ? 'done' : 'open'}</span>
    <div><h2>${title}</h2>${hint && html`<p class="hint">${hint}</p>`}
      ${seen && html`<p class="value" translate="no">${seen}</p>`}
      ${name === 'thresholds' && html`<${Keys} keys=${view.keys} state=${state} />`}
      ${name === 'function_check' && !so && html`<p><button type="button" disabled=${busy} onClick=${begin}>Begin function check</button></p>`}
      ${name === 'heartbeat' && !lost && html`<p><button type="button" disabled=${busy || view.polled === null} onClick=${restart}>Restart the gateway</button></p>`}
      ${name === 'heartbeat' && lost && !so && confirm('Confirm: the PLC stopped')}
      ${name === 'thresholds' && !so && confirm('Confirm: these are wanted')}</div></li>`;
}

const Signed = ({ one }) => html`<li><span translate="no">${text('{0}, by {1} ({2})', on(one.unix_s), one.who, one.address)}</span>${one.void_unix_s !== null && html` <span class="tag warn">void</span> <span translate="no">${text('since {0}: {1}', on(one.void_unix_s), one.void_keys.join(', '))}</span>`}
  <span class="small muted" translate="no"> ${listed([`R ${px(one.radius_px)}`, `Z ${number(one.distance_mm, 0, 'mm')}`, one.polled?.address, outage(one.checklist.camera_out), SEEN.ranger_out(one.checklist), SEEN.heartbeat(one.checklist)])}</span></li>`;

function Verdict({ signed }) {
  const newest = signed[0];
  if (!newest) return html`<p class="notice warn" role="status" data-release="never"><b>Not released for operation yet.</b></p>`;
  if (newest.void_unix_s !== null) return html`<p class="notice warn" role="status" data-release="void"><b>${text('Not released since {0}.', on(newest.void_unix_s))}</b> <span>${text('Changed: {0}', newest.void_keys.join(', '))}</span></p>`;
  return html`<p class="notice" role="status" data-release="valid"><b>${text('Released for operation by {0}, {1}.', newest.who, on(newest.unix_s))}</b></p>`;
}

function Release({ session, bay }) {
  const path = `/api/bays/${encodeURIComponent(bay)}`;
  const live = usePolled(`${path}/release`, LOOK_MS);
  const { state, last } = useBayState(bay);
  const [{ busy, wrong }, setWork] = useState({ busy: false, wrong: '' });
  const [restarting, setRestarting] = useState(null);
  const during = async (work) => {
    setWork({ busy: true, wrong: '' });
    try {
      await work();
      setWork({ busy: false, wrong: '' });
    } catch (error) {
      if (error.status === 401) toLogin();
      setWork({ busy: false, wrong: error.message });
    }
  };
  const act = (body) => during(() => post(`${path}/release`, body, session.csrf));
  const check = (mode) => during(() => post(`${path}/function-check`, { mode }, session.csrf));
  const restart = () => during(async () => setRestarting(await get('/api/setup/settings')));
  const view = live.last;
  if (!view) return html`<section class="panel"><p role="status">${live.wrong || 'Loading …'}</p></section>`;
  const fresh = live.fresh(0);
  const items = Object.entries(view.done);
  const open = items.filter(([, so]) => !so).length;
  return html`<section class="panel">
      <${Verdict} signed=${view.signed} />
      ${!fresh && html`<p class="notice bad" role="alert">The gateway does not answer.</p>`}
      ${wrong && html`<p class="notice bad" role="alert">${wrong}</p>`}
      ${view.checklist === null ? html`<p>The checklist is for the last step of an installation, and after a change of what decides. It switches nothing by itself.</p>
        <p class="row"><button type="button" class="primary" disabled=${busy} onClick=${() => act({ what: 'begin' })}>Begin the checklist</button>
        ${wrong && html`<button type="button" disabled=${busy} onClick=${restart}>Restart the gateway</button>`}
        ${view.signed[0]?.void_unix_s === null && last && last.function_check !== 'OFF' && html`<button type="button" disabled=${busy} onClick=${() => check('off')}>End the function check</button>`}</p>`
      : html`<p>${text('Begun by {0}, {1}.', view.checklist.by, at(view.checklist.begun_unix_s))} Other settings begin it anew.</p>
        <ol class="items">${items.map(([name, so]) => html`<${Item} key=${name} name=${name} so=${so && fresh} view=${view} state=${state} act=${act} busy=${busy} restart=${restart} begin=${() => check('may_move_off')} />`)}</ol>
        <p class="row"><button type="button" class="primary" disabled=${busy || open > 0 || !fresh} onClick=${() => act({ what: 'sign' })}>${session.name ? text('Sign as {0}', session.name) : 'Sign'}</button>
          <button type="button" disabled=${busy} onClick=${() => act({ what: 'discard' })}>Discard the checklist</button>
          <span class="muted">${open > 0 ? text(open === 1 ? 'One item is open.' : '{0} items are open.', open) : session.name ? '' : 'A signature needs a login.'}</span></p>`}
    </section>
    ${view.signed.length > 0 && html`<section class="panel" aria-labelledby="signed-title"><h2 id="signed-title">Signed</h2><ul class="signed">${view.signed.map((one) => html`<${Signed} one=${one} />`)}</ul></section>`}
    ${restarting && html`<${Restart} session=${session} seconds=${restarting.restart_s} close=${() => setRestarting(null)} />`}`;
}

function App({ session }) {
  titled('Release');
  const bay = chosenBay(session.bays, new URLSearchParams(location.search).get('bay')) ?? session.bays[0];
  return html`
    <${Top} session=${session} bay=${bay} current="Release" choose=${(name) => location.assign(`?bay=${encodeURIComponent(name)}`)} />
    <main id="main" tabindex="-1" class="page release">
      <h1 translate="no">${text('Release of {0} for operation', called(bay))}</h1>
      <${Release} session=${session} bay=${bay} />
    </main>`;
}

start(guarded(App));
