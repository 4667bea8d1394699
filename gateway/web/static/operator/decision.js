// The decision and its reason, large; the instruction for the driver beside it.

import { html, useEffect, translated, useRef, useState } from '../lib/page.js';
import { CODES, wordOf } from '../lib/guidance.js';
import { kiosk } from '../lib/kiosk.js';
import { NONE, signed, words } from '../lib/format.js';
import { text } from '../lib/lang.js';
import { quantity } from '../lib/quantity.js';
import { distance, signedDistance, signedSpeed } from '../lib/units.js';
import { why } from '../lib/reasons.js';
import { decisionWords, movedWords, placeWords, scaleWords } from '../lib/views.js';
import { Arrow, Decision as Sign, Ne107 } from './signs.js';

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
  return html`<p class="sr" role="status" aria-live="polite" translate="no">${announced}</p>`;
}

/** Of what was learned from one visit to the next. */
function Scale({ scale }) {
  const learned = scaleWords(scale);
  if (learned === null) return html`<span>${scale === undefined ? NONE : 'not learned yet'}</span>`;
  return html`<span>${learned.value}</span><span class="small names"> ${learned.rest} </span>
    ${learned.jump && html`<span class="tag bad">${learned.jump}</span>`}`;
}

const Fact = ({ name, children }) => html`<div><dt>${name}</dt><dd class="value">${quantity(children)}</dd></div>`;

/** `age`: how old the state is, as an element; `alarm`: of this bay or the gateway one is active. */
export function Decision({ state, age, bay, alarm }) {
  const word = decisionWords(state);
  const fault = state !== null && state.ne107.name === 'FAILURE';
  const guidance = state?.guidance ?? null;
  const early = guidance?.name === 'STOP' && state.may_move; // guidance.stop_lead_s
  const sideways = guidance && (guidance.name === 'LEFT' || guidance.name === 'RIGHT');
  return html`<section class="panel" aria-labelledby="decision-title">
    <header><h2 id="decision-title">Decision</h2><${Ne107} name=${state?.ne107.name ?? null} alarm=${alarm} /></header>
    <div class=${`decision ${fault || state === null ? 'fault' : state.in_place ? 'placed' : ''}`}>
      <${Sign} stop=${state?.stop ?? null} mayMove=${state?.may_move ?? null} inPlace=${state?.in_place ?? false} fault=${fault} />
      <div>
        <div class="row spread"><p class=${word.length > 10 ? 'word long' : 'word'}>${word}</p>${age}</div>
        <p class="why">${why(state)}</p>
      </div>
    </div>
    <${Spoken} text=${`${bay}: ${translated(word)}. ${translated(why(state))}`} />
    <dl class="facts-grid">
      <${Fact} name="Stop">${state === null ? NONE : state.stop ? 'on' : 'off'}<//>
      <${Fact} name="May move">${state === null ? NONE : state.may_move ? 'yes' : 'no'}<//>
      <${Fact} name="In place">${placeWords(state)}<//>
      <${Fact} name="Moved since">${movedWords(state)}<//>
      <${Fact} name="Visit">${state === null ? NONE : words(state.phase)}<//>
      <${Fact} name="D">${state === null ? NONE : state.d === null ? 'unknowable' : state.d ? '1' : '0'}<//>
      <${Fact} name="Stop latched">${state === null ? NONE : state.plc.stop_latched ? 'yes, until reset' : 'no'}<//>
      <div class="learned"><dt>R × Z learned</dt><dd class="value"><${Scale} scale=${state?.scale} /></dd></div>
    </dl>
    <div class="guidance">
      <div class="instruction">
        ${guidance ? html`<${Arrow} name=${CODES[guidance.name]?.symbol ?? 'stop'} />` : html`<span class="arrow"></span>`}
        <div>
          <h2><a href=${kiosk ? undefined : `/driver/${encodeURIComponent(bay)}`}>Driver is told</a></h2>
          <p class="said">${guidance ? text(wordOf(guidance.name)) : NONE}${guidance?.amount_mm != null ? html` <span class="value">${quantity(distance(guidance.amount_mm))}</span>` : ''}</p>
          ${early && html`<p class="small names">early: a driver needs time to react</p>`}
        </div>
      </div>
      <dl class="facts-grid">
        <${Fact} name="To go">${distance(guidance?.to_go_mm)}<//>
        <${Fact} name="Closing">${signedSpeed(guidance?.closing_mm_s)}<//>
        <${Fact} name="Off to the side">${signed(guidance?.offset_u_px, 0, 'px')}${guidance?.offset_mm != null ? ` · ${signedDistance(guidance.offset_mm)}` : ''}<//>
        <${Fact} name="Off in height">${signed(guidance?.offset_v_px, 0, 'px')}<//>
      </dl>
      ${sideways && html`<p class="sr">${guidance.name === 'LEFT' ? 'keep left' : 'keep right'}</p>`}
    </div>
  </section>`;
}
