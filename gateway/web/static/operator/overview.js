// All bays at a glance: one tile a bay, those in trouble first.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { below } from '../lib/address.js';
import { either } from '../lib/api.js';
import { called } from '../lib/bays.js';
import { column } from '../lib/guidance.js';
import { words } from '../lib/format.js';
import { moment } from '../lib/freshness.js';
import { text } from '../lib/lang.js';
import { told } from '../lib/pictures.js';
import { why } from '../lib/reasons.js';
import { distance } from '../lib/units.js';
import { alarmCount, decisionWords, inOrder, urgency, visionHealth } from '../lib/views.js';
import { Age, useFresh, useKept } from './hooks.js';
import { Decision, Ne107 } from './signs.js';

/** A small picture, newer every few seconds; only while the tile is in sight. `everyMs`: between two. */
function Thumbnail({ name, everyMs, state }) {
  const canvas = useRef(null);
  const shown = useFresh(2 * everyMs + 3000);
  const [size, setSize] = useState(null);
  useEffect(() => {
    const end = new AbortController();
    let [timer, seen, after] = [0, false, '']; // of the picture that is shown: none comes twice
    const once = async () => {
      try {
        if (seen && !document.hidden) {
          const asked = moment();
          const answer = await fetch(below(`/api/bays/${encodeURIComponent(name)}/picture?${after}width=320`), { credentials: 'same-origin', cache: 'no-store', signal: either(end.signal, 10_000) });
          if (answer.status === 200) {
            after = `after=${Number(answer.headers.get('X-Frame-Id'))}&`;
            const bitmap = await createImageBitmap(await answer.blob());
            if (canvas.current) {
              Object.assign(canvas.current, { width: bitmap.width, height: bitmap.height });
              canvas.current.getContext('2d').drawImage(bitmap, 0, 0);
              setSize(bitmap.width / bitmap.height);
              shown.take({ age_ms: told(answer, 'Age') }, asked, told(answer, 'Held')); // an old frame is no live picture
            }
            bitmap.close();
          }
        }
      } catch {
        // The picture that stands there is greyed by its age.
      }
      if (!end.signal.aborted) timer = setTimeout(once, everyMs);
    };
    const sight = new IntersectionObserver((entries) => {
      seen = entries.at(-1).isIntersecting;
    });
    sight.observe(canvas.current);
    timer = setTimeout(once, Math.random() * everyMs);
    return () => {
      clearTimeout(timer);
      sight.disconnect();
      end.abort();
    };
  }, [name, everyMs]);
  const dead = state !== null && visionHealth(state) === 'bad'; // known before the picture has grown old
  const old = dead || state === null || !shown.fresh(shown.last?.age_ms);
  const why = !old ? '' : state === null ? 'nothing known' : dead ? words(state.vision.quality.name) : shown.last === null ? 'no picture yet' : 'no new picture';
  return html`<span class="thumbnail">
    <canvas ref=${canvas} class=${old ? 'old' : ''} role="img" aria-label=${old ? text('no live picture of {0}', name) : text('live picture of {0}', name)} width="320" height=${size ? Math.round(320 / size) : 240}></canvas>
    ${why && html`<span class="no-picture">${why}</span>`}</span>`;
}

const [LEFT, LONG] = [46, 116]; // of the way that is drawn, as part of 200

/** The bay from its side: the spout over the mark, and the truck's port as far from it as it is; no truck where that is not known. */
function Side({ toGoMm }) {
  const { line, at } = column(toGoMm);
  const x = (share) => (LEFT + LONG * share).toFixed(1);
  return html`<svg class="side" viewBox="0 0 200 50" aria-hidden="true">
    <g transform=${`translate(${x(line)} 0)`}><path d="M-8 0H8L4 9H-4Z" fill="var(--bar-strong)" /><path d="M0 9V47" stroke="var(--text)" stroke-width="1.5" stroke-dasharray="3 3" /></g>
    <path d="M0 48H200" stroke="var(--line-strong)" stroke-width="2" />
    ${at !== null && html`<g class="truck" transform=${`translate(${x(at)} 0)`} fill="var(--bar)"><path d="M-4 13H4V17H16Q20 17 20 21V37H-44V21Q-44 17 -40 17H-4ZM22 20H32L38 29V37H22Z" /><path d="M-42 41a5 5 0 1 0 10 0a5 5 0 1 0-10 0M-28 41a5 5 0 1 0 10 0a5 5 0 1 0-10 0M22 41a5 5 0 1 0 10 0a5 5 0 1 0-10 0" fill="var(--text)" /></g>`}
  </svg>`;
}

