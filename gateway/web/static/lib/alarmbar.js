// The alarm to see first, and how many there are: at the top of every page for desks, and in its tab's title. On request
// a sound, too. It only shows: what is done about an alarm is done in the operator's list.

import { kiosk } from './kiosk.js';
import { html, useEffect, useRef } from './page.js';
import { NONE } from './format.js';
import { useFetched, useKept } from '../operator/hooks.js';
import { Priority } from '../operator/signs.js';
import { tone } from './sound.js';
import { alarmsInTitle } from './title.js';
import { LEVELS, TO_ACKNOWLEDGE, alarmCount } from './views.js';

const TEXTS = {
  active: ['active, acknowledged', 'active, not acknowledged'],
  over: ['returned to normal, acknowledged', 'returned to normal, not acknowledged'],
  gateway: 'gateway',
  count: (waiting, all) => alarmCount(all, waiting),
  none: 'No alarm.',
  list: 'To the alarms',
  old: 'The alarms are not known: no connection to the gateway.',
  sound: 'sound',
  soundTitle: 'A sound for alarms that are not acknowledged, at this computer. Off until somebody switches it on.',
};
const EVERY_MS = 1000; // a truck that moves in place is an alarm, too
const AGAIN_MS = 15_000; // while one of high priority is not acknowledged
const TONE_HZ = { high: 880, medium: 660, low: 440 };

/** A short sound, as often as the priority is high. Browsers allow it after the visitor's first click in the page. */
function beep(audio, priority) {
  for (let n = 0; n < LEVELS[priority]; n += 1) tone(audio, TONE_HZ[priority], n * 0.3, 0.18, { loud: 0.2, fades: false });
}

function useSound(on, first, waiting) {
  const audio = useRef(null);
  const heard = useRef('');
  const waits = waiting > 0 && first !== null && TO_ACKNOWLEDGE.includes(first.state);
  const which = waits ? `${first.id} ${first.occurrences} ${waiting}` : '';
  useEffect(() => {
    if (!on || which === '') {
      heard.current = which;
      return undefined;
    }
    const sound = () => {
      audio.current ??= new AudioContext();
      beep(audio.current, first.priority);
    };
    if (which !== heard.current) sound();
    heard.current = which;
    const timer = first.priority === 'high' ? setInterval(sound, AGAIN_MS) : 0;
    return () => clearInterval(timer);
  }, [on, which]);
}

/** `given`: the summary of the alarms; undefined: it is fetched here; null: not known yet. */
export function AlarmBar({ session, given }) {
  const [fetched, wrong] = useFetched('/api/alarms', '', EVERY_MS, given === undefined);
  const [sound, setSound] = useKept('alarms.sound', false);
  const summary = (given === undefined ? fetched?.summary : given) ?? null;
  const first = summary?.first ?? null;
  const all = summary?.shown ?? 0;
  const waiting = summary?.unacknowledged ?? 0;
  useSound(sound, first, waiting);
  const unknown = wrong !== '' && given === undefined;
  alarmsInTitle(unknown ? 0 : all); // nor does the tab keep a number that may be wrong by now
  if (unknown) return html`<p class="alarmbar old" role="status">${TEXTS.old}</p>`;
  if (first === null) return html`<p class="alarmbar none muted small">${summary === null ? NONE : TEXTS.none}</p>`; // nothing moves when an alarm appears
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
    <label class="row small" title=${TEXTS.soundTitle}><input type="checkbox" checked=${sound} onChange=${(event) => setSound(event.target.checked)} /> ${TEXTS.sound}</label>
  </div>`;
}
