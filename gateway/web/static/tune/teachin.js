// The teach-in: a truck stands right, it is measured for a minute, and R_th, Z_th and the aim point follow.

import { html, useEffect, useState } from '../lib/page.js';
import { get } from '../lib/api.js';
import { known, number, px } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { distance, inUnit, lengthUnit, places } from '../lib/units.js';
import { SaveDialog } from './file.js';
import { HEIGHT, WIDTH, dots, scales } from './plot.js';

const POLL_MS = 1000;
const LENGTHS = [[20, '20 s, to try it'], [60, 'a minute'], [300, '5 minutes']];
const NAMES = {
  'fusion.radius_threshold_px': ['R_th', (value) => px(value)],
  'fusion.distance_threshold_mm': ['Z_th', (value) => number(value, 0, 'mm')],
  'guidance.aim_u_px': ['aim, u', (value) => px(value)],
  'guidance.aim_v_px': ['aim, v', (value) => px(value)],
  'guidance.tolerance_px': ['tolerance to the side', (value) => px(value)],
  'vision.marker_colour': ['marker colour', (value) => value ?? t("the paper's red")],
};
const asItIs = (value) => value;
const ROWS = [['radius_px', 'R', 'px', 1, asItIs], ['distance_mm', 'Z', lengthUnit(), places(0), inUnit], ['u_px', 'u', 'px', 1, asItIs], ['v_px', 'v', 'px', 1, asItIs]];

/** From the side: sensors, the distance they measure, the truck with its marker under the spout. */
const Picture = () => html`<svg class="scene" viewBox="0 0 300 130" role="img" aria-label="the truck stands under the spout; camera and ranger look at its marker">
  <path d="M0 118H300" stroke="var(--line-strong)" stroke-width="2" />
  <path d="M30 118V34" stroke="var(--muted)" stroke-width="5" /><rect x="18" y="22" width="34" height="16" rx="2" fill="var(--muted)" /><circle cx="54" cy="30" r="5" fill="var(--text)" />
  <rect x="20" y="54" width="26" height="12" rx="2" fill="var(--muted)" /><path d="M48 60H150" stroke="var(--value)" stroke-width="1.6" stroke-dasharray="5 4" /><path d="M144 55l8 5l-8 5" fill="none" stroke="var(--value)" stroke-width="1.6" />
  <text x="92" y="76" font-size="15" font-weight="600" fill="var(--value)">Z</text>
  <path d="M58 30L152 44M58 30L152 76" stroke="var(--value)" stroke-width="1" />
  <rect x="156" y="34" width="112" height="60" rx="26" fill="var(--grid)" stroke="var(--muted)" stroke-width="2" /><rect x="262" y="66" width="34" height="40" rx="4" fill="var(--part)" />
  <path d="M156 96H296" stroke="var(--muted)" stroke-width="4" /><circle cx="184" cy="106" r="12" fill="var(--text)" /><circle cx="214" cy="106" r="12" fill="var(--text)" /><circle cx="276" cy="106" r="12" fill="var(--text)" />
  <ellipse cx="156" cy="60" rx="4" ry="16" fill="var(--red)" /><text x="134" y="34" font-size="15" font-weight="600" fill="var(--value)">R</text>
  <path d="M196 0V20L208 30L220 20V0" fill="var(--page)" stroke="var(--muted)" stroke-width="2" />
</svg>`;

/** R or Z over the time: readings, their median, the suggested threshold. */
function Plot({ name, unit, decimals, points, values, spread, suggested, seconds }) {
  const at = scales(values, [spread?.median, suggested].filter(known), seconds);
  const across = (value) => `M0 ${at.y(value).toFixed(1)}H${WIDTH}`;
  const shown = (value) => number(value, decimals, unit);
  const middle = spread && text('median {0}', shown(spread.median));
  return html`<figure class="taught"><figcaption class="small"><strong>${name}</strong> ${listed([middle, known(suggested) && `${name}_th ${shown(suggested)}`], ', ')}</figcaption>
    <svg viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} preserveAspectRatio="none" role="img" aria-label=${listed([text('{0} over {1} s', name, number(seconds)), middle, known(suggested) && text('suggested threshold {0}', shown(suggested))], ', ')}>
      ${spread && html`<path d=${across(spread.median)} stroke="var(--text)" stroke-width="1.2" vector-effect="non-scaling-stroke" />`}
      ${known(suggested) && html`<path class="suggested" d=${across(suggested)} stroke="var(--blue)" stroke-width="2.2" stroke-dasharray="9 5" vector-effect="non-scaling-stroke" />`}
      <path class="dots" d=${dots(points.t_s, values, at)} stroke="var(--bar-strong)" stroke-width="3.6" stroke-linecap="round" vector-effect="non-scaling-stroke" />
    </svg></figure>`;
}

