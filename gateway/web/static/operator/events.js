// What happened, newest first, with a filter.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { get, post, toLogin } from '../lib/api.js';
import { moment, words } from '../lib/format.js';
import { t, text } from '../lib/lang.js';
import { mayAcknowledge } from '../lib/views.js';
import { GROUP_WORDS, matches, eventText } from './eventwords.js';
import { useKept } from './hooks.js';
import { Notice } from './notice.js';

const MOST = 1000;
/** Follows `/api/events` as its newest number grows. */
function useEvents(newest) {
  const [rows, setRows] = useState([]);
  const [wrong, setWrong] = useState('');
  const busy = useRef(false);
  const last = useRef(0);
  const notBefore = useRef(0);
  useEffect(() => {
    if (newest == null || busy.current || newest === last.current || performance.now() < notBefore.current) return;
    if (newest < last.current) { // another start of the gateway: it counts anew
      last.current = 0;
      setRows([]);
    }
    busy.current = true;
    get(`/api/events?after=${last.current}`)
      .then((answer) => {
        const fresh = answer.events.filter((row) => row.number > last.current);
        const reached = fresh.length ? fresh[fresh.length - 1].number : newest;
        last.current = Math.max(last.current, reached);
        setRows((was) => [...was, ...fresh.map(({ event, said }) => ({ ...event, said }))].slice(-MOST));
        setWrong('');
      })
      .catch((error) => {
        if (error.status === 401) toLogin();
        notBefore.current = performance.now() + 3000;
        setWrong(error.name === 'TypeError' ? 'no connection to the gateway' : error.message);
      })
      .finally(() => {
        busy.current = false;
      });
  });
  return [rows, wrong];
}

/** Marks this moment, with a note: an event, and the pictures round it are kept. */
function Mark({ bay, session, setFailed }) {
  const [note, setNote] = useState(null); // null: not asked for
  const [button, field] = [useRef(null), useRef(null)];
  const asking = note !== null;
  const asked = useRef(false);
  useEffect(() => { // what had the focus is gone
    if (asking) field.current.focus();
    else if (asked.current && document.activeElement === document.body) button.current.focus();
    asked.current = asking;
  }, [asking]);
  const mark = async (event) => {
    event.preventDefault();
    try {
      await post(`/api/bays/${encodeURIComponent(bay)}/mark`, { note }, session.csrf);
      setNote(null);
      setFailed('');
    } catch (error) {
      setFailed(text('Not marked: {0}.', error.message));
    }
  };
  if (!asking) return html`<button ref=${button} type="button" title="keep the pictures of this moment, and find it again" onClick=${() => setNote('')}>Mark this moment</button>`;
  return html`<form class="row compact" onSubmit=${mark}>
    <input ref=${field} type="text" maxlength="120" placeholder="note" aria-label="note for the mark" value=${note} onInput=${(event) => setNote(event.target.value)} />
    <button type="submit">Mark</button>
    <button type="button" onClick=${() => setNote(null)}>Cancel</button>
  </form>`;
}

export function Events({ bay, newest, session }) {
  const [failed, setFailed] = useState('');
  const [rows, wrong] = useEvents(newest);
  const [group, setGroup] = useKept('operator.events', 'all');
  const [wanted, setWanted] = useState('');
  const shown = rows.filter((event) => (bay === null || event.bay === bay) && matches(event, group, wanted)).reverse();
  return html`<section class="panel events" aria-labelledby="events-title">
    <header>
      <h2 id="events-title">Events</h2>
      <div class="row compact">
        ${bay !== null && mayAcknowledge(session) && html`<${Mark} bay=${bay} session=${session} setFailed=${setFailed} />`}
        <select aria-label="kind of events" value=${group} onChange=${(event) => setGroup(event.target.value)}>
          ${Object.entries(GROUP_WORDS).map(([key, name]) => html`<option value=${key} selected=${key === group}>${name}</option>`)}
        </select>
        <input type="search" placeholder="filter" aria-label="filter events by words" value=${wanted} onInput=${(event) => setWanted(event.target.value)} />
      </div>
    </header>
    <${Notice} kind="warn" say=${failed} />
    <${Notice} kind="warn" say=${wrong && text('The list may be old: {0}.', t(wrong))} />
    <div class="scroll" tabindex="0" role="region" aria-label="events, newest first">
      <table class="stack"><thead><tr><th scope="col">Time</th>${bay === null && html`<th scope="col">Bay</th>`}<th scope="col">Event</th><th scope="col">What</th></tr></thead><tbody>
        ${shown.slice(0, 300).map((event) => html`<tr key=${event.id}>
          <td class="nowrap mono">${moment(event.timestamp_ms, { ms: true })}</td>
          ${bay === null && html`<td class="name" translate="no">${event.bay}</td>`}
          <td class="nowrap">${words(event.kind)}</td><td>${eventText(event)}</td></tr>`)}
      </tbody></table>
      ${shown.length === 0 && html`<p class="muted">${rows.length ? 'No event fits the filter.' : 'No event yet.'}</p>`}
      ${shown.length > 300 && html`<p class="muted small">${`${shown.length - 300} older ones: filter to see them.`}</p>`}
    </div>
  </section>`;
}
