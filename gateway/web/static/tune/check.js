// The function check: settings go live only while one is on, and what it does to `may_move` is chosen here.

import { html, translated, useState } from '../lib/page.js';
import { Dialog } from '../lib/dialog.js';
import { number, px, words } from '../lib/format.js';
import { t, text } from '../lib/lang.js';
import { why } from '../lib/reasons.js';
import { decisionWords } from '../lib/views.js';
import { Decision, Ne107 } from '../operator/signs.js';

/** What follows from the end of the check. `thresholds`: in force; `unsaved`: keys that are in force and not in the file. */
function EndDialog({ thresholds, unsaved, end, close }) {
  return html`<${Dialog} id="end-check-title" title="End the function check?" close=${close}>
    <p>Then the bay is at work, and the PLC acts on what it is told:</p>
    <ul>
      <li>${text('D = 1 at R of {0} and Z of {1}: these thresholds are in force, and count as tried.', px(thresholds?.radius_threshold_px), number(thresholds?.distance_threshold_mm, 0, 'mm'))}</li>
      <li>may_move is on again as soon as a truck may move.</li>
      <li>in_place stays off for a truck that stands there now: it must leave the mark, and come again.</li>
      ${unsaved.length > 0 && html`<li><b>${text('In force but not in the file: {0}.', unsaved.join(', '))}</b> The next start has other settings, and begins a function check.</li>`}
    </ul>
    <div class="row"><button type="button" class="primary" onClick=${end}>End function check</button>
      <button type="button" onClick=${close}>Cancel</button></div>
  </${Dialog}>`;
}

/**
 * `age`: how old the state is, as an element; `mode`: OFF, MAY_MOVE_OFF, MAY_MOVE_KEPT; null: not known. `file`: of the
 * profile; `untried`: keys that are not as they were last tried; `refresh`: both anew; `restart`: the gateway.
 */
export function CheckBanner({ mode, state, age, change, busy, thresholds, file, untried, refresh, restart }) {
  const [kept, setKept] = useState(false);
  const [ending, setEnding] = useState(false);
  const on = mode === 'MAY_MOVE_OFF' || mode === 'MAY_MOVE_KEPT';
  const decision = `${translated(decisionWords(state))}: ${translated(why(state))}`;
  const live = html`<span class="bay-now"><${Decision} stop=${state?.stop ?? null} mayMove=${state?.may_move ?? null} inPlace=${state?.in_place ?? false} fault=${state?.ne107.name === 'FAILURE'} /><span translate="no">${decision}</span> ${age}</span>`;
  if (!on)
    return html`<section class="check notice" aria-labelledby="check-title">
      <div class="row spread"><h2 id="check-title">${mode === null ? 'Function check: not known' : 'The bay is at work'}</h2>${live}</div>
      <p>Settings are tried here without touching it. To let them go live, begin a function check.</p>
      <div class="row">
        <fieldset class="row"><legend class="sr">the may_move output during the function check</legend>
          <label class="choice"><input type="radio" name="may_move" value="may_move_off" checked=${!kept} onChange=${() => setKept(false)} /> may_move off</label>
          <label class="choice"><input type="radio" name="may_move" value="may_move_kept" checked=${kept} onChange=${() => setKept(true)} /> may_move kept: trucks go on with settings being tried</label>
        </fieldset>
        <button type="button" disabled=${busy || mode === null} onClick=${() => change(kept ? 'may_move_kept' : 'may_move_off')}>Begin function check</button>
      </div>
    </section>`;
  return html`<section class="check notice warn" aria-labelledby="check-title">
    <div class="row spread"><h2 id="check-title"><${Ne107} name="FUNCTION_CHECK" label=${false} /> <span>${mode === 'MAY_MOVE_OFF' ? 'FUNCTION CHECK – may_move is OFF' : 'FUNCTION CHECK – may_move is KEPT'}</span></h2>${live}</div>
    <p>${mode === 'MAY_MOVE_OFF'
      ? 'may_move and in_place stay off until the function check ends. Stop works as always.'
      : 'may_move follows settings that are being tried; in_place stays off. Stop works as always.'}
      ${state && state.ne107.name !== 'FUNCTION_CHECK' ? ` ${text('NE 107 says {0}: that goes first.', t(words(state.ne107.name)))}` : ''}</p>
    ${untried.length > 0 && html`<p>${text('Not as last tried: {0}. Try them with a truck before the check ends.', untried.join(', '))}</p>`}
    ${file.waiting.length > 0 && html`<div class="notice warn" role="alert"><p><b>${text('Saved, and not in force yet: {0}.', file.waiting.join(', '))}</b> The function check can end when the gateway has restarted with them.</p>
      <button type="button" class="primary" disabled=${busy} onClick=${restart}>Restart the gateway</button></div>`}
    ${ending && html`<${EndDialog} thresholds=${thresholds} unsaved=${file.unsaved} close=${() => setEnding(false)} end=${() => { setEnding(false); change('off'); }} />`}
    <div class="row">
      <button type="button" class=${file.waiting.length > 0 ? '' : 'primary'} disabled=${busy} onClick=${async () => { if (await refresh()) setEnding(true); }}>End function check…</button>
      <button type="button" disabled=${busy} onClick=${() => change(mode === 'MAY_MOVE_OFF' ? 'may_move_kept' : 'may_move_off')}>
        ${mode === 'MAY_MOVE_OFF' ? 'Keep may_move instead' : 'Take may_move away instead'}</button>
    </div>
  </section>`;
}
