// The camera's own controls, tried on the bay's camera while a function check is on; and crop, rotation and the beacon's
// place, for the file.

import { html, translated, useEffect, useRef, useState } from '../lib/page.js';
import { get } from '../lib/api.js';
import { t, text } from '../lib/lang.js';
import { SaveDialog } from './file.js';

const POLL_MS = 1000;
const ROTATIONS = [0, 90, 180, 270];
const SIDES = ['x_px', 'y_px', 'width_px', 'height_px'];
const FREE = ['auto', 'aperture_priority']; // values of auto_exposure in which the camera sets the time
const WHOLE = { x_px: '', y_px: '', width_px: '', height_px: '' };

const isOn = (value) => value === true || FREE.includes(value);
/** In the viewer's words; the camera's own names stay as they are. */
const words = (value) => (typeof value === 'boolean' ? t(value ? 'on' : 'off') : String(value).replaceAll('_', ' '));

/** A control's name, value, range, and where the value comes from. */
function Control({ one, automatic, locked, set }) {
  const [draft, setDraft] = useState(null); // while the slider is moved, and until the camera has answered
  const [typed, setTyped] = useState(null); // what is being typed
  const act = async (wanted) => {
    setDraft(wanted);
    await set(wanted);
    setDraft((now) => (now === wanted ? null : now));
  };
  const id = `c-${one.name}`;
  const name = one.name.replaceAll('_', ' ');
  const ruled = automatic !== null && isOn(automatic.value);
  const disabled = locked || one.owned || ruled;
  const value = draft ?? one.value;
  const number = (event) => {
    const typed = Number(event.target.value);
    const on = one.low + one.step * Math.round((typed - one.low) / one.step);
    if (event.target.value !== '' && Number.isFinite(typed)) act(Math.min(one.high, Math.max(one.low, on)));
  };
  return html`<div class=${`control ${one.tried ? 'changed' : ''}`} data-control=${one.name}>
    <div class="head"><label for=${id}><span translate="no">${name}</span></label>
      <button type="button" class="plain reset" hidden=${!one.tried || locked} onClick=${() => set(undefined)}>tried, take back<span class="sr" translate="no"> ${name}</span></button></div>
    ${one.kind === 'number' && html`<div class="pair">
      <input type="range" aria-label=${text('{0}, slider', name)} min=${one.low} max=${one.high} step=${one.step} value=${value} disabled=${disabled}
        onInput=${(event) => setDraft(Number(event.target.value))} onChange=${number} />
      <input id=${id} class="field" type="number" min=${one.low} max=${one.high} step=${one.step} value=${typed ?? value} disabled=${disabled}
        onInput=${(event) => setTyped(event.target.value)} onKeyDown=${(event) => event.key === 'Enter' && event.target.blur()}
        onBlur=${(event) => { if (typed !== null) number(event); setTyped(null); }} />
      <span class="unit">${one.unit}</span></div>`}
    ${one.kind === 'flag' && html`<label class="choice"><input id=${id} type="checkbox" checked=${value} disabled=${disabled} onChange=${(event) => act(event.target.checked)} /> on</label>`}
    ${one.kind === 'choice' && html`<select id=${id} value=${value} disabled=${disabled} onChange=${(event) => act(event.target.value)}>
      ${one.choices.map((choice) => html`<option translate="no" value=${choice} selected=${choice === value}>${words(choice)}</option>`)}</select>`}
    <p class="hint"><span translate="no">${`${translated(one.meaning)}.`}</span> ${one.kind === 'number' ? html`<span class="nowrap">${`${one.low} to ${one.high}, step ${one.step}, default ${one.default}.`}</span>` : html`<span class="nowrap">Default: <span translate="no">${words(one.default)}</span>.</span>`}${' '}
      ${one.fixed === null ? 'The file leaves it as it is.' : html`<span>In the file: <b translate="no">${words(one.fixed)}</b>.</span>`}
      ${one.owned && html` <b>The gateway sets it by the light on the marker.</b>`}
      ${ruled && html` <b>The camera sets it: switch its automatic off first.</b>`}</p>
  </div>`;
}

