// The alarm list after ISA-18.2. Acknowledging says "I have seen it", to people; it never ends a stop.

import { html, useState } from '../vendor/preact-htm.js';
import { post, toLogin } from '../lib/api.js';
import { clock, words } from '../lib/format.js';
import { TO_ACKNOWLEDGE, mayAcknowledge, standing } from '../lib/views.js';
import { Notice } from './notice.js';
import { Priority } from './signs.js';

const STATE_WORDS = {
  unacknowledged: 'active, not acknowledged',
  acknowledged: 'active, acknowledged',
  returned: 'over, not acknowledged',
  latched_unacknowledged: 'over, latched, not acknowledged',
  latched_acknowledged: 'over, latched: to be reset',
};
const LEVELS = { high: 3, medium: 2, low: 1 };

/** `answer`: of /api/alarms, null: none yet; `wrong`: why the newest could not be had; `again`: ask anew. */
export function Alarms({ bay, answer, wrong, again, session, known }) {
  const [refused, setRefused] = useState('');
  const all = answer?.alarms ?? [];
  const mine = all.filter((alarm) => bay === null || alarm.bay === bay || alarm.bay === null);
  const listed = mine.filter(standing);
  const hidden = mine.length - listed.length;
  const others = all.filter(standing).length - listed.length;
  const may = mayAcknowledge(session);

  const acknowledge = async (alarm) => {
    try {
      await post(`/api/alarms/${encodeURIComponent(alarm.id)}/acknowledge`, { occurrence: alarm.occurrences }, session.csrf);
      setRefused('');
    } catch (error) {
      if (error.status === 401) toLogin();
      setRefused(error.message);
    }
    again();
  };
  const open = listed.filter((alarm) => TO_ACKNOWLEDGE.includes(alarm.state));
  return html`<section class=${`panel alarms ${listed.length ? '' : 'none'}`} aria-labelledby="alarms-title">
    <header>
      <h2 id="alarms-title">Alarms</h2>
      <span class="small">${answer === null ? '' : listed.length === 0 ? 'none' : `${listed.length} stand, ${open.length} not acknowledged`}</span>
    </header>
    <p class="sr" role="status" aria-live="assertive">${open.length ? `${open.length} alarms to acknowledge: ${open[0].title}` : ''}</p>
    <${Notice} kind="warn" say=${wrong || !known ? `The list may be old: ${wrong || 'no connection to the gateway'}.` : ''} />
    <${Notice} kind="bad" loud say=${refused && `Not acknowledged: ${refused}`} />
    <p class="muted" hidden=${answer === null || listed.length > 0}>No alarm stands.</p>
    <ul tabindex=${listed.length > 2 ? 0 : undefined} aria-label="alarms, the most important first">
      ${listed.map((alarm) => {
        const waits = TO_ACKNOWLEDGE.includes(alarm.state);
        return html`<li key=${alarm.id} class=${waits ? 'waits' : ''}>
          <${Priority} level=${LEVELS[alarm.priority]} acknowledged=${!waits} />
          <div class="what">
            <p><b>${alarm.title}</b>${bay === null || alarm.bay !== bay ? html` <span class="tag">${alarm.bay ?? 'gateway'}</span>` : ''}</p>
            <p class="small">${alarm.active ? '● ' : '○ '}${STATE_WORDS[alarm.state] ?? words(alarm.state)}${alarm.raised_ms === null ? '' : ` · ${clock(alarm.raised_ms)}`}${alarm.occurrences > 1 ? ` · ${alarm.occurrences} times` : ''}${alarm.who ? ` · by ${alarm.who}` : ''}</p>
            ${alarm.detail && html`<p class="small">${alarm.detail}</p>`}
            <details class="small"><summary>What to do, within ${alarm.respond_min} min</summary>
              <p><b>${alarm.action}.</b></p><p>It means: ${alarm.meaning}. Meanwhile: ${alarm.consequence}.</p><p class="muted">Causes: ${alarm.causes.join('; ')}.</p></details>
          </div>
          ${waits && html`<button type="button" disabled=${!may} onClick=${() => acknowledge(alarm)}
            title=${may ? 'Says that you have seen it. Never ends a stop: only its cause going away does.' : 'Log in to acknowledge. Acknowledging never ends a stop.'}>
            Acknowledge<span class="sr"> ${alarm.title} (never ends a stop)</span></button>`}
        </li>`;
      })}
    </ul>
    ${(hidden > 0 || others > 0) && html`<p class="small muted">${[hidden ? `${hidden} shelved, suppressed or out of service` : '', others ? `${others} more of other bays` : ''].filter(Boolean).join('; ')}</p>`}
  </section>`;
}
