// Camera, ranger, PLC, broker: do they do their work? Ages, rates, delays; counters on demand.

import { html } from '../vendor/preact-htm.js';
import { NONE, age, count, hz, words } from '../lib/format.js';
import { plcHealth, rangeHealth, visionHealth } from '../lib/views.js';
import { useKept } from './hooks.js';
import { Health as Sign } from './signs.js';

const COUNTERS = [
  ['frames', 'frames evaluated'],
  ['frames_skipped', 'frames replaced by newer ones'],
  ['frames_lost', 'frames lost with their worker'],
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
  <dl class="tiny">${facts.map(([label, value]) => html`<div><dt>${label}</dt><dd class="value">${value}</dd></div>`)}</dl>
  ${detail && html`<p class="small detail">${detail}</p>`}
</li>`;

function broker(links) {
  const link = links?.broker ?? null;
  if (link === null) return { state: 'off', text: 'none', detail: '', facts: [] };
  const connected = link.connected ?? links.broker_connected ?? null;
  const delivery = link.delivery ?? links.delivery ?? null;
  return {
    state: connected === null ? 'off' : connected ? 'ok' : 'bad',
    text: connected === null ? 'not known' : connected ? 'connected' : 'not connected',
    detail: link.detail ?? '',
    facts: delivery
      ? [['delivered', count(delivery.published)], ['waiting', count(delivery.queued)], ['failed', count(delivery.failed)], ['dropped', count(delivery.dropped)], ['reconnects', count(delivery.reconnects)]]
      : [],
  };
}

export function Health({ state, links }) {
  const [open, setOpen] = useKept('operator.counters', false);
  const mqtt = broker(links);
  const unknown = html`<${Sign} state="off" text="not known" />`;
  return html`<section class="panel" aria-labelledby="health-title">
    <header><h2 id="health-title">Health</h2></header>
    <ul class="parts">
      <${Part} name="Camera" detail=${state?.vision.detail}
        sign=${state ? html`<${Sign} state=${visionHealth(state)} text=${words(state.vision.quality.name)} />` : unknown}
        facts=${[['age', age(state?.vision.age_ms)], ['rate', hz(state?.rates.vision_hz)], ['delay', age(state?.rates.vision_latency_ms)]]} />
      <${Part} name="Ranger" detail=${state?.range.detail}
        sign=${state ? html`<${Sign} state=${rangeHealth(state)} text=${words(state.range.quality.name)} />` : unknown}
        facts=${[['age', age(state?.range.age_ms)], ['rate', hz(state?.rates.range_hz)], ['damaged', count(state?.counters.range_damaged)]]} />
      <${Part} name="PLC"
        sign=${state ? html`<${Sign} state=${plcHealth(state)} text=${{ UNUSED: 'reads only', WAITING: 'no heartbeat yet', ALIVE: 'heartbeat alive', LOST: 'heartbeat lost' }[state.plc.link] ?? words(state.plc.link)} />` : unknown}
        facts=${[['heartbeat', state?.plc.age_ms == null ? NONE : age(state.plc.age_ms)], ['recipe', count(state?.plc.recipe)], ['writes', count(state?.plc.writes)]]} />
      <${Part} name="Broker" detail=${mqtt.detail} sign=${html`<${Sign} state=${mqtt.state} text=${mqtt.text} />`} facts=${mqtt.facts} />
    </ul>
    <details open=${open} onToggle=${(event) => setOpen(event.target.open)}>
      <summary>Counters since the start of the gateway</summary>
      <table class="counters"><tbody>
        ${COUNTERS.map(([key, text]) => html`<tr><th scope="row">${text}</th><td class="right value">${count(state?.counters[key])}</td></tr>`)}
      </tbody></table>
    </details>
  </section>`;
}