function Tile({ name, state, age, alarms, highest, everyMs }) {
  const trouble = state === null || state.ne107.name === 'FAILURE';
  return html`<li><a class=${`tile ${trouble ? 'trouble' : ''}`} href=${`#${encodeURIComponent(name)}`}>
    <span class="row spread"><b translate="no">${called(name)}</b><span class="row">${alarms > 0 && html`<span class=${`tag ${highest}`}>${alarmCount(alarms, 0)}</span>`}<${Ne107} name=${state?.ne107.name ?? null} label=${false} alarm=${alarms > 0} /></span></span>
    ${everyMs > 0 && html`<${Thumbnail} name=${name} everyMs=${everyMs} state=${state} />`}
    <span class="state"><${Decision} stop=${state?.stop ?? null} mayMove=${state?.may_move ?? null} inPlace=${state?.in_place ?? false} fault=${trouble} /><span><b>${decisionWords(state)}</b> ${age}</span></span>
    <${Side} toGoMm=${state?.guidance.to_go_mm ?? null} />
    <span class="small value to-go">${state?.guidance.to_go_mm == null ? '' : text('to go {0}', distance(state.guidance.to_go_mm))}</span>
    <span class="why">${why(state)}</span>
  </a></li>`;
}

const GROUPS = [['all', 'all'], ['trouble', 'in trouble'], ['stop', 'stop'], ['in_place', 'in place'], ['may_move', 'may move']];

const MOST = [6, 12]; // tiles in a row: of a dozen bays, of more

/** So many tiles in a row that the last row is as full as the others can be. */
function across(count) {
  const rows = Math.ceil(count / MOST[Number(count > 12)]);
  return Math.ceil(count / Math.max(1, rows));
}

/** `live`: as from `useLive`. */
export function Overview({ names, live, alarmsOf, highestOf }) {
  const [wanted, setWanted] = useState('');
  const [group, setGroup] = useState('all');
  const [pictures, setPictures] = useKept('overview.pictures', true);
  const all = inOrder(names.map((name) => {
    const state = live.stateOf(name);
    const alarms = alarmsOf(name);
    const age = html`<${Age} of=${live} partMs=${live.last?.bays.find(({ bay }) => bay === name)?.age_ms} />`;
    return { name, state, age, alarms, highest: highestOf(name), rank: urgency(state, alarms) };
  }));
  const fits = {
    all: () => true,
    trouble: ({ rank }) => rank < 5,
    stop: ({ state }) => state === null || state.stop,
    in_place: ({ state }) => state?.in_place,
    may_move: ({ state }) => state?.may_move,
  };
  const shown = all.filter((bay) => fits[group](bay) && called(bay.name).toLowerCase().includes(wanted.toLowerCase()));
  return html`<section class="panel overview" aria-labelledby="overview-title">
    <header>
      <h1 id="overview-title">All bays</h1>
      <div class="row compact">
        <div class="group" role="group" aria-label="which bays">
          ${GROUPS.map(([key, name]) => html`<button type="button" aria-pressed=${String(group === key)} onClick=${() => setGroup(key)}>${name} <span class="small">${all.filter(fits[key]).length}</span></button>`)}
        </div>
        <label class="row small"><input type="checkbox" checked=${pictures} onChange=${(event) => setPictures(event.target.checked)} /> pictures</label>
        <input type="search" placeholder="find a bay" aria-label="find a bay by name" value=${wanted} onInput=${(event) => setWanted(event.target.value)} />
      </div>
    </header>
    <ul class=${`tiles ${shown.length < 3 ? 'few' : ''}`} style=${{ '--across': across(shown.length) }}>${shown.map((bay) => html`<${Tile} key=${bay.name} ...${bay} everyMs=${pictures ? Math.max(2000, 150 * names.length) : 0} />`)}</ul>
    ${shown.length === 0 && html`<p class="muted">No bay fits.</p>`}
  </section>`;
}
