// Sets up a bay without a text editor, a new one or one that the file has: camera, ranger, PLC and broker tried, the
// file's difference, save, restart. `/setup/new-bay`; `?new` for another bay; `?started=NAME` once the gateway has started.

import { html, useEffect, useState } from '../lib/page.js';
import { get, post, toLogin } from '../lib/api.js';
import { number } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { titled } from '../lib/title.js';
import { guarded, start } from '../lib/start.js';
import { Top } from '../lib/top.js';
import { BayCamera, BayRanger, CameraLook, FlashLook, Line, OfferFirmware, RangerLook, useDevices, usePreview } from './devices.js';
import { KEPT, NO_PROFILE, NOTHING_CHOSEN, brokerUrl, cameraIsRight, cameraKeys, changesOf, lastingName, lookedAt, nextName, nextUnit, portIsRight, profileBefore, profilePicked, rangerTable, sizesOf, unfinished, usualSize } from './draft.js';
import { FileStep, Started, Waiting } from './finish.js';
import { nodeAt } from './keys.js';
import { NetworkCameras } from './network.js';

const STEPS = ['Bay', 'Camera', 'Ranger', 'PLC and broker', 'The file'];
const OF_BROKER = ['urls', 'username', 'password_file', 'password_env'];
const TRY_MS = 60_000;

function useSettings() {
  const [state, setState] = useState({ settings: null, bays: [], wrong: '' });
  const load = async () => {
    try {
      const [settings, bays] = await Promise.all([get('/api/setup/settings', { timeoutMs: 20_000 }), get('/api/state', { timeoutMs: 20_000 })]);
      setState({ settings, bays, wrong: '' });
    } catch (error) {
      if (error.status === 401) toLogin();
      setState((known) => ({ ...known, wrong: error.message }));
    }
  };
  useEffect(() => { load(); }, []);
  return { ...state, load };
}

/** What is proposed: the bay that is still to be set up; without one, or where another bay is wanted, a new one. */
function firstDraft(settings, bays) {
  const known = knownBays(settings);
  const proposed = new URLSearchParams(location.search).has('new') ? '' : unfinished(bays);
  return {
    bay: known.some((bay) => bay.name === proposed) ? proposed : '',
    name: nextName(known.map((bay) => bay.name)),
    unit: nextUnit(known.map((bay) => bay.unit_id)),
    ...NOTHING_CHOSEN,
    host: settings.values?.modbus?.host ?? '',
    hostBefore: settings.values?.modbus?.host ?? '',
    broker: { address: '', user: '', password: '' },
    brokerKeys: OF_BROKER.filter((key) => settings.written.mqtt?.[key] !== undefined), // what another broker takes the place of
  };
}

const knownBays = (settings) => Object.values(settings.values?.bays ?? {});

/** What is wrong with the name and the unit id of a new bay; empty: nothing. */
function wrongOf(draft, known) {
  const name = !/^[A-Za-z0-9_-]{1,64}$/.test(draft.name) ? 'letters, digits, _ and -, at most 64' : known.some((bay) => bay.name.toLowerCase() === draft.name.toLowerCase()) ? 'another bay has this name' : '';
  const unit = !(draft.unit >= 1 && draft.unit <= 247) ? 'a whole number from 1 to 247' : known.some((bay) => bay.unit_id === draft.unit) ? 'another bay has this unit id' : '';
  return [name, unit];
}

