// The decision and its reason, large; the instruction for the driver beside it.

import { html, useEffect, useRef, useState } from '../vendor/preact-htm.js';
import { CODES } from '../lib/guidance.js';
import { NONE, mm, signed, words } from '../lib/format.js';
import { decisionWords, movedWords, placeWords, scaleWords } from '../lib/views.js';
import { Arrow, Decision as Sign, Ne107 } from './signs.js';

const NOT_KNOWN = 'Nothing new from the gateway: treat the bay as STOP.';

function why(state) {
  if (state === null) return NOT_KNOWN;
  if (state.in_place && state.held) return `in place, held by the ranger alone: ${state.reason.text}`;
  if (state.in_place) return `in place: ${state.reason.text}`;
  if (state.stop) return state.reason.text;
  return state.may_move ? 'stop is off, and nothing withholds may_move' : 'stop is off, but something withholds may_move';
}

/** Tells a screen reader what changed, at most every 2 s. */
function Spoken({ text }) {
  const [announced, setAnnounced] = useState(text);
  const last = useRef(0);
  useEffect(() => {
    if (text === announced) return undefined;
    const timer = setTimeout(() => {
      last.current = performance.now();
      setAnnounced(text);
    }, Math.max(0, 2000 - (performance.now() - last.current)));
    return () => clearTimeout(timer);
  }, [text, announced]);
  return html`<p class="sr" role="status" aria-live="polite">${announced}</p>`;
}

/** Of what was learned from one visit to the next. */
function Scale({ scale }) {
  const learned = scaleWords(scale);
  if (learned === null) return html`<span>${scale === undefined ? NONE : 'not learned yet'}</span>`;
  return html`<span>${learned.value}</span><span class="small names"> ${learned.rest} </span>
    ${learned.jump && html`<span class="tag bad">${learned.jump}</span>`}`;
}

const Fact = ({ name, wide, children }) => html`<div class=${wide ? 'wide-fact' : ''}><dt>${name}</dt><dd class="value">${children}</dd></div>`;

export function Decision({ state, bay }) {
  const word = decisionWords(state);
  const fault = state !== null && state.ne107.name === 'FAILURE';
  const guidance = state?.guidance ?? null;
  const sideways = guidance && (guidance.name === 'LEFT' || guidance.name === 'RIGHT');
  return html`<section class="panel" aria-labelledby="decision-title">
    <header><h2 id="decision-title">Decision</h2><${Ne107} name=${state?.ne107.name ?? null} /></header>
    <div class=${`decision ${fault || state === null ? 'fault' : ''}`}>
      <${Sign} stop=${state?.stop ?? null} mayMove=${state?.may_move ?? null} fault=${fault} />
      <div>
        <p class=${word.length > 10 ? 'word long' : 'word'}>${word}</p>
        <p class="why">${why(state)}</p>
      </div>
    </div>
    <${Spoken} text=${`${bay}: ${word}. ${why(state)}`} />
    <dl class="facts-grid">
      <${Fact} name="Stop">${state === null ? NONE : state.stop ? 'on' : 'off'}<//>
      <${Fact} name="May move">${state === null ? NONE : state.may_move ? 'yes' : 'no'}<//>
      <${Fact} name="In place">${placeWords(state)}<//>
      <${Fact} name="Moved since">${movedWords(state)}<//>
      <${Fact} name="Visit">${state === null ? NONE : words(state.phase)}<//>
      <${Fact} name="D">${state === null ? NONE : state.d === null ? 'unknowable' : state.d ? '1' : '0'}<//>
      <${Fact} name="Latch">${state === null ? NONE : state.plc.stop_latched ? 'latched' : 'free'}<//>
      <${Fact} name="R × Z learned" wide=${true}><${Scale} scale=${state?.scale} /><//>
    </dl>
    <div class="guidance">
      <div class="told">
        ${guidance ? html`<${Arrow} name=${CODES[guidance.name]?.symbol ?? 'stop'} />` : html`<span class="arrow"></span>`}
        <div>
          <h2>Driver is told</h2>
          <p class="said">${guidance ? words(guidance.name).toUpperCase() : NONE}${guidance?.amount_mm != null ? html` <span class="value">${mm(guidance.amount_mm)}</span>` : ''}</p>
        </div>
      </div>
      <dl class="facts-grid">
        <${Fact} name="To go">${mm(guidance?.to_go_mm)}<//>
        <${Fact} name="Closing">${signed(guidance?.closing_mm_s, 0, 'mm/s')}<//>
        <${Fact} name="Off to the side">${signed(guidance?.offset_u_px, 0, 'px')}${guidance?.offset_mm != null ? ` · ${signed(guidance.offset_mm, 0, 'mm')}` : ''}<//>
        <${Fact} name="Off in height">${signed(guidance?.offset_v_px, 0, 'px')}<//>
      </dl>
      ${sideways && html`<p class="sr">keep ${words(guidance.name)}</p>`}
    </div>
  </section>`;
}
