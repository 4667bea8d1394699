// The alarm list after ISA-18.2. No action on an alarm ends a stop: each changes the alarm list and nothing else.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { post, toLogin } from '../lib/api.js';
import { moment, words } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { saidText } from '../lib/said.js';
import { LEVELS, TO_ACKNOWLEDGE, mayAcknowledge, alarmCount, standing } from '../lib/views.js';
import { Notice } from './notice.js';
import { Priority } from './signs.js';

const TEXTS = {
  title: 'Alarms',
  none: 'No alarm.',
  quiet: 'No alarm is shown.',
  summary: (all, open) => (all === 0 ? 'none' : alarmCount(all, open)),
  waiting: (count, first) => text('alarms to acknowledge: {0}, {1}', count, t(first)),
  old: (why) => text('The list may be old: {0}.', t(why)),
  noConnection: 'no connection to the gateway',
  notDone: (why) => text('Not done: {0}', why),
  gateway: 'gateway',
  by: (who) => text('by {0}', who),
  todo: (minutes) => `What to do, within ${minutes} min`,
  hidden: (count) => `${count} hidden: shelved, suppressed or out of service`,
  others: (count) => `${count} more of other bays`,
  all: (count) => `Acknowledge all ${count} shown`,
  more: 'Hide it',
  reason: 'why (kept with the action)',
  harmless: 'It never ends a stop.',
  acknowledge: ['Acknowledge', 'Says that you have seen it. Never ends a stop: only its cause going away does.', 'Log in to acknowledge. Acknowledging never ends a stop.'],
  reset: ['Reset', 'Ends an alarm that stays because of what was lost. Its cause is gone. Never ends a stop.', 'Log in to reset. Resetting an alarm never ends a stop.'],
  unshelve: ['Show again', 'Ends the shelving now. Never ends a stop.', 'Only a technician can show it again.'],
  restore: ['Back into service', 'The alarm is announced again when its cause is active. Never ends a stop.', 'Only a technician can put it back into service.'],
  shelve: 'Shelve',
  remove: 'Out of service',
  removeTitle: 'For equipment that is removed: without a limit of time, until somebody puts it back.',
};
const STATE_WORDS = {
  unacknowledged: 'active, not acknowledged',
  acknowledged: 'active, acknowledged',
  returned: 'returned to normal, not acknowledged',
  latched_unacknowledged: 'returned to normal, stays until it is acknowledged and reset',
  latched_acknowledged: 'returned to normal, stays until it is reset',
  shelved: 'shelved',
  suppressed: 'suppressed: means nothing for the moment',
  out_of_service: 'out of service',
};
const SHELVE = [[15, '15 min'], [60, '1 h'], [240, '4 h'], [720, '12 h']];
/** What a button does to an alarm in that state, and whether that is a technician's. */
const ACTION = {
  unacknowledged: ['acknowledge', false],
  returned: ['acknowledge', false],
  latched_unacknowledged: ['acknowledge', false],
  latched_acknowledged: ['reset', false],
  shelved: ['unshelve', true],
  out_of_service: ['restore', true],
};

/** Shelve or take out of service, with a reason: a technician's. */
function Hide({ alarm, act }) {
  const [minutes, setMinutes] = useState(60);
  const [note, setNote] = useState('');
  return html`<details class="small"><summary>${TEXTS.more}<span class="sr"> ${alarm.title}</span></summary>
    <div class="row compact">
      <select aria-label=${text('for how long: {0}', t(alarm.title))} value=${minutes} onChange=${(event) => setMinutes(Number(event.target.value))}>
        ${SHELVE.map(([value, name]) => html`<option value=${value} selected=${value === minutes}>${name}</option>`)}
      </select>
      <input type="text" maxlength="120" placeholder=${TEXTS.reason} aria-label=${listed([t(TEXTS.reason), t(alarm.title)], ': ')} value=${note} onInput=${(event) => setNote(event.target.value)} />
      <button type="button" title=${TEXTS.harmless} onClick=${() => act(alarm, 'shelve', { note, minutes })}>${TEXTS.shelve}<span class="sr"> ${alarm.title}</span></button>
      <button type="button" title=${TEXTS.removeTitle} onClick=${() => act(alarm, 'remove', { note })}>${TEXTS.remove}<span class="sr"> ${alarm.title}</span></button>
    </div></details>`;
}

