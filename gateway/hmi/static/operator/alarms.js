// The alarm list after ISA-18.2. Acknowledging says "I have seen it", to people; it never ends a stop.

import { html, useState } from '../vendor/preact-htm.js';
import { post, toLogin } from '../lib/api.js';
import { clock, words } from '../lib/format.js';
import { useFetched } from './hooks.js';
import { Priority } from './signs.js';

const STATE_WORDS = {
  unacknowledged: 'active, not acknowledged',
  acknowledged: 'active, acknowledged',
  returned: 'over, not acknowledged',
  latched_unacknowledged: 'over, latched, not acknowledged',
  latched_acknowledged: 'over, latched: to be reset',
  shelved: 'shelved',
  suppressed: 'suppressed by design',
  out_of_service: 'out of service',
};
const TO_ACKNOWLEDGE = ['unacknowledged', 'returned', 'latched_unacknowledged'];
const HIDDEN = ['normal', 'shelved', 'suppressed', 'out_of_service'];

const PRIORITIES = { high: 3, medium: 2, low: 1 };
const level = (alarm) => (typeof alarm.priority === 'string' ? PRIORITIES[alarm.priority.toLowerCase()] : alarm.priority);

export function Alarms({ bay, summary, session, known }) {
  const [count, setCount] = useState(0);
  const [refused, setRefused] = useState('');
  const [answer, wrong] = useFetched('/api/alarms', `${JSON.stringify(summary ?? null)} ${count}`, 5000);
  const all = answer === null ? [] : Array.isArray(answer) ? answer : answer.alarms ?? [];
  const mine = all.filter((alarm) => bay === null || alarm.bay === bay || alarm.bay === null);
  const listed = mine.filter((alarm) => !HIDDEN.includes(alarm.state));
  const hidden = mine.filter((alarm) => HIDDEN.includes(alarm.state) && alarm.state !== 'normal');
  const others = all.length - mine.length;
  const may = session.may_acknowledge ?? (session.role === 'viewer' || session.role === 'technician');

  const acknowledge = async (alarm) => {
    try {
      await post(`/api/alarms/${encodeURIComponent(alarm.id)}/acknowledge`, { occurrence: alarm.occurrences ?? null }, session.csrf);
      setRefused('');
    } catch (error) {
      if (error.status === 401) toLogin();
      setRefused(error.message);
    }
    setCount((n) => n + 1);
  };
  const open = listed.filter((alarm) => TO_ACKNOWLEDGE.includes(alarm.state));
  return html`<section class=${`panel alarms ${open.length ? 'ringing' : ''}`} aria-labelledby="alarms-title">
    <header>
      <h2 id="alarms-title">Alarms</h2>
      <span class="small">${answer === null ? '' : listed.length === 0 ? 'none' : `${listed.length} stand, ${open.length} not acknowledged`}</span>
    </header>
    <p class="sr" role="status" aria-live="assertive">${open.length ? `${open.length} alarms to acknowledge: ${open[0].title ?? words(open[0].kind)}` : ''}</p>
    ${(wrong || !known) && html`<p class="notice warn small">The list may be old: ${wrong || 'no connection to the gateway'}.</p>`}
    ${refused && html`<p class="notice bad small" role="alert">Not acknowledged: ${refused}</p>`}
    ${answer !== null && listed.length === 0 && html`<p class="muted">No alarm stands.</p>`}
    <ul>
      ${listed.map((alarm) => {
        const waits = TO_ACKNOWLEDGE.includes(alarm.state);
        const active = alarm.active ?? (alarm.state === 'unacknowledged' || alarm.state === 'acknowledged');
        return html`<li key=${alarm.id} class=${waits ? 'waits' : ''}>
          <${Priority} level=${level(alarm)} acknowledged=${!waits} />
          <div class="what">
            <p><b>${alarm.title ?? words(alarm.kind)}</b>${bay === null || alarm.bay !== bay ? html` <span class="tag">${alarm.bay ?? 'gateway'}</span>` : ''}</p>
            <p class="small">${active ? '● ' : '○ '}${STATE_WORDS[alarm.state] ?? words(alarm.state)}${alarm.raised_ms ?? alarm.raised_at_ms ? ` · ${clock(alarm.raised_ms ?? alarm.raised_at_ms)}` : ''}${alarm.occurrences > 1 ? ` · ${alarm.occurrences} times` : ''}${alarm.who ? ` · ${alarm.who}` : ''}</p>
            ${alarm.detail && html`<p class="small">${alarm.detail}</p>`}
            ${alarm.action && html`<details class="small"><summary>What to do${alarm.respond_min ? ` within ${alarm.respond_min} min` : ''}</summary>
              ${alarm.meaning && html`<p>${alarm.meaning}.</p>`}<p>${alarm.action}.</p>${alarm.consequence && html`<p class="muted">Meanwhile: ${alarm.consequence}.</p>`}</details>`}
          </div>
          ${waits && html`<button type="button" disabled=${!may} onClick=${() => acknowledge(alarm)}
            title=${may ? 'Says that you have seen it. Never ends a stop: only its cause going away does.' : 'Log in to acknowledge. Acknowledging never ends a stop.'}>
            Acknowledge<span class="sr"> ${alarm.title ?? words(alarm.kind)} (never ends a stop)</span></button>`}
        </li>`;
      })}
    </ul>
    ${(hidden.length > 0 || others > 0) && html`<p class="small muted">${[hidden.length ? `${hidden.length} shelved, suppressed or out of service` : '', others ? `${others} of other bays` : ''].filter(Boolean).join('; ')}</p>`}
  </section>`;
}