function BayStep({ draft, change, settings, bays }) {
  const known = knownBays(settings);
  const checked = bays.filter((bay) => bay.function_check !== 'OFF').map((bay) => bay.bay);
  const [badName, badUnit] = wrongOf(draft, known);
  return html`<fieldset class="step"><legend class="sr">Which bay</legend>
    <div class="choices">
      ${known.map((bay) => html`<label><input type="radio" name="bay" checked=${draft.bay === bay.name} onChange=${() => change({ bay: bay.name, ...NOTHING_CHOSEN })} /><span translate="no">${bay.name}</span>
        <small>${text('camera {0}, ranger {1}', bay.camera.url, bay.ranger.port)}</small>${checked.includes(bay.name) && html`<small>function check is on</small>`}</label>`)}
      <label><input type="radio" name="bay" checked=${draft.bay === ''} onChange=${() => change({ bay: '', ...NOTHING_CHOSEN })} /><span>A new bay</span></label>
    </div>
    ${draft.bay === '' ? html`
      <div class="field"><label for="name">Name</label><input id="name" value=${draft.name} aria-invalid=${String(Boolean(badName))} aria-describedby="name-hint" onInput=${(event) => change({ name: event.target.value.trim() })} />
        <small id="name-hint" class="muted">${badName || 'in topics, events and on the pages'}</small></div>
      <div class="field"><label for="unit">Modbus unit id</label><input id="unit" type="number" min="1" max="247" value=${draft.unit} aria-invalid=${String(Boolean(badUnit))} aria-describedby="unit-hint" onInput=${(event) => change({ unit: event.target.value === '' ? '' : Math.trunc(Number(event.target.value)) })} />
        <small id="unit-hint" class="muted">${badUnit || 'under which the PLC reads this bay'}</small></div>`
      : html`<p>${text('Keep its camera and its ranger, or choose others, in the next steps. Everything else of {0} stays as it is.', draft.bay)}</p>`}
  </fieldset>`;
}

const bayIsRight = (draft, settings) => draft.bay !== '' || !wrongOf(draft, knownBays(settings)).some(Boolean);

/** A text that is typed and taken by Enter or a button. */
function Typed({ id, label, note, take, name }) {
  const [typed, setTyped] = useState('');
  const go = (event) => {
    event.preventDefault();
    if (typed.trim()) take(typed.trim());
  };
  return html`<form class="field" onSubmit=${go}><label for=${id}>${label}</label>
    <span class="row"><input id=${id} value=${typed} size="34" autocomplete="off" spellcheck=${false} aria-describedby=${`${id}-hint`} onInput=${(event) => setTyped(event.target.value)} /><button disabled=${!typed.trim()}>${name}</button></span>
    <small id=${`${id}-hint`} class="muted">${note}</small></form>`;
}

/**
 * What the file says of a sensor of the bay that is set up: its address; its device, where that is in the list; the lasting
 * name that it could have; whether its values come from the running bay. Null for a new bay.
 */
function inFile(part, key, draft, settings, session, found) {
  if (draft.bay === '') return null;
  const address = settings.values.bays[draft.bay][part][key];
  const waits = settings.waiting.some((line) => line.startsWith(`bays.${draft.bay}.${part}.${key}:`)); // another one runs
  const own = waits ? undefined : found?.find((device) => device.used_by === draft.bay);
  return { address, own, lasting: lastingName(own, address), runs: session.bays.includes(draft.bay) && !waits };
}

const isOwn = (file, address) => file !== null && (address === file.address || address === file.own?.url || address === file.own?.node);

/** The devices to choose from: what the bay has, as the file says and by a lasting name, then those that are free. */
function Devices({ name, label, bay, found, file, chosen, keep, pick }) {
  const others = found?.filter((device) => device !== file?.own) ?? [];
  if (file === null && others.length === 0) return null;
  return html`<fieldset class="choices"><legend class="sr">${label}</legend>
    ${file?.lasting && html`<label><input type="radio" name=${name} checked=${chosen === file.lasting} onChange=${() => keep(file.lasting)} /><span translate="no">${file.own.name}</span>
      <small translate="no">${file.lasting}</small><small>${text('{0} has it now. This name stays the same.', bay)}</small></label>`}
    ${file && html`<label><input type="radio" name=${name} checked=${chosen === KEPT} onChange=${() => keep(KEPT)} /><span>As in the file</span>
      ${!file.lasting && file.own && html`<small translate="no">${file.own.name}</small>`}<small translate="no">${file.address}</small><small>${text(file.lasting ? '{0} has it now. Another device can get this number at the next start.' : '{0} has it now.', bay)}</small></label>`}
    ${others.map((device) => html`<label><input type="radio" name=${name} checked=${chosen === device.url} disabled=${Boolean(device.used_by)} onChange=${() => pick(device)} /><span translate="no">${device.name}</span>
      <small translate="no">${listed([device.url, device.used_by && text('bay {0} uses it', device.used_by), device.fault], ': ')}</small></label>`)}</fieldset>`;
}

/** Chooses for a bay that the file has, once its devices are known: the lasting name, else what the file says. */
function useProposal(file, decided, known, keep) {
  useEffect(() => {
    if (file !== null && !decided && known) keep(file.lasting || KEPT);
  }, [file?.address, decided, known]);
}

