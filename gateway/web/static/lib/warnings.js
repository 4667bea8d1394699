// Settings with standing warnings go live, or into the file, only after a person has read and confirmed them.

import { get, post } from './api.js';
import { Dialog } from './dialog.js';
import { html, useRef, useState } from './page.js';

const POLL_MS = 300;

const HEADINGS = {
  apply: [(n) => `These settings go live with ${n} warnings:`, 'These settings go live with 1 warning:'],
  save: [(n) => `These settings are saved with ${n} warnings:`, 'These settings are saved with 1 warning:'],
};
const BUTTONS = { apply: 'Go live all the same', save: 'Save all the same' };

/**
 * Does `act`, with the warnings that were accepted; where the gateway refuses because of others, `ask` is shown them.
 * null: they were not accepted, and nothing was done. `wait`: until scores on test sets that run have ended; false: it is given up.
 * @param {(accepted: string[]) => Promise<any>} act @param {(warnings: any[]) => Promise<boolean>} ask
 * @param {((warnings: any[]) => Promise<any>)|null} wait
 */
export async function confirmed(act, ask, wait = null) {
  let accepted = [];
  const waited = new Set(); // once each: a score may end without a result
  for (;;) {
    try {
      return await act(accepted);
    } catch (error) {
      if (error.body?.error !== 'warnings') throw error;
      const { warnings } = error.body;
      const running = wait ? warnings.filter((one) => one.scoring && !waited.has(one.id)) : [];
      if (running.length) {
        for (const one of running) waited.add(one.id);
        if (!(await wait(running))) return null;
        continue;
      }
      if (!(await ask(warnings))) return null;
      accepted = [...new Set([...accepted, ...warnings.map((one) => one.id)])];
    }
  }
}

/** Waits for scores on test sets: `wait` is for `confirmed`, `shown` says how far they are. */
export function useScores(csrf) {
  const [now, setNow] = useState(null); // {path, view}
  const cancelled = useRef(false);
  const wait = async (warnings) => {
    cancelled.current = false;
    try {
      for (const one of warnings) {
        const path = `/api/bays/${encodeURIComponent(one.bay)}/test-sets/${encodeURIComponent(one.test_set)}/score`;
        for (let view = await get(path); view.running && !cancelled.current; view = await get(path)) {
          setNow({ path, view });
          await new Promise((done) => setTimeout(done, POLL_MS));
        }
      }
      return !cancelled.current;
    } finally {
      setNow(null);
    }
  };
  const cancel = () => {
    cancelled.current = true;
    post(`${now.path}/cancel`, {}, csrf).catch((error) => console.warn(`the score goes on: ${error.message}`));
  };
  const shown = now && html`<div class="row"><progress max=${now.view.total} value=${now.view.done} aria-label="pictures scored"></progress>
    <span class="small" role="status">${`Scoring: ${now.view.done} of ${now.view.total} pictures`}</span>
    <button type="button" onClick=${cancel}>Cancel scoring</button></div>`;
  return { wait, shown };
}

/** `what`: apply or save. `answer(true)`: with these warnings. */
export function WarningDialog({ what, warnings, answer }) {
  const [read, setRead] = useState(false);
  const [many, one] = HEADINGS[what];
  return html`<${Dialog} id="warnings-title" kind="warnings" title=${warnings.length === 1 ? one : many(warnings.length)} close=${() => answer(false)}>
    <ul>${warnings.map((each) => html`<li key=${each.id}><span aria-hidden="true">▲</span> ${each.test_set && html`<span>test set</span> <b translate="no">${each.test_set}</b>: `}<span>${each.text}</span>
      <span class="small muted mono" translate="no">${[each.key, ...each.pictures].filter(Boolean).join(', ')}</span></li>`)}</ul>
    <label class="choice"><input type="checkbox" checked=${read} onChange=${(event) => setRead(event.target.checked)} /> I have read these warnings, and want these settings with them</label>
    <div class="row">
      <button type="button" autofocus onClick=${() => answer(false)}>Cancel</button>
      <button type="button" class="primary" disabled=${!read} onClick=${() => answer(true)}>${BUTTONS[what]}</button>
    </div>
  </${Dialog}>`;
}