/** Rotation and crop: read at the gateway's start. */
function Framing({ view, look, busy }) {
  const [rotation, setRotation] = useState(view.rotation_deg);
  const [crop, setCrop] = useState(view.crop ?? WHOLE);
  const given = SIDES.filter((key) => crop[key] !== '');
  const whole = given.length === 0;
  const good = whole || given.length === SIDES.length;
  const changes = [];
  if (rotation !== view.rotation_deg) changes.push({ path: ['camera', 'rotation_deg'], value: rotation || null });
  if (whole && view.crop) changes.push({ path: ['camera', 'crop'], value: null });
  if (!whole) for (const key of SIDES) if (crop[key] !== (view.crop ?? WHOLE)[key]) changes.push({ path: ['camera', 'crop', key], value: crop[key] });
  return html`<fieldset class="framing"><legend>Crop and rotation</legend>
    <p class="hint">For any camera. The crop is of the picture as the camera gives it; what is left is turned clockwise. R stays as it is: set the aim point anew afterwards, and calibrate the lens with such pictures. They take effect at the next start of the gateway.</p>
    <div class="sides"><label for="c-rotation">turned by</label> <select id="c-rotation" value=${rotation} onChange=${(event) => setRotation(Number(event.target.value))}>
        ${ROTATIONS.map((angle) => html`<option value=${angle} selected=${angle === rotation}>${`${angle}°`}</option>`)}</select><span></span>
      ${SIDES.map((key) => html`<label for=${`c-${key}`}>${{ x_px: 'left edge', y_px: 'upper edge', width_px: 'width', height_px: 'height' }[key]}</label>
        <input id=${`c-${key}`} class="field" type="number" min=${/^[xy]/.test(key) ? 0 : 16} max="16384" value=${crop[key]} placeholder="all"
          onInput=${(event) => setCrop({ ...crop, [key]: event.target.value === '' ? '' : Number(event.target.value) })} /><span class="unit">px</span>`)}</div>
    <div class="row"><button type="button" disabled=${busy || !changes.length || !good} onClick=${() => look(changes)}>Look at the change in the file…</button></div>
  </fieldset>`;
}

const SEEN = { SEARCHING: 'The code is not found in the pictures yet.', PROVEN: 'PROVEN: the pictures are of the present.', LATE: 'LATE: the pictures are older than the camera says.', LOST: 'LOST: the pictures no longer show the code.' };

/** The beacon: what it proves now, and where its LED was clicked in the picture. Read at the gateway's start. */
function Beacon({ view, led, seen, look, busy }) {
  const changes = view.blinks || !led ? [] : [{ path: ['ranger', 'hcsr04', 'beacon'], value: true }];
  for (const key of Object.keys(led ?? {})) if (led[key] !== view.beacon?.[key]) changes.push({ path: ['camera', 'beacon', key], value: led[key] });
  const place = led ?? view.beacon;
  return html`<fieldset class="framing beacon"><legend>Beacon</legend>
    ${view.blinks === null
      ? html`<p class="hint">It needs the board of an HC-SR04.</p>`
      : html`<p class="hint">An LED of the ranger's board, whose code proves that the pictures are of the present. Set the eyedropper's click to the beacon's LED, and click it in the picture. It takes effect at the next start of the gateway.</p>
        <p>${seen ? html`<b>${SEEN[seen.status]}</b>${seen.latency_ms === null ? '' : html` <span class="nowrap">${text('From the light to the state: {0} ms', Math.round(seen.latency_ms))}</span>`}` : 'No beacon is in force.'}</p>
        <p class="mono">${place ? `u ${place.u_px}  v ${place.v_px}  r ${place.radius_px}` : 'u –  v –  r –'}</p>
        <div class="row"><button type="button" disabled=${busy || !changes.length} onClick=${() => look(changes)}>Look at the change in the file…</button></div>`}
  </fieldset>`;
}

/** What the file must say so that it has what is tried: a value and its automatic exclude each other. */
function changesOf(view) {
  const changes = [];
  for (const [name, value] of Object.entries(view.tried)) {
    const one = view.controls.find((control) => control.name === name);
    const ruled = view.controls.find((control) => control.automatic === name);
    const automatic = view.controls.find((control) => control.name === one?.automatic);
    changes.push({ path: ['camera', 'controls', name], value });
    if (ruled && isOn(value) && ruled.fixed !== null) changes.push({ path: ['camera', 'controls', ruled.name], value: null });
    if (automatic && automatic.fixed !== null && isOn(automatic.fixed)) changes.push({ path: ['camera', 'controls', automatic.name], value: null });
  }
  return changes;
}

/**
 * `send(path, body)` as the page's; `url`: of the bay's camera; `checking`: a function check is on; `led`: where it was
 * clicked; `seen`: the state's beacon.
 */