const NotRunning = ({ bay }) => html`<p class="muted">${text('{0} does not run with it yet: it is shown here after a restart.', bay)}</p>`;

function CameraStep({ session, draft, change, settings, devices }) {
  const { cameras, wrong } = devices;
  const file = inFile('camera', 'url', draft, settings, session, cameras);
  const look = usePreview(session, draft.camera && !draft.cameraOwn ? { camera: lookedAt(draft.camera, draft.cameraPassword) } : null);
  const figures = look.seen?.figures;
  useEffect(() => {
    if (figures && (figures.width_px !== draft.size?.width_px || figures.height_px !== draft.size?.height_px))
      change({ size: { width_px: figures.width_px, height_px: figures.height_px } });
  }, [figures?.width_px, figures?.height_px, draft.size]);
  const keep = (from) => change({ cameraFrom: from, size: null, cameraOwn: true, camera: from === KEPT ? null : { url: from } });
  useProposal(file, draft.cameraOwn || draft.camera !== null, cameras !== null || Boolean(wrong), keep);
  const chosen = cameras?.find((camera) => camera.url === draft.cameraFrom && !draft.cameraOwn);
  const sizes = chosen ? sizesOf(chosen.modes) : [];
  const pick = (camera) => change({ cameraFrom: camera.url, size: null, cameraOwn: false, camera: cameraKeys(camera.url, usualSize(sizesOf(camera.modes))) });
  const take = (url) => {
    if (isOwn(file, url)) keep(url === file.lasting ? url : KEPT);
    else change({ cameraFrom: '', size: null, cameraOwn: false, camera: cameraKeys(url, null) });
  };
  return html`<div class="step">
    ${wrong && html`<p class="notice warn">${wrong}</p>`}
    ${cameras === null && !wrong && html`<p role="status">Looking for cameras …</p>`}
    ${cameras?.length === 0 && file === null && html`<p class="notice" role="status"><b>No camera found.</b> Plug it in; this list renews itself.</p>`}
    <${Devices} name="camera" label="Cameras of this machine" bay=${draft.bay} found=${cameras} file=${file} chosen=${draft.cameraFrom} keep=${keep} pick=${pick} />
    <${NetworkCameras} session=${session} chosen=${draft.cameraFrom} pick=${(camera, cameraPassword) => change({ cameraFrom: camera.url, size: null, cameraOwn: false, camera, cameraPassword })} />
    <${Typed} id="camera-url" label="Another one: a network camera" name="Look" take=${take}
      note="rtsp://user:password@address/stream, the address of an MJPEG stream, or a path: /dev/video2, a film, a folder of pictures" />
    ${sizes.length > 0 && html`<div class="field"><label for="size">Picture size</label><select id="size" onChange=${(event) => change({ size: null, camera: cameraKeys(chosen.url, sizes.find((size) => size.key === event.target.value)) })}>
      ${sizes.map((size) => html`<option value=${size.key} selected=${draft.camera?.width_px === size.width_px && draft.camera?.height_px === size.height_px}>${listed([`${size.width_px} x ${size.height_px} px`, size.rate_hz && text('up to {0}', number(size.rate_hz, 0, '/s'))], ', ')}</option>`)}</select>
      <small class="muted">R_th counts pixels: with another size it means another distance, until it is taught in anew</small></div>`}
    ${draft.cameraOwn ? file.runs ? html`<${BayCamera} bay=${draft.bay} />` : html`<${NotRunning} bay=${draft.bay} />`
      : draft.camera ? html`<${CameraLook} look=${look} what=${draft.camera.url.replace(/\/\/[^@/]*@/, '//')} />` : html`<p class="muted">Choose a camera to see its live picture.</p>`}
  </div>`;
}

const RANGER_KEYS = ['baud', 'mm_per_unit', 'offset_mm', 'nearest_mm', 'farthest_mm', 'delay_ms'];

