// The way out and in: going live, the file with its difference, profiles.

import { html, useRef, useState } from '../lib/page.js';
import { Dialog, Diff } from '../lib/dialog.js';

/** Shows what saving would change, and saves. */
export function SaveDialog({ plan, live, save, close }) {
  const [state, setState] = useState({ busy: false, said: '', done: null });
  const go = async () => {
    setState({ busy: true, said: '', done: null });
    try {
      setState({ busy: false, said: '', done: await save(plan) });
    } catch (error) {
      setState({ busy: false, said: error.message, done: null });
    }
  };
  const nothing = plan.changes.length === 0;
  return html`<${Dialog} id="save-title" title="Save to the configuration's file" close=${close}>
    <p class="mono" translate="no">${plan.path}</p>
    ${nothing
      ? html`<p>The file says just this already: there is nothing to save.</p>`
      : html`<${Diff} text=${plan.diff} />`}
    ${plan.faults?.map((fault) => html`<p class="notice bad" translate="no">${[fault.path.join('.'), fault.message].filter(Boolean).join(': ')}</p>`)}
    ${plan.warnings?.map((warning) => html`<p class="notice warn" translate="no">${warning}</p>`)}
    ${plan.restart?.length > 0 && html`<p>A restart of the gateway is needed for:</p><ul class="keys">${plan.restart.map((key) => html`<li translate="no">${key}</li>`)}</ul>`}
    ${!live && !nothing && html`<p class="notice warn">These settings are not live: the file would say something else than what runs now.</p>`}
    ${plan.why_not && html`<p class="notice bad">It can't be saved: ${plan.why_not}</p>`}
    <div aria-live="assertive">
      ${state.said && html`<p class="notice bad">${state.said}</p>`}
      ${state.done && html`<p class="notice" data-saved>Saved. The text before is kept in <span class="mono" translate="no">${state.done.previous}</span>.
        ${state.done.restart?.length > 0 && html` The values take effect at the next start: <a href="/setup">restart the gateway</a>.`}</p>`}
    </div>
    <p class="hint">The file is read when the gateway starts or reloads. Comments and everything else in it stay as they are.</p>
    <div class="row">
      ${!state.done && html`<button type="button" class="primary" disabled=${nothing || Boolean(plan.why_not) || plan.faults?.length > 0 || state.busy} onClick=${go}>Save</button>`}
      <button type="button" onClick=${close}>${state.done ? 'Close' : 'Cancel'}</button>
    </div>
  </${Dialog}>`;
}

/** A button that takes a profile's file. */
export function ImportButton({ take }) {
  const field = useRef(null);
  const chosen = async (event) => {
    const [file] = event.target.files;
    event.target.value = '';
    if (file) take(file.name, file.size > 65_536 ? null : await file.text());
  };
  return html`<button type="button" onClick=${() => field.current.click()}>Import…</button>
    <input ref=${field} type="file" class="sr" tabindex="-1" aria-label="a profile to import" accept=".toml,text/plain,application/toml" onChange=${chosen} />`;
}
