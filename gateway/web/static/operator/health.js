// Camera, ranger, PLC, broker: do they do their work? Ages, rates, delays; counters on demand.

import { html } from '../lib/page.js';
import { NONE, age, count, hz, number, percent, px, signed, words } from '../lib/format.js';
import { t, text } from '../lib/lang.js';
import { saidText } from '../lib/said.js';
import { pictureHealth, plcHealth, rangeHealth, visionHealth } from '../lib/views.js';
import { quantity } from '../lib/quantity.js';
import { distance, inUnit, places, speed } from '../lib/units.js';
import { useKept } from './hooks.js';
import { Health as Sign } from './signs.js';

const COUNTERS = [
  ['frames', 'frames evaluated'],
  ['frames_skipped', 'frames replaced by newer ones, or damaged'],
  ['frames_lost', 'frames lost with their process'],
  ['vision_restarts', 'vision workers replaced'],
  ['camera_reopens', 'camera opened again'],
  ['range_lines', 'good distance lines'],
  ['range_damaged', 'damaged lines dropped'],
  ['range_gaps', 'distances missing'],
  ['range_rejected', 'readings held back'],
  ['ranger_reopens', 'ranger opened again'],
];

const Part = ({ name, sign, detail, facts }) => html`<li>
  <div class="row spread"><b>${name}</b>${sign}</div>
  <dl class="tiny">${facts.map(([label, value]) => html`<div><dt>${label}</dt><dd class="value">${quantity(value)}</dd></div>`)}</dl>
  ${detail && html`<p class="small detail" translate="no">${detail}</p>`}
</li>`;

function broker(links) {
  if (!links) return { state: 'off', text: 'not known', facts: [] };
  const { mqtt } = links;
  if (mqtt === null) return { state: 'off', text: 'none configured', facts: [] };
  return {
    state: mqtt.connected ? 'ok' : 'bad',
    text: mqtt.connected ? 'connected' : 'not connected',
    detail: mqtt.store && !mqtt.store.ok ? text('events wait in memory only: {0}', mqtt.store.detail) : mqtt.broker,
    facts: [['delivered', count(mqtt.published)], ['waiting', count(mqtt.queued)], ['failed', count(mqtt.failed)], ['dropped', count(mqtt.dropped)], ['reconnects', count(mqtt.reconnects)]],
  };
}

function modbus(links) {
  if (!links || links.modbus.length === 0) return { state: 'off', text: links ? 'no port' : 'not known', facts: [] };
  const sum = (key) => links.modbus.reduce((total, port) => total + port[key], 0);
  const quiet = links.modbus.map((port) => port.plc_quiet_ms).filter((ms) => ms !== null);
  const peers = links.modbus.flatMap((port) => port.peers);
  const silent = quiet.length > 0 && Math.min(...quiet) > 5000;
  return {
    state: silent ? 'warn' : sum('open') > 0 ? 'ok' : 'off',
    text: silent ? 'the PLC has stopped asking' : sum('open') > 0 ? text('{0} connected', sum('open')) : 'nobody connected',
    detail: peers.slice(0, 3).map((peer) => peer.address).join(', '),
    facts: [['requests', count(sum('requests'))], ['exceptions', count(sum('exceptions'))], ...(quiet.length ? [['last read', age(Math.min(...quiet))]] : [])],
  };
}

function tasks(links) {
  const down = links?.tasks.filter((task) => !task.running) ?? [];
  const mended = links?.tasks.filter((task) => task.running) ?? [];
  if (!links) return { state: 'off', text: 'not known', facts: [] };
  return {
    state: down.length ? 'bad' : 'ok',
    text: down.length ? down.length === 1 ? '1 task does not run' : `${down.length} tasks do not run` : 'all tasks run',
    detail: down.map((task) => `${task.name}: ${task.last_error}`).join('; '),
    facts: [['restarted tasks', count(mended.length)], ['events dropped', count(links.events_dropped)]],
  };
}

/** What the camera is set to, where the gateway controls it. */
function exposure(set) {
  if (!set) return [];
  const state = { TOO_BRIGHT: '{0} (shortest)', TOO_DARK: '{0} (longest)', IGNORED: '{0} (not obeyed)', REFUSED: '{0} (refused)' }[set.state];
  const time = number(set.time_ms, 1, 'ms');
  return [['exposure', set.time_ms === null ? 'cannot be set' : state ? text(state, time) : time], ...(set.gain_db === null ? [] : [['gain', number(set.gain_db, 1, 'dB')]])];
}

/** The rim of the markers of the newest visits, and where that leads; nothing before ten visits. */
function rim(shown) {
  if (!shown) return [];
  const seen = percent(shown.visible);
  return [
    ['rim seen', shown.visible_a_day === null ? seen : text('{0}, {1} a day', seen, signed(100 * shown.visible_a_day, 1, '%'))],
    ['rim contrast', number(shown.contrast, 2)],
    ...(shown.days_left === null ? [] : [['below its limit in', days(shown.days_left)]]),
  ];
}

function days(left) {
  return left === 0 ? t('now') : number(Math.max(left, 0.1), left < 1 ? 1 : 0, 'd');
}

const PROOFS = {
  unproven: 'not proven', presentation_time: 'own times of the stream; a constant delay is not seen',
  buffer_time: 'time stamp of the driver', device_time: 'time stamp of the camera', own_clock: 'clock of the gateway',
};

/// What each of several rangers measures by itself; `=` where it is one of those that the distance rests on.
function rangers(shown) {
  const used = [1, 2, 3].filter((n) => shown?.[`quality_${n}`] != null);
  return used.map((n) => {
    const [quality, distance] = [shown[`quality_${n}`], shown[`distance_${n}_mm`]];
    return [String(n), `${distance == null ? words(quality) : `${number(distance, 0)} mm`}${shown.status & (8 << n) ? ' =' : ''}`];
  });
}

