// The function check: settings go live only while one is on, and what it does to the permit is chosen here.

import { html, useState } from '../vendor/preact-htm.js';
import { words } from '../lib/format.js';
import { Decision, Ne107 } from '../operator/signs.js';

/** `mode`: OFF, PERMIT_OFF, PERMIT_KEPT; null: not known. */
export function CheckBanner({ mode, state, change, busy }) {
  const [kept, setKept] = useState(false);
  const on = mode === 'PERMIT_OFF' || mode === 'PERMIT_KEPT';
  const decision = state === null ? 'not known' : state.stop ? `STOP: ${state.reason.text}` : state.permit ? 'permit given' : 'stop is off, permit withheld';
  const live = html`<span class="bay-now"><${Decision} stop=${state?.stop ?? null} permit=${state?.permit ?? null} fault=${state?.ne107.name === 'FAILURE'} /><span>${decision}</span></span>`;
  if (!on)
    return html`<section class="check notice" aria-labelledby="check-title">
      <div class="row spread"><h2 id="check-title">${mode === null ? 'Function check: not known' : 'The bay is at work'}</h2>${live}</div>
      <p>Settings are tried here without touching it. To let them go live, begin a function check.</p>
      <div class="row">
        <fieldset class="row"><legend class="sr">the permit during the function check</legend>
          <label class="choice"><input type="radio" name="permit" value="permit_off" checked=${!kept} onChange=${() => setKept(false)} /> permit off</label>
          <label class="choice"><input type="radio" name="permit" value="permit_kept" checked=${kept} onChange=${() => setKept(true)} /> permit kept: loading goes on with settings being tried</label>
        </fieldset>
        <button type="button" disabled=${busy || mode === null} onClick=${() => change(kept ? 'permit_kept' : 'permit_off')}>Begin function check</button>
      </div>
    </section>`;
  return html`<section class="check notice warn" aria-labelledby="check-title">
    <div class="row spread"><h2 id="check-title"><${Ne107} name="FUNCTION_CHECK" label=${false} /> FUNCTION CHECK – permit ${mode === 'PERMIT_OFF' ? 'is OFF' : 'is KEPT'}</h2>${live}</div>
    <p>${mode === 'PERMIT_OFF'
      ? 'The PLC gets no permit until the function check ends. Stop works as always.'
      : 'The PLC gets its permit from settings that are being tried. Stop works as always.'}
      ${state && state.ne107.name !== 'FUNCTION_CHECK' ? html` NE 107 says ${words(state.ne107.name)}: that goes first.` : ''}</p>
    <div class="row">
      <button type="button" class="primary" disabled=${busy} onClick=${() => change('off')}>End function check</button>
      <button type="button" disabled=${busy} onClick=${() => change(mode === 'PERMIT_OFF' ? 'permit_kept' : 'permit_off')}>
        ${mode === 'PERMIT_OFF' ? 'Keep the permit instead' : 'Take the permit away instead'}</button>
    </div>
  </section>`;
}
