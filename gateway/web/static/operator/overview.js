// All bays at a glance: one tile a bay, those in trouble first.

import { html, useState } from '../vendor/preact-htm.js';
import { CODES } from '../lib/guidance.js';
import { NONE, mm, px, words } from '../lib/format.js';
import { decisionWords, inOrder, urgency } from '../lib/views.js';
import { Arrow, Decision, Ne107 } from './signs.js';

function why(state) {
  if (state === null) return 'nothing known';
  if (state.in_place) return state.held ? 'in place, held' : 'in place';
  return words(state.stop ? state.reason.name : state.guidance.name);
}

function Tile({ name, state, alarms }) {
  const trouble = state === null || state.ne107.name === 'FAILURE';
  return html`<li><a class=${`tile ${trouble ? 'trouble' : ''}`} href=${`#${encodeURIComponent(name)}`}>
    <span class="row spread"><b>${name}</b><${Ne107} name=${state?.ne107.name ?? null} label=${false} /></span>
    <span class="state"><${Decision} stop=${state?.stop ?? null} mayMove=${state?.may_move ?? null} fault=${trouble} /><b>${decisionWords(state)}</b></span>
    <span class="why">${state && html`<${Arrow} name=${CODES[state.guidance.name]?.symbol ?? 'stop'} />`}${why(state)}</span>
    <span class="small row spread">
      <span>R <span class="value">${state ? px(state.radius_px, 0) : NONE}</span></span>
      <span>Z <span class="value">${state ? mm(state.distance_mm) : NONE}</span></span>
    </span>
    ${alarms > 0 && html`<span class="tag bad">${alarms} ${alarms === 1 ? 'alarm' : 'alarms'}</span>`}
  </a></li>`;
}

const GROUPS = [['all', 'all'], ['trouble', 'in trouble'], ['stop', 'stop'], ['in_place', 'in place'], ['may_move', 'may move']];

export function Overview({ names, views, alarmsOf }) {
  const [text, setText] = useState('');
  const [group, setGroup] = useState('all');
  const all = inOrder(names.map((name) => {
    const state = views.get(name) ?? null;
    const alarms = alarmsOf(name);
    return { name, state, alarms, rank: urgency(state, alarms) };
  }));
  const fits = {
    all: () => true,
    trouble: ({ rank }) => rank < 5,
    stop: ({ state }) => state === null || state.stop,
    in_place: ({ state }) => state !== null && state.in_place,
    may_move: ({ state }) => state !== null && state.may_move,
  };
  const shown = all.filter((bay) => fits[group](bay) && bay.name.toLowerCase().includes(text.toLowerCase()));
  return html`<section class="panel overview" aria-labelledby="overview-title">
    <header>
      <h1 id="overview-title">All bays</h1>
      <div class="row compact">
        <div class="group" role="group" aria-label="which bays">
          ${GROUPS.map(([key, name]) => html`<button type="button" aria-pressed=${String(group === key)} onClick=${() => setGroup(key)}>${name} <span class="small">${all.filter(fits[key]).length}</span></button>`)}
        </div>
        <input type="search" placeholder="find a bay" aria-label="find a bay by name" value=${text} onInput=${(event) => setText(event.target.value)} />
      </div>
    </header>
    <ul class="tiles">${shown.map((bay) => html`<${Tile} key=${bay.name} ...${bay} />`)}</ul>
    ${shown.length === 0 && html`<p class="muted">No bay fits.</p>`}
  </section>`;
}