/** The outputs of the ranger's board, by their pins. `configured`: without a report it is unknown, and not absent. */
function relay(configured, shown) {
  if (!shown) return configured ? [['relay', NONE]] : [];
  const on = { '10': 'in place', '01': 'may move', '11': 'in place and may move', '00': 'off' }[`${Number(shown.in_place)}${Number(shown.may_move)}`];
  return [['relay', shown.fault ? text('{0} (not as commanded)', t(on)) : on]];
}

/** A drive that moves the vehicle; and where its marker is against its place, with standard deviations. `placed`: that is configured. */
function drive(state, placed) {
  const [told, at] = [state?.drive, state?.pose];
  if (!told && !placed) return '';
  const place = (axis) => {
    if (!at) return NONE;
    const [mm, sd] = [at[`${axis}_mm`], at[`${axis}_sd_mm`]];
    const decimals = Math.abs(mm) < 100 ? 1 : 0;
    return `${signed(inUnit(mm), places(decimals))} ± ${distance(sd, decimals)}`;
  };
  const sign = told && html`<${Sign} state=${told.enable || told.state === 'AT_PLACE' ? 'ok' : 'off'} text=${DRIVE[told.state] ?? words(told.state)} />`;
  const facts = told ? [['enabled', told.enable ? 'yes' : 'no'], ['setpoint', speed(told.speed_setpoint_mm_s)], ['stopping distance', distance(told.stopping_mm)]] : [];
  if (placed) facts.push(['to the right', place('x')], ['downwards', place('y')], ['to go', place('z')]);
  return html`<${Part} name=${told ? 'Drive' : 'Position'} sign=${sign} facts=${facts} />`;
}

const DRIVE = {
  INHIBITED: 'may not run', NO_DISTANCE: 'no distance', APPROACH: 'on its way', CREEP: 'creeping', SETTLE: 'running out', AT_PLACE: 'at its place',
};

export function Health({ state, links, hasRelay, hasPose }) {
  const [open, setOpen] = useKept('operator.counters', false);
  const [mqtt, reads, gateway] = [broker(links), modbus(links), tasks(links)];
  const unknown = html`<${Sign} state="off" text="not known" />`;
  return html`<section class="panel" aria-labelledby="health-title">
    <header><h2 id="health-title">Health</h2></header>
    <ul class="parts">
      <${Part} name="Camera" detail=${state ? saidText(state.vision) : ''}
        sign=${state ? html`<${Sign} state=${visionHealth(state)} text=${words(state.vision.quality.name)} />` : unknown}
        facts=${[['age', age(state?.vision.age_ms)], ['rate', hz(state?.rates.vision_hz)], ['age proven by', PROOFS[state?.vision.age_proof?.toLowerCase()] ?? NONE], ['delay', age(state?.rates.vision_latency_ms)], ...(state?.frames_summed > 1 ? [['frames summed', count(state.frames_summed)]] : []), ...exposure(state?.exposure)]} />
      <${Part} name="Picture"
        sign=${state ? html`<${Sign} ...${pictureHealth(state)} />` : unknown}
        facts=${[['brightness', percent(state?.picture?.brightness)], ['contrast', percent(state?.picture?.contrast)], ['sharpness', percent(state?.picture?.sharpness)], ['veil', percent(state?.picture?.veil)], ['proven to', percent(state?.picture?.veil_proven)], ['shift', px(state?.picture?.shift_px, 0)], ...rim(state?.marker)]} />
      <${Part} name="Ranger" detail=${state ? saidText(state.range) : ''}
        sign=${state ? html`<${Sign} state=${rangeHealth(state)} text=${words(state.range.quality.name)} />` : unknown}
        facts=${[['age', age(state?.range.age_ms)], ['rate', hz(state?.rates.range_hz)], ['damaged', count(state?.counters.range_damaged)], ...rangers(state?.rangers), ...relay(hasRelay, state?.relay)]} />
      <${Part} name="PLC"
        sign=${state ? html`<${Sign} state=${plcHealth(state)} text=${{ UNUSED: 'reads only', WAITING: 'no heartbeat yet', ALIVE: 'heartbeat alive', LOST: 'heartbeat lost' }[state.plc.link] ?? words(state.plc.link)} />` : unknown}
        facts=${[['heartbeat', state?.plc.age_ms == null ? NONE : age(state.plc.age_ms)], ['recipe', count(state?.plc.recipe)], ['writes', count(state?.plc.writes)], ['conflicts', count(state?.plc.write_conflicts)]]} />
      ${drive(state, hasPose)}
      <${Part} name="Modbus" detail=${reads.detail} sign=${html`<${Sign} state=${reads.state} text=${reads.text} />`} facts=${reads.facts} />
      <${Part} name="Broker" detail=${mqtt.detail} sign=${html`<${Sign} state=${mqtt.state} text=${mqtt.text} />`} facts=${mqtt.facts} />
      <${Part} name="Gateway" detail=${gateway.detail} sign=${html`<${Sign} state=${gateway.state} text=${gateway.text} />`} facts=${gateway.facts} />
    </ul>
    <details open=${open} onToggle=${(event) => setOpen(event.target.open)}>
      <summary>Counters since the start of the gateway</summary>
      <table class="counters"><tbody>
        ${COUNTERS.map(([key, text]) => html`<tr><th scope="row">${text}</th><td class="right value">${count(state?.counters[key])}</td></tr>`)}
      </tbody></table>
    </details>
  </section>`;
}