/** What was measured so far. */
function Measured({ spreads }) {
  return html`<table class="spreads"><thead><tr><th></th><th class="right">median</th><th class="right">spread (4 σ)</th><th class="right">drift</th><th class="right">readings</th></tr></thead>
    <tbody>${ROWS.map(([key, name, unit, decimals, as]) => {
      const one = spreads[key];
      return html`<tr><th scope="row">${name}</th><td class="right value">${number(as(one?.median), decimals, unit)}</td><td class="right">${one ? `± ${number(as(4 * one.sigma), decimals || 1, unit)}` : '–'}</td>
        <td class="right">${number(as(one?.drift), decimals || 1, unit)}</td><td class="right">${number(one?.count ?? 0)}</td></tr>`;
    })}</tbody></table>`;
}

function Measuring({ view, cancel, busy }) {
  const left = Math.max(0, view.seconds - view.elapsed_s);
  return html`<div class="row"><progress max=${view.seconds} value=${view.elapsed_s} aria-label="measured"></progress>
      <span>${text(left ? '{0} of {1} measured; {2} to go' : '{0} of {1} measured; calculating', number(view.elapsed_s), number(view.seconds, 0, 's'), number(left, 0, 's'))}</span>
      <button type="button" disabled=${busy} onClick=${cancel}>Cancel</button></div>
    <p>Leave the truck where it is. Nobody may walk between it and the sensors.</p>
    <${Measured} spreads=${view.spreads} />`;
}

function Values({ values, left, toggle }) {
  return html`<table class="values"><thead><tr><th>key</th><th class="right">now</th><th class="right">suggested</th><th>why</th></tr></thead>
    <tbody>${values.map(({ key, value, old, why }) => {
      const [name, shown] = NAMES[key];
      const same = value === old;
      return html`<tr><th scope="row"><label class="choice"><input type="checkbox" checked=${!same && !left.includes(key)} disabled=${same} onChange=${() => toggle(key)} /> ${name}</label></th>
        <td class="right">${known(old) || key === 'vision.marker_colour' ? shown(old) : 'not set'}</td><td class="right value">${same ? 'as it is' : shown(value)}</td><td class="small">${why}</td></tr>`;
    })}</tbody></table>`;
}

function Result({ view, left, toggle, look, again, busy }) {
  const { result, points, spreads, seconds } = view;
  const of = (key) => result.values.find((value) => value.key === key);
  const [radius, threshold] = [of('fusion.radius_threshold_px'), of('fusion.distance_threshold_mm')];
  const plots = html`<div class="plots">
    <${Plot} name="R" unit="px" decimals=${1} points=${points} values=${points.radius_px} spread=${spreads.radius_px} suggested=${radius?.value} seconds=${seconds} />
    <${Plot} name="Z" unit=${lengthUnit()} decimals=${places(0)} points=${points} values=${points.distance_mm.map(inUnit)} spread=${spreads.distance_mm && { median: inUnit(spreads.distance_mm.median) }} suggested=${inUnit(threshold?.value)} seconds=${seconds} /></div>`;
  if (result.refusals.length)
    return html`<div class="notice bad" role="alert"><p><strong>No values follow from this.</strong></p><ul>${result.refusals.map((why) => html`<li>${why}</li>`)}</ul></div>
      ${plots}<${Measured} spreads=${spreads} /><div class="row"><button type="button" disabled=${busy} onClick=${again}>Begin again</button></div>`;
  const changed = result.changes.length;
  return html`<p role="status"><strong>Measured.</strong> ${text('With these values D is 1 from {0} before this place on.', distance(result.before_mm))}${result.recipe ? ` ${text('They are those of recipe {0}, which holds for all bays.', result.recipe)}` : ''}</p>
    ${plots}
    <p class="legend small"><span><svg viewBox="0 0 30 8" aria-hidden="true"><path d="M1 4H29" stroke="var(--text)" stroke-width="1.2" /></svg> median</span>
      <span><svg viewBox="0 0 30 8" aria-hidden="true"><path d="M1 4H29" stroke="var(--blue)" stroke-width="2.2" stroke-dasharray="9 5" /></svg> suggested threshold</span></p>
    <${Values} values=${result.values} left=${left} toggle=${toggle} />
    ${result.notes.map((note) => html`<p class="notice warn">${note}</p>`)}
    <div class="row"><button type="button" class="primary" disabled=${busy || !changed} onClick=${look}>Look at the change in the file…</button>
      <button type="button" disabled=${busy} onClick=${again}>Begin again</button></div>
    <details><summary class="small">What was measured, and the lines for the file</summary><${Measured} spreads=${spreads} /><pre class="mono" translate="no">${result.toml}</pre></details>`;
}