/** Which device is at the port, and what its profile leaves to the plant. */
function RangerProfile({ draft, change, settings, profile }) {
  const names = nodeAt(settings.json_schema, ['ranger', 'profile'])?.enum ?? [];
  const pick = (name) => change(profilePicked(name, profileBefore(draft, settings)));
  return html`<div class="field"><label for="profile">Sensor</label><select id="profile" onChange=${(event) => pick(event.target.value)}>
    ${names.map((name) => html`<option value=${name} selected=${name === profile} translate=${name === NO_PROFILE ? 'yes' : 'no'}>${name === NO_PROFILE ? t('a board with an HC-SR04, or by its keys') : name}</option>`)}</select></div>
    ${profile !== NO_PROFILE && html`<fieldset class="step"><legend>What the sensor's profile leaves to you; empty: as it has it</legend>
      ${RANGER_KEYS.map((key) => html`<div class="field"><label for=${`ranger-${key}`} translate="no">${key}</label><input id=${`ranger-${key}`} type="number" step="any" value=${draft.rangerKeys[key] ?? ''} onChange=${(event) => change({ rangerKeys: { ...draft.rangerKeys, [key]: event.target.value } })} /></div>`)}</fieldset>`}`;
}

function RangerStep({ session, draft, change, settings, devices }) {
  const { ports, wrong } = devices;
  const file = inFile('ranger', 'port', draft, settings, session, ports);
  const [flash, setFlash] = useState(null);
  const profile = draft.profile ?? profileBefore(draft, settings);
  const more = Object.keys(settings.values.bays[draft.bay]?.ranger.more ?? {}).length;
  const look = usePreview(session, flash ? { flash } : draft.port && !draft.portOwn ? { ranger: rangerTable(draft, profile) } : null);
  const local = (port) => !port.includes('://'); // a serial server gives no reset
  const keep = (from) => change({ portFrom: from, portOwn: true, port: from === KEPT ? '' : from });
  useProposal(file, draft.portOwn || draft.port !== '', ports !== null || Boolean(wrong), keep);
  const take = (port) => {
    if (isOwn(file, port)) keep(port === file.lasting ? port : KEPT);
    else change({ port, portFrom: port, portOwn: false });
  };
  return html`<div class="step">
    ${wrong && html`<p class="notice warn">${wrong}</p>`}
    ${ports === null && !wrong && html`<p role="status">Looking for serial ports …</p>`}
    ${ports?.length === 0 && file === null && html`<p class="notice" role="status"><b>No serial port found.</b> Plug the board in; this list renews itself. For a serial server type its address.</p>`}
    <${Devices} name="port" label="Serial ports of this machine" bay=${draft.bay} found=${ports} file=${file} chosen=${draft.portFrom} keep=${keep} pick=${(port) => take(port.url)} />
    <${Typed} id="port-url" label="Another one: a serial server, or a path" name="Listen" take=${take} note="socket://address:port, rfc2217://address:port, or a path" />
    ${!draft.portOwn && html`<${RangerProfile} draft=${draft} change=${change} settings=${settings} profile=${profile} />`}
    ${more > 0 && html`<p class="muted">${text('More rangers of this bay: {0}. They stay as they are in the file.', more)}</p>`}
    ${flash ? html`<${FlashLook} look=${look} what=${flash.port} close=${() => setFlash(null)} />`
      : draft.portOwn ? file.runs ? html`<${BayRanger} bay=${draft.bay} put=${local(file.address) ? () => setFlash({ port: file.address, bay: draft.bay }) : null} />` : html`<${NotRunning} bay=${draft.bay} />`
      : draft.port ? html`<${RangerLook} look=${look} what=${draft.port} />
        ${local(draft.port) && profile === NO_PROFILE && look.seen?.line?.verdict === 'fault' && html`<${OfferFirmware} put=${() => setFlash({ port: draft.port, bay: '' })} />`}` : html`<p class="muted">Choose a port to see its live distance.</p>`}
  </div>`;
}

/** Tries something on request. @returns {[any, string, boolean, (body: any) => void]} answer, fault, busy, try */
function useTry(session, path) {
  const [state, setState] = useState({ answer: null, wrong: '', busy: false });
  const go = async (body) => {
    setState({ answer: null, wrong: '', busy: true });
    try {
      setState({ answer: await post(path, body, session.csrf, { timeoutMs: TRY_MS }), wrong: '', busy: false });
    } catch (error) {
      setState({ answer: null, wrong: error.message, busy: false });
    }
  };
  return [state.answer, state.wrong, state.busy, go];
}

