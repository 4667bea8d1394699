// The dialogs of the settings page: what a save would change, and the restart.

import { html, useEffect, useState } from '../lib/page.js';
import { post } from '../lib/api.js';
import { text } from '../lib/lang.js';
import { Dialog, Diff } from '../lib/dialog.js';
import { WarningDialog, confirmed, useScores } from '../lib/warnings.js';
import { restarted } from './restarting.js';

const MOST_MS = 120_000;
const SAVE_MS = 60_000; // settings of vision are tried on each bay's newest frame first

const List = ({ title, items }) => items.length > 0 && html`<div><h3>${title}</h3><ul class="bare">${items.map((one) => html`<li class="mono" translate="no">${one}</li>`)}</ul></div>`;

/** What `body` would change; `done(saved)` after the save. */
export function Review({ body, session, close, done }) {
  const [plan, setPlan] = useState(null);
  const [wrong, setWrong] = useState('');
  const [busy, setBusy] = useState(false);
  const [question, setQuestion] = useState(null);
  const scores = useScores(session.csrf);
  useEffect(() => {
    post('/api/setup/preview', body, session.csrf).then(setPlan, (error) => setWrong(error.message));
  }, []);
  const save = async () => {
    setBusy(true);
    setWrong('');
    try {
      const saved = await confirmed((accepted) => post('/api/setup/save', { ...body, accepted }, session.csrf, { timeoutMs: SAVE_MS }), ask, scores.wait);
      if (saved === null) setBusy(false);
      else done(saved);
    } catch (error) {
      setWrong(error.message);
      setBusy(false);
    }
  };
  const ask = async (warnings) => {
    const accepted = await new Promise((answer) => setQuestion({ what: 'save', warnings, answer }));
    setQuestion(null);
    return accepted;
  };
  const nothing = plan !== null && plan.diff === '' && plan.faults.length + plan.live.length + plan.restart.length === 0; // a new password shows no difference
  return html`<${Dialog} id="dialog-title" title=${body.undo ? 'Undo the last save' : 'Save to the configuration\u2019s file'} close=${close}>
    ${plan === null && !wrong && html`<p role="status">The gateway checks the changes …</p>`}
    ${plan !== null && html`
      ${plan.faults.length > 0 && html`<div class="notice bad"><p><b>This can't be saved:</b></p><ul class="bare">${plan.faults.map((fault) => html`<li><span class="mono" translate="no">${fault.path.join('.')}</span>${fault.line ? html` <span class="small">${text('(line {0})', fault.line)}</span>` : ''}: <span translate="no">${fault.message}</span></li>`)}</ul></div>`}
      ${plan.why_not && html`<p class="notice bad">It can't be saved: ${plan.why_not}</p>`}
      ${plan.warnings.length > 0 && html`<div class="notice warn"><p><b>Allowed, and no good idea:</b></p><ul class="bare">${plan.warnings.map((one) => html`<li translate="no">${one}</li>`)}</ul></div>`}
      ${nothing ? html`<p>The file says just this already.</p>` : plan.diff && html`<${Diff} text=${plan.diff} />`}
      <${List} title="Takes effect at the save" items=${plan.live} />
      <${List} title="Takes effect at the next start" items=${plan.restart} />`}
    <div aria-live="assertive">${wrong && html`<p class="notice bad">${wrong}</p>`}</div>
    ${scores.shown}
    <div class="row"><button type="button" class="primary" disabled=${plan === null || busy || nothing || plan.faults.length > 0 || Boolean(plan.why_not)} onClick=${save}>Save</button>
      <button type="button" onClick=${close}>Cancel</button></div>
    ${question && html`<${WarningDialog} ...${question} />`}
  </${Dialog}>`;
}

/** Ends the gateway, and waits until it has started again. */
export function Restart({ session, seconds, close }) {
  const [wrong, setWrong] = useState('');
  const [truck, setTruck] = useState('');
  const [despite, setDespite] = useState(false);
  const [begun, setBegun] = useState(false);
  const [waited, setWaited] = useState(0);
  const go = async () => {
    setWrong('');
    try {
      const { boot } = await post('/api/setup/restart', { confirmed: true, despite_trucks: despite }, session.csrf);
      setBegun(true);
      await restarted(boot, setWaited);
      location.reload();
    } catch (error) {
      if (error.status === 409 && error.message.startsWith('a truck')) setTruck(error.message);
      setWrong(error.message);
    }
  };
  if (begun)
    return html`<${Dialog} id="dialog-title" title="The gateway starts again" close=${() => {}}>
      <p role="status" data-restarting>Stop is shown on all bays. This page waits, and comes back by itself … <span>${`${Math.round(waited / 1000)} s`}</span></p>
      ${waited > MOST_MS && html`<p class="notice bad">It has not come back for two minutes. Look at its log: with systemd, journalctl -u loading-gateway.</p>`}
    </${Dialog}>`;
  return html`<${Dialog} id="dialog-title" title="Restart the gateway" close=${close}>
    <p><b>${text('Stop is shown on all bays for about {0} seconds.', seconds)}</b> On the PLC's registers, on MQTT and on the drivers' displays. Then the gateway works with the file as it is saved now. You stay logged in, others log in again.</p>
    <div aria-live="assertive">${wrong && html`<p class="notice bad">${wrong}</p>`}</div>
    ${truck && html`<label class="row"><input type="checkbox" checked=${despite} onChange=${(event) => setDespite(event.target.checked)} /> Restart although a truck is at a bay</label>`}
    <div class="row"><button type="button" class="primary" disabled=${Boolean(truck) && !despite} onClick=${go}>Restart now</button>
      <button type="button" onClick=${close}>Cancel</button></div>
  </${Dialog}>`;
}
