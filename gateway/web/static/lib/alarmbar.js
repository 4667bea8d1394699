// The alarm to see first, and how many there are: at the top of every page for desks, and in its tab's title. On request
// a sound, too. It only shows: what is done about an alarm is done in the operator's list.

import { get, toLogin } from './api.js';
import { moment } from './freshness.js';
import { kiosk } from './kiosk.js';
import { html, useEffect, useRef, useState } from './page.js';
import { NONE } from './format.js';
import { listed, t, text } from './lang.js';
import { open } from './live.js';
import { useFresh, useKept } from '../operator/hooks.js';
import { Priority } from '../operator/signs.js';
import { allow, audible, tone } from './sound.js';
import { alarmsInTitle } from './title.js';
import { LEVELS, TO_ACKNOWLEDGE, alarmCount } from './views.js';

const TEXTS = {
  active: ['active, acknowledged', 'active, not acknowledged'],
  over: ['returned to normal, acknowledged', 'returned to normal, not acknowledged'],
  gateway: 'gateway',
  count: (waiting, all) => alarmCount(all, waiting),
  none: 'No alarm.',
  quiet: 'No alarm is shown.',
  behind: [
    ['suppressed', 'Suppressed: {0}.'],
    ['shelved', 'Shelved: {0}.'],
    ['out_of_service', 'Out of service: {0}.'],
    ['function_checks', 'Function checks that are on: {0}.'],
    ['silent_sensors', 'Cameras and rangers that deliver nothing: {0}.'],
  ],
  list: 'To the alarms',
  old: 'The alarms are not known: no connection to the gateway.',
  sound: 'sound',
  silent: 'sound, after a click',
  soundTitle: 'A sound for alarms that are not acknowledged, at this computer. Off until somebody switches it on.',
};
const PACE_MS = 100; // a truck that moves in place is an alarm, too
const ASK_MS = 1000; // while no live link can be had
const AGAIN_MS = 15_000; // while one of high priority is not acknowledged
const STARTS_MS = 500; // a browser that lets it sound has begun by then
const TONE_HZ = { high: 880, medium: 660, low: 440 };

/** What stands there where no alarm is shown: nor is one that was not to be shown. */
function quiet(summary) {
  const behind = TEXTS.behind.filter(([name]) => summary[name] > 0).map(([name, said]) => text(said, summary[name]));
  return behind.length ? listed([t(TEXTS.quiet), ...behind], ' ') : TEXTS.none;
}

/** A short sound, as often as the priority is high. */
function beep(audio, priority) {
  for (let n = 0; n < LEVELS[priority]; n += 1) tone(audio, TONE_HZ[priority], n * 0.3, 0.18, { loud: 0.2, fades: false });
}

/** @returns {boolean} it is on, but this browser waits for a click in the page */
function useSound(on, first, waiting) {
  const [audio, setAudio] = useState(null);
  const [silent, setSilent] = useState(false);
  const heard = useRef('');
  useEffect(() => {
    if (!on) return undefined;
    let made;
    try {
      made = new AudioContext();
    } catch {
      setSilent(true); // a machine without sound
      return () => setSilent(false);
    }
    const end = new AbortController();
    const changed = () => setSilent(!audible(made));
    made.addEventListener('statechange', changed, { signal: end.signal });
    allow(made, end.signal);
    const late = setTimeout(changed, STARTS_MS);
    setAudio(made);
    return () => {
      clearTimeout(late);
      end.abort();
      made.close().catch(() => {});
      setAudio(null);
      setSilent(false);
    };
  }, [on]);
  const waits = waiting > 0 && first !== null && TO_ACKNOWLEDGE.includes(first.state);
  const which = waits ? `${first.id} ${first.occurrences} ${waiting}` : '';
  useEffect(() => {
    if (audio === null || which === '') {
      heard.current = '';
      return undefined;
    }
    const sound = () => audible(audio) && beep(audio, first.priority);
    const anew = () => {
      if (which !== heard.current && audible(audio)) {
        sound();
        heard.current = which;
      }
    };
    anew();
    audio.addEventListener('statechange', anew);
    const timer = first.priority === 'high' ? setInterval(sound, AGAIN_MS) : 0;
    return () => {
      audio.removeEventListener('statechange', anew);
      clearInterval(timer);
    };
  }, [audio, which]);
  return silent;
}