const Tried = ({ answer, wrong, busy }) => html`<div class="lines" role="status">
  ${busy && html`<p>Trying …</p>`}${wrong && html`<p class="notice bad">${wrong}</p>`}
  ${answer?.lines.map((line) => html`<${Line} line=${line} />`)}</div>`;

function Peers({ answer }) {
  const peers = answer.servers.flatMap((server) => server.peers);
  const written = answer.writes.filter((row) => row.values.plc_writes > 0);
  return html`<div class="lines">
    ${peers.length === 0 ? html`<p>No client is connected to the Modbus port now. Connect the PLC, then try again.</p>` : html`<ul>${peers.map((peer) => html`<li>${text(peer.plc ? '{0} (one of modbus.plc_addresses): polled {1} ago, {2} requests' : '{0}: polled {1} ago, {2} requests', peer.address, number(peer.quiet_ms / 1000, 1, 's'), peer.requests)}</li>`)}</ul>`}
    ${answer.writes.length > 0 && (written.length === 0 ? html`<p>Nothing has been written to the handshake registers yet.</p>` : html`<ul>${written.map((row) => html`<li>${text('{0}: {1} writes; plc_heartbeat {2}, recipe_select {3}, plc_control: {4}', row.bay, row.values.plc_writes, row.values.plc_heartbeat, row.values.recipe_select, row.control_bits.join(', ') || t('no bit set'))}</li>`)}</ul>`)}
  </div>`;
}

function PlantStep({ session, draft, change, settings }) {
  const [plc, plcWrong, plcBusy, tryPlc] = useTry(session, '/api/setup/plc');
  const [broker, brokerWrong, brokerBusy, tryBroker] = useTry(session, '/api/setup/broker');
  useEffect(() => { tryPlc({}); }, []);
  const set = (key) => (event) => change({ broker: { ...draft.broker, [key]: event.target.value } });
  const typed = draft.broker.address.trim() !== '';
  const configured = settings.values?.mqtt;
  const keys = typed ? { url: brokerUrl(draft.broker) } : null;
  return html`<div class="step">
    <h2>PLC</h2>
    <${Tried} answer=${plc} wrong=${plcWrong} busy=${plcBusy} />
    ${plc && html`<${Peers} answer=${plc} />`}
    <p><button type="button" disabled=${plcBusy} onClick=${() => tryPlc({})}>Try again</button></p>
    <div class="field"><label for="host">The gateway's address in the PLC's network (modbus.host)</label><input id="host" value=${draft.host} autocomplete="off" aria-describedby="host-hint" onInput=${(event) => change({ host: event.target.value.trim() })} />
      <small id="host-hint" class="muted">0.0.0.0: every network of this machine. A connection from this machine to itself says nothing about a firewall in between: look for the PLC's own polls above.</small></div>
    <h2>MQTT broker</h2>
    <p>${configured ? text('The file has {0}. Type another one only to replace it.', configured.url ?? configured.urls?.join(', ')) : 'The gateway works without one. Leave the address empty, or type it:'}</p>
    <div class="field"><label for="broker">Address</label><input id="broker" value=${draft.broker.address} placeholder="mqtt://broker.plant:1883" autocomplete="off" onInput=${set('address')} /></div>
    <div class="field"><label for="broker-user">User</label><input id="broker-user" value=${draft.broker.user} autocomplete="off" onInput=${set('user')} /></div>
    <div class="field"><label for="broker-password">Password</label><input id="broker-password" type="password" value=${draft.broker.password} autocomplete="off" onInput=${set('password')} /></div>
    <p><button type="button" disabled=${brokerBusy || (!typed && !configured)} onClick=${() => tryBroker({ mqtt: keys })}>${typed || !configured ? 'Try this broker' : "Try the file's broker"}</button></p>
    <${Tried} answer=${broker} wrong=${brokerWrong} busy=${brokerBusy} />
  </div>`;
}

function summary(draft, settings) {
  const bay = settings.values.bays[draft.bay];
  return [
    draft.bay || text('{0}, unit {1}', draft.name, draft.unit),
    draft.camera ? draft.camera.url.replace(/\/\/[^@/]*@/, '//') : bay?.camera.url ?? t('not chosen'),
    draft.port || (bay?.ranger.port ?? t('not chosen')),
    draft.broker.address || t('no change'),
    '',
  ];
}