/** `send(path, body, timeoutMs, method)` as the page's; `url`: of the bay's teach-in. */
export function TeachIn({ send, url, checking }) {
  const [view, setView] = useState({ phase: 'none' });
  const [seconds, setSeconds] = useState(60);
  const [open, setOpen] = useState(location.hash === '#teach-in');
  const [trouble, setTrouble] = useState('');
  const [busy, setBusy] = useState(false);
  const [left, setLeft] = useState([]); // keys that are not to be saved
  const [plan, setPlan] = useState(null);
  const measuring = view.phase === 'measuring';

  const load = async () => {
    try {
      const next = await get(url);
      setView(next);
      setTrouble('');
      return next;
    } catch (error) {
      setTrouble(error.name === 'TypeError' ? 'no connection to the gateway' : error.message);
      return null;
    }
  };
  useEffect(() => {
    load().then((found) => found && found.phase !== 'none' && setOpen(true));
  }, []);
  useEffect(() => {
    if (!measuring) return undefined;
    const timer = setInterval(load, POLL_MS);
    return () => clearInterval(timer);
  }, [measuring]);

  const doing = async (work) => {
    setBusy(true);
    setTrouble('');
    try {
      await work();
    } catch (error) {
      setTrouble(error.message);
    } finally {
      setBusy(false);
    }
  };
  const start = () => doing(async () => {
    setLeft([]);
    setView(await send(url, { seconds }));
  });
  const cancel = () => doing(async () => setView(await send(url, undefined, 15_000, 'DELETE')));
  const toggle = (key) => setLeft((was) => (was.includes(key) ? was.filter((one) => one !== key) : [...was, key]));
  const changes = () => view.result.changes.filter((change) => !left.includes(change.path.slice(-2).join('.')));
  const look = () => doing(async () => {
    const file = await get('/api/setup/settings');
    const shown = await send('/api/setup/preview', { digest: file.digest, changes: changes() });
    setPlan({ ...shown, path: file.file, changes: changes() });
  });
  const save = (shown) => send('/api/setup/save', { digest: shown.digest, changes: shown.changes });

  return html`<details class="panel teach-in" id="teach-in" open=${open} onToggle=${(event) => setOpen(event.target.open)}>
    <summary><h2>Teach-in: R_th, Z_th and the aim point from a truck that stands right</h2></summary>
    ${trouble && html`<p class="notice bad" role="alert">${trouble}</p>`}
    ${(view.phase === 'none' || view.phase === 'failed') && html`
      ${view.phase === 'failed' && html`<p class="notice bad" role="alert"><strong>The teach-in has ended:</strong> ${view.why}.</p>`}
      <div class="intro"><${Picture} /><ol>
        <li>Stand an ordinary truck where trucks are to stop: engine off, spout up.</li>
        <li>Keep everybody away from between the truck and the sensors.</li>
        <li>Press the button, and leave everything as it is until it has been measured.</li>
        <li>Look at the values, and save those that you want.</li></ol></div>
      <p class="small">${checking
        ? 'A function check is on: in_place stays off meanwhile.'
        : 'The bay goes on working by the thresholds in force. If the PLC might begin to load, begin a function check above first.'}${' '}
        Nothing changes until you have saved the file and the gateway has read it.</p>
      <div class="row"><button type="button" class="primary" disabled=${busy} onClick=${start}>Measure this truck</button>
        <label class="small" for="teach-seconds">for</label> <select id="teach-seconds" value=${seconds} onChange=${(event) => setSeconds(Number(event.target.value))}>
          ${LENGTHS.map(([value, name]) => html`<option value=${value} selected=${value === seconds}>${name}</option>`)}</select></div>`}
    ${measuring && html`<${Measuring} view=${view} cancel=${cancel} busy=${busy} />`}
    ${view.phase === 'done' && html`<${Result} view=${view} left=${left} toggle=${toggle} look=${look} again=${cancel} busy=${busy} />`}
    ${plan && html`<${SaveDialog} plan=${plan} live=${true} save=${save} close=${() => setPlan(null)} />`}
  </details>`;
}