/**
 * The newest summary of the alarms while `on`, in a page in the background, too: it sounds there.
 * @returns {any} undefined: nothing yet; null: not known any more
 */
function useSummary(on) {
  const live = useFresh();
  const [lost, setLost] = useState(false);
  useEffect(() => {
    if (!on) return undefined;
    let timer = 0;
    let asks = 0;
    let failed = 0; // connections since the last message
    const forget = () => {
      live.forget();
      setLost(true);
    };
    /** As many pages are open as may be, or the login has ended. */
    const once = async () => {
      const asked = moment();
      try {
        live.take((await get('/api/alarms')).summary, asked);
      } catch (error) {
        if (error.status === 401) toLogin();
      }
    };
    const link = open('/api/alarms/live', {
      message(said, asked) {
        failed = 0;
        clearInterval(asks);
        asks = 0;
        try {
          const { alarms, held_ms } = JSON.parse(said);
          if (alarms) live.take(alarms, asked, held_ms);
          else forget(); // the gateway is silent: nothing is known of its alarms
        } catch {
          forget();
        }
        timer = setTimeout(link.next, Math.max(0, PACE_MS - (performance.now() - asked.steadyMs)));
      },
      state(connected) {
        if (connected) return;
        failed += 1;
        if (failed === 1) forget();
        else if (!asks) {
          once();
          asks = setInterval(once, ASK_MS);
        }
      },
    });
    return () => {
      clearTimeout(timer);
      clearInterval(asks);
      link.close();
    };
  }, [on]);
  return live.fresh(live.last?.age_ms) ? live.last : live.last || lost ? null : undefined;
}

/** `given`: the summary of the alarms; undefined: it is pulled here; null: not known. */
export function AlarmBar({ session, given }) {
  const pulled = useSummary(given === undefined);
  const [sound, setSound] = useKept('alarms.sound', false);
  const summary = (given === undefined ? pulled : given) ?? null;
  const first = summary?.first ?? null;
  const all = summary?.shown ?? 0;
  const waiting = summary?.unacknowledged ?? 0;
  const known = useRef(null);
  if (summary !== null) known.current = summary;
  // An alarm that sounds goes on sounding when the connection is lost.
  const silent = useSound(sound, known.current?.first ?? null, known.current?.unacknowledged ?? 0);
  const unknown = summary === null && (pulled === null || known.current !== null);
  alarmsInTitle(unknown ? 0 : all); // nor does the tab keep a number that may be wrong by now
  if (unknown) return html`<p class="alarmbar old" role="status">${TEXTS.old}</p>`;
  if (first === null) return html`<p class="alarmbar none muted small">${summary === null ? NONE : quiet(summary)}</p>`; // nothing moves when an alarm appears
  const bay = first.bay ?? session.bays[0] ?? '';
  const waits = TO_ACKNOWLEDGE.includes(first.state);
  return html`<div class=${`alarmbar ${waits ? first.priority : ''}`} role="region" aria-label="the alarm to see first">
    <${Priority} level=${LEVELS[first.priority]} acknowledged=${!waits} />
    <p class="first"><b>${first.title}</b> <span class="tag" translate=${first.bay ? 'no' : undefined}>${first.bay ?? TEXTS.gateway}</span> <span class="small">${TEXTS[first.active ? 'active' : 'over'][Number(waits)]}</span></p>
    <a class="badge" href=${kiosk ? undefined : `/#${encodeURIComponent(bay)}`} title=${TEXTS.list} onClick=${(event) => {
      const list = document.getElementById('alarms');
      if (!list || list.dataset.bay === undefined || ![first.bay ?? '', ''].includes(list.dataset.bay)) return;
      event.preventDefault();
      list.scrollIntoView({ block: 'start' });
      list.focus();
    }}>${TEXTS.count(waiting, all)}</a>
    <label class="row small" title=${TEXTS.soundTitle}><input type="checkbox" checked=${sound} onChange=${(event) => setSound(event.target.checked)} /> ${silent ? TEXTS.silent : TEXTS.sound}</label>
  </div>`;
}
