// What `gateway doctor` finds beside the running gateway: one line for each, what was tried, what came back, what to do. The
// lines are its own, in English.

import { html, useState } from '../lib/page.js';
import { get } from '../lib/api.js';
import { listed, t } from '../lib/lang.js';

const WORDS = { ok: 'well', warning: 'warning', fault: 'fault' };
const PLURAL = { ok: 'well', warning: 'warnings', fault: 'faults' };
const SIGN = { ok: '', warning: 'warn', fault: 'bad' };
const TIMEOUT_MS = 90_000;

export function Doctor() {
  const [state, setState] = useState({ found: null, busy: false, wrong: '' });
  const go = async () => {
    setState({ found: null, busy: true, wrong: '' });
    try {
      setState({ found: await get('/api/doctor', { timeoutMs: TIMEOUT_MS }), busy: false, wrong: '' });
    } catch (error) {
      setState({ found: null, busy: false, wrong: error.message });
    }
  };
  return html`<section class="doctor" aria-label="Doctor"><header class="row spread"><h2>Doctor</h2><button type="button" disabled=${state.busy} onClick=${go}>Examine now</button></header>
    <p class="hint">Sensors as the running gateway sees them, ports, the way to the PLC, brokers, certificates, clock, disk and processors. Nothing is changed, and no device that a bay uses is opened.</p>
    <div aria-live="polite">
      ${state.busy && html`<p class="muted" role="status">Examining; a broker that does not answer takes its time …</p>`}
      ${state.wrong && html`<p class="notice bad">${state.wrong}</p>`}
      ${state.found && html`<p class="counts">${['fault', 'warning', 'ok'].map((verdict) => [verdict, state.found.findings.filter((one) => one.verdict === verdict).length]).filter(([, count]) => count > 0).map(([verdict, count]) => html`<span class=${`tag ${SIGN[verdict]}`}>${listed([String(count), t(count === 1 ? WORDS[verdict] : PLURAL[verdict])], ' ')}</span>`)}</p>
      ${!state.found.complete && html`<p class="notice warn">A part took too long; what comes after it was not tried.</p>`}
      <ul class="findings">${[...state.found.findings].sort((a, b) => 'fwo'.indexOf(a.verdict[0]) - 'fwo'.indexOf(b.verdict[0])).map((one) => html`<li>
        <span class=${`tag ${SIGN[one.verdict]}`}>${WORDS[one.verdict]}</span>
        <span translate="no"><b>${`${one.part} ${one.name}`.trim()}</b> <span class="muted">${one.tried}:</span> <span>${one.result}</span></span>
        ${one.remedy && html`<p class="remedy" translate="no"><span aria-hidden="true">→</span> ${one.remedy}</p>`}</li>`)}</ul>`}
    </div></section>`;
}