function Wizard({ session, settings, bays, reload }) {
  const [kept, setDraft] = useState(() => firstDraft(settings, bays));
  const [step, setStep] = useState(0);
  const [saved, setSaved] = useState(null); // from then on only a restart is left
  const gone = kept.bay !== '' && !settings.values.bays[kept.bay]; // another hand has removed it from the file
  const draft = gone ? { ...kept, bay: '', ...NOTHING_CHOSEN } : kept;
  const change = (part) => setDraft((known) => ({ ...known, ...(gone ? { bay: '', ...NOTHING_CHOSEN } : {}), ...part }));
  const go = (to) => {
    setStep(to);
    requestAnimationFrame(() => document.getElementById('step-title')?.focus());
  };
  const devices = useDevices(step === 1 || step === 2);
  const right = [bayIsRight(draft, settings), cameraIsRight(draft), portIsRight(draft), true];
  const missing = right.indexOf(false);
  const may = (to) => missing === -1 || to <= missing;
  const texts = summary(draft, settings);
  return html`
    <nav class="panel" aria-label="steps"><ol class="steps">
      ${STEPS.map((name, n) => html`<li><button type="button" aria-current=${n === step ? 'step' : undefined} disabled=${!may(n) || (saved !== null && n !== step)} onClick=${() => go(n)}><span>${n + 1} ${name}<span class="what" translate="no">${texts[n]}</span></span></button></li>`)}
    </ol></nav>
    <section class="panel step" aria-labelledby="step-title">
      <h1 id="step-title" tabindex="-1">${step + 1} ${STEPS[step]}</h1>
      ${step === 0 && html`<${BayStep} draft=${draft} change=${change} settings=${settings} bays=${bays} />`}
      ${step === 1 && html`<${CameraStep} session=${session} draft=${draft} change=${change} settings=${settings} devices=${devices} />`}
      ${step === 2 && html`<${RangerStep} session=${session} draft=${draft} change=${change} settings=${settings} devices=${devices} />`}
      ${step === 3 && html`<${PlantStep} session=${session} draft=${draft} change=${change} settings=${settings} />`}
      ${step === 4 && html`<${FileStep} session=${session} settings=${settings} bay=${draft.bay || draft.name} isNew=${draft.bay === ''} changes=${changesOf(draft, settings.values.bays[draft.bay]?.camera)} reload=${reload} saved=${saved} onSaved=${setSaved} />`}
      <div class="row spread">
        <button type="button" disabled=${step === 0 || saved !== null} onClick=${() => go(step - 1)}>Back</button>
        ${step < 4 && html`<span class="row">${!right[step] && html`<span class="muted">${['Correct the name and the unit id.', draft.camera ? 'It has shown no picture yet.' : 'Choose a camera first.', 'Choose a port first.'][step]}</span>`}
          <button type="button" class="primary" disabled=${!right[step]} onClick=${() => go(step + 1)}>${text('Next: {0}', t(STEPS[step + 1]))}</button></span>`}
      </div>
    </section>`;
}

function App({ session }) {
  titled('Set up a bay');
  const started = new URLSearchParams(location.search).get('started');
  const { settings, bays, wrong, load } = useSettings();
  const otherBays = settings?.command_line.some((path) => path.length === 1 && path[0] === 'bays');
  const why = otherBays ? "this gateway was started with other bays than the file's (--bays), and would not have the new one. Start it without that." : settings?.why_not || settings?.faults?.[0]?.message;
  return html`
    <${Top} session=${session} current="Set up a bay" />
    <main id="main" tabindex="-1" class="page wizard">
      ${(wrong || !settings || why) && html`<h1 class="sr">Set up a bay</h1>`}
      ${started && session.bays.includes(started) ? html`<${Started} session=${session} bay=${started} />`
        : wrong ? html`<div class="notice bad" role="alert"><p><b>A bay can't be set up here</b>: ${wrong}</p><button type="button" onClick=${load}>Try again</button></div>`
          : !settings ? html`<p role="status">Reading the configuration …</p>`
            : why ? html`<div class="notice bad" role="alert"><p><b>A bay can't be set up here</b>: ${why}</p></div>`
              : html`${settings.waiting.length > 0 && html`<${Waiting} session=${session} settings=${settings} />`}<${Wizard} session=${session} settings=${settings} bays=${bays} reload=${load} />`}
    </main>`;
}

start(guarded(App));