function Row({ alarm, bay, session, act }) {
  const waits = TO_ACKNOWLEDGE.includes(alarm.state);
  const technician = session.role === 'technician';
  const [does, hers] = ACTION[alarm.state] ?? [null, false];
  const may = hers ? technician : mayAcknowledge(session);
  const state = [
    t(STATE_WORDS[alarm.state] ?? words(alarm.state)),
    alarm.raised_ms === null ? '' : moment(alarm.raised_ms),
    alarm.state === 'shelved' && alarm.shelved_until_ms !== null ? text('until {0}', moment(alarm.shelved_until_ms)) : '',
    alarm.occurrences > 1 ? text('{0} times', alarm.occurrences) : '',
    alarm.who ? TEXTS.by(alarm.who) : '',
    alarm.note,
  ].filter(Boolean);
  return html`<li class=${waits ? `waits ${alarm.priority}` : ''}>
    <${Priority} level=${LEVELS[alarm.priority]} acknowledged=${!waits} />
    <div class="what">
      <p><b>${alarm.title}</b>${bay === null || alarm.bay !== bay ? html` <span class="tag" translate=${alarm.bay ? 'no' : undefined}>${alarm.bay ?? TEXTS.gateway}</span>` : ''}</p>
      <p class="small">${alarm.active ? '● ' : '○ '}${listed(state)}</p>
      ${alarm.detail && html`<p class="small" translate="no">${saidText(alarm)}</p>`}
      <details class="small"><summary>${TEXTS.todo(alarm.respond_min)}</summary>
        <p><b>${listed([t(alarm.action), '.'], '')}</b></p><p>${text('It means: {0}. Meanwhile: {1}.', t(alarm.meaning), t(alarm.consequence))}</p><p class="muted">${text('Causes: {0}.', alarm.causes.map((cause) => t(cause)).join('; '))}</p></details>
      ${technician && standing(alarm) && html`<${Hide} alarm=${alarm} act=${act} />`}
    </div>
    ${does && html`<button type="button" disabled=${!may} onClick=${() => act(alarm, does)} title=${TEXTS[does][may ? 1 : 2]}>
      ${TEXTS[does][0]}<span class="sr"> ${text('{0} (never ends a stop)', t(alarm.title))}</span></button>`}
  </li>`;
}

/** `answer`: of /api/alarms, null: none yet; `wrong`: why the newest could not be had; `again`: ask anew. */
export function Alarms({ bay, answer, wrong, again, session, known }) {
  const [refused, setRefused] = useState('');
  const acted = useRef(false); // a button was used that may be gone with the next answer
  const panel = useRef(null);
  useEffect(() => {
    if (!acted.current || document.activeElement !== document.body) return;
    acted.current = false;
    panel.current.focus({ preventScroll: true });
  }, [answer]);
  const all = answer?.alarms ?? [];
  const mine = all.filter((alarm) => bay === null || alarm.bay === bay || alarm.bay === null);
  const listed = mine.filter(standing);
  const hidden = mine.filter((alarm) => !standing(alarm));
  const others = all.filter(standing).length - listed.length;
  const open = listed.filter((alarm) => TO_ACKNOWLEDGE.includes(alarm.state));

  const send = async (alarm, what, more = {}) => {
    try {
      await post(`/api/alarms/${encodeURIComponent(alarm.id)}/${what}`, { occurrence: alarm.occurrences, ...more }, session.csrf);
      return '';
    } catch (error) {
      if (error.status === 401) toLogin();
      return error.message;
    }
  };
  const tell = (fault) => {
    acted.current = fault === '';
    setRefused(fault);
    again();
  };
  const act = async (...what) => tell(await send(...what));
  /** Those that are in sight now, each by the occurrence that was seen. */
  const acknowledgeAll = async () => {
    const faults = [];
    for (const alarm of open) faults.push(await send(alarm, 'acknowledge'));
    tell(faults.filter(Boolean).join('; '));
  };
  const row = (alarm) => html`<${Row} key=${alarm.id} alarm=${alarm} bay=${bay} session=${session} act=${act} />`;
  return html`<section id="alarms" ref=${panel} tabindex="-1" data-bay=${bay ?? ''} class=${`panel alarms ${listed.length ? '' : 'none'}`} aria-labelledby="alarms-title">
    <header>
      <h2 id="alarms-title">${TEXTS.title}</h2>
      <span class="small">${answer === null || (hidden.length > 0 && listed.length === 0) ? '' : TEXTS.summary(listed.length, open.length)}</span>
      ${open.length > 1 && html`<span class="compact"><button type="button" disabled=${!mayAcknowledge(session)} title=${TEXTS.acknowledge[mayAcknowledge(session) ? 1 : 2]} onClick=${acknowledgeAll}>${TEXTS.all(open.length)}</button></span>`}
    </header>
    <p class="sr" role="status" aria-live="assertive">${open.length ? TEXTS.waiting(open.length, open[0].title) : ''}</p>
    <${Notice} kind="warn" say=${wrong || !known ? TEXTS.old(wrong || TEXTS.noConnection) : ''} />
    <${Notice} kind="bad" loud say=${refused && TEXTS.notDone(refused)} />
    <p class="muted" hidden=${answer === null || listed.length > 0}>${hidden.length > 0 ? TEXTS.quiet : TEXTS.none}</p>
    <ul tabindex=${listed.length > 2 ? 0 : undefined} aria-label="alarms, the most important first">${listed.map(row)}</ul>
    ${hidden.length > 0 && html`<details class="hidden-alarms"><summary>${TEXTS.hidden(hidden.length)}</summary><ul>${hidden.map(row)}</ul></details>`}
    ${others > 0 && html`<p class="small muted">${TEXTS.others(others)}</p>`}
  </section>`;
}