export function Camera({ bay, send, url, checking, led, seen }) {
  const [open, setOpen] = useState(location.hash === '#camera');
  const [view, setView] = useState(null);
  const [before, setBefore] = useState([]); // what was tried before, newest last
  const [trouble, setTrouble] = useState('');
  const [busy, setBusy] = useState(false);
  const [plan, setPlan] = useState(null);
  const wanted = useRef(null); // what is on its way to the camera
  const turn = useRef(Promise.resolve()); // of the last request: the next one waits for it
  const round = useRef(0); // how often something was sent to the camera: an answer to what was asked before is old

  const doing = async (work) => {
    setBusy(true);
    try {
      await work();
      setTrouble('');
    } catch (error) {
      setTrouble(error.name === 'TypeError' ? 'no connection to the gateway' : error.message);
    } finally {
      setBusy(false);
    }
  };
  useEffect(() => {
    if (!open) return undefined;
    const load = () => {
      if (document.hidden || wanted.current !== null) return;
      const mine = round.current;
      get(url).then((next) => mine === round.current && took(next), (error) => setTrouble(error.message));
    };
    load();
    const timer = setInterval(load, POLL_MS);
    return () => clearInterval(timer);
  }, [open, url]);
  useEffect(() => {
    if (!checking) setBefore([]);
  }, [checking]);
  useEffect(() => {
    if (led) setOpen(true);
  }, [led]);

  const took = (next) => setView((was) => (next.known || !was?.controls.length ? next : { ...next, known: true, controls: was.controls }));
  // One request at a time, as of two beside each other the first may arrive last; of those that wait, the newest.
  const tryAll = (controls) => doing(async () => {
    round.current += 1;
    const mine = round.current;
    const newest = () => mine === round.current;
    wanted.current = controls;
    const sent = turn.current.then(() => newest() && send('camera/try', { controls }));
    turn.current = sent.catch(() => {});
    try {
      const next = await sent;
      if (newest()) took(next);
      else await turn.current; // the newest one's answer has these values, too
    } finally {
      if (newest()) wanted.current = null;
    }
  });
  const latest = () => wanted.current ?? view.tried;
  const set = (one) => (value) => {
    const next = { ...latest() };
    const ruled = view.controls.find((control) => control.automatic === one.name);
    if (value === undefined) delete next[one.name];
    else next[one.name] = value;
    if (value !== undefined && ruled && isOn(value)) delete next[ruled.name];
    if (value !== undefined && one.automatic && isOn(next[one.automatic])) delete next[one.automatic];
    setBefore([...before, latest()].slice(-50));
    return tryAll(next);
  };
  const undo = () => {
    setBefore(before.slice(0, -1));
    return tryAll(before[before.length - 1]);
  };
  const back = () => {
    setBefore([...before, latest()].slice(-50));
    return tryAll({});
  };
  const look = (changes) => doing(async () => {
    const file = await get('/api/setup/settings');
    const full = changes.map((change) => ({ ...change, path: ['bays', bay, ...change.path] }));
    setPlan({ ...(await send('/api/setup/preview', { digest: file.digest, changes: full })), path: file.file, changes: full });
  });
  const save = (shown) => send('/api/setup/save', { digest: shown.digest, changes: shown.changes });

  const tried = view ? Object.keys(view.tried).length : 0;
  return html`<details class="panel camera-panel" id="camera" open=${open} onToggle=${(event) => setOpen(event.target.open)}>
    <summary><h2>Camera: exposure, gain, white balance, focus, crop, rotation, beacon</h2></summary>
    ${trouble && html`<p class="notice bad" role="alert">${trouble}</p>`}
    ${view && html`
      ${view.fault && html`<p class="notice bad" role="alert">The camera refuses: <span translate="no">${view.fault}</span></p>`}
      ${!view.known && html`<p role="status">Asking the camera. It answers with its next picture.</p>`}
      ${view.known && !view.controls.length && !view.fault && html`<p>This camera has no controls that the gateway can set: only cameras at this machine (/dev/video*) have them. Set those of a network camera on its own page.</p>`}
      ${view.controls.length > 0 && html`
        <p class="small">${checking
          ? 'What is moved here acts on the camera of the bay at once. When the function check ends, the camera is put back to what the file says.'
          : 'To try other values, begin a function check above: they act on the camera of the bay at once.'}</p>
        <div class="settings">${view.controls.map((one) => html`<${Control} key=${one.name} one=${one} automatic=${view.controls.find((other) => other.name === one.automatic) ?? null}
          locked=${!checking} set=${set(one)} />`)}</div>
        <div class="row">
          <button type="button" disabled=${busy || !checking || !before.length} onClick=${undo}>Undo</button>
          <button type="button" disabled=${busy || !checking || !tried} onClick=${back}>All back to the file</button>
          <button type="button" class="primary" disabled=${busy || !tried} onClick=${() => look(changesOf(view))}>Save to file…</button>
          <span class="small" role="status">${tried ? `${tried} tried` : 'as the file says'}</span></div>`}
      <${Framing} key=${JSON.stringify([view.rotation_deg, view.crop])} view=${view} look=${look} busy=${busy} />
      <${Beacon} view=${view} led=${led} seen=${seen} look=${look} busy=${busy} />`}
    ${plan && html`<${SaveDialog} plan=${plan} live=${true} save=${save} close=${() => setPlan(null)} />`}
  </details>`;
}
