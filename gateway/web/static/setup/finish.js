// The last step: the difference of the file, save, restart; and the bay once the gateway has started with it.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { below } from '../lib/address.js';
import { post, toLogin } from '../lib/api.js';
import { Diff } from '../lib/dialog.js';
import { decisionWords, rangeHealth, visionHealth } from '../lib/views.js';
import { words } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { Age } from '../operator/hooks.js';
import { useBayState } from './devices.js';
import { ofBays } from './draft.js';
import { restarted } from './restarting.js';

const SET_UP = 'bay-set-up'; // in this tab: the bay whose first start is still to be looked at
const PATIENCE_MS = 120_000; // until a restart counts as failed

const patient = (waitedMs) => {
  if (waitedMs > PATIENCE_MS) throw new Error('the gateway has not answered for two minutes: look at its log');
};

/** Work on request: what is under way, and what went wrong. */
function useWork() {
  const [state, setState] = useState({ busy: '', wrong: '' });
  const during = async (busy, work) => {
    setState({ busy, wrong: '' });
    try {
      await work();
      setState({ busy: '', wrong: '' });
    } catch (error) {
      if (error.status === 401) toLogin();
      setState({ busy: '', wrong: error.message });
    }
  };
  return [state, during];
}

/** `after`: what else is to be known where it went wrong. */
const Work = ({ state, after = '' }) => html`<div role="status">${state.busy && html`<p>${state.busy}</p>`}</div>
  ${state.wrong && html`<div class="notice bad" role="alert"><p>${state.wrong}</p>${after}</div>`}`;

/** Starts the gateway again, then shows `bay`; null: this page anew. `check`: the bay is to have a function check then. */
export function Restart({ session, settings, bay, check = false }) {
  const [state, during] = useWork();
  const [truck, setTruck] = useState('');
  const restart = (despite) => during('The gateway restarts: stop is shown on all bays …', async () => {
    let boot;
    setTruck('');
    try {
      ({ boot } = await post('/api/setup/restart', { confirmed: true, despite_trucks: despite }, session.csrf, { timeoutMs: 30_000 }));
    } catch (error) {
      if (error.status !== 409 || !/truck/.test(error.message)) throw error;
      setTruck(error.message);
      return;
    }
    await restarted(boot, patient);
    if (check) sessionStorage.setItem(SET_UP, bay);
    location.assign(below(bay === null ? '/setup/new-bay' : `/setup/new-bay?started=${encodeURIComponent(bay)}`));
  });
  return html`
    <p><b>What a restart does:</b> ${text('stop is shown on all bays of this gateway for about {0} s, and no truck may move meanwhile.', settings.restart_s)}
      ${(check || bay === null) && ' A bay that is set up then begins with a function check: may_move and in_place stay off until a technician has taught it in, tried it with a truck, and ended the function check.'}</p>
    ${truck && html`<div class="notice warn" role="alert"><p>${truck}</p><button type="button" onClick=${() => restart(true)}>Restart all the same</button></div>`}
    <p><button type="button" class="primary" disabled=${Boolean(state.busy)} onClick=${() => restart(false)}>Restart the gateway</button></p>
    <${Work} state=${state} />`;
}

export function FileStep({ session, settings, bay, isNew, changes, reload, saved, onSaved }) {
  const [plan, setPlan] = useState(null);
  const [unplanned, setUnplanned] = useState('');
  const [state, during] = useWork();
  const [checked, setChecked] = useState(false); // the function check was begun from here
  const check = ofBays(changes);
  const begins = check && !isNew && session.bays.includes(bay);
  const body = { digest: settings.digest, changes };
  const key = JSON.stringify(body);
  useEffect(() => {
    if (saved) return;
    setPlan(null);
    setUnplanned('');
    post('/api/setup/preview', body, session.csrf, { timeoutMs: 30_000 })
      .then(setPlan, (error) => {
        if (error.status === 409) reload(); // another hand has changed the file: its new text is asked for
        else setUnplanned(error.message);
      });
  }, [key]);
  const save = () => during('Saving …', async () => {
    if (begins) {
      await post(`/api/bays/${encodeURIComponent(bay)}/function-check`, { mode: 'may_move_off' }, session.csrf);
      setChecked(true);
    }
    onSaved(await post('/api/setup/save', body, session.csrf, { timeoutMs: 30_000 }));
  });
  const faults = plan?.faults ?? [];
  return html`<div class="step">
    ${!plan && !unplanned && html`<p role="status">Checking …</p>`}
    ${unplanned && html`<p class="notice bad" role="alert">${unplanned}</p>`}
    ${plan && !saved && html`
      <p>This would change in <span class="mono" translate="no">${settings.file}</span>:</p>
      ${faults.length > 0 && html`<div class="notice bad" role="alert">${faults.map((fault) => html`<p translate="no">${fault.path.join('.')}${fault.line ? ` ${text('(line {0})', fault.line)}` : ''}: ${fault.message}</p>`)}</div>`}
      ${plan.diff && html`<${Diff} text=${plan.diff} />`}
      ${!plan.diff && faults.length === 0 && html`<p>The file says just this already: there is nothing to save.</p>
        ${!isNew && html`<p><a class="button" href=${`/tune/${encodeURIComponent(bay)}#teach-in`}>${text('Teach in and tune {0}', bay)}</a></p>`}`}
      ${plan.warnings.length > 0 && html`<div class="notice warn">${plan.warnings.map((one) => html`<p translate="no">${one}</p>`)}</div>`}
      ${plan.why_not && html`<p class="notice bad">It can't be saved: ${plan.why_not}</p>`}
      ${begins && plan.diff && html`<p>${text('With the save the function check of {0} begins, unless it is on already: may_move and in_place stay off until a technician ends it.', bay)}</p>`}
      <p><button type="button" class="primary" disabled=${faults.length > 0 || Boolean(plan.why_not) || !plan.diff || Boolean(state.busy)} onClick=${save}>Save the file</button></p>
      <${Work} state=${state} after=${checked && html`<p>${text('The function check of {0} was begun before the save, and is on. Save again, or end it:', bay)}${' '}<a href=${`/tune/${encodeURIComponent(bay)}`}>technician's page</a></p>`} />`}
    ${saved && html`
      <p class="notice" role="status" data-saved><b>Saved.</b> The text before is kept in <span class="mono" translate="no">${saved.previous}</span>. ${isNew ? 'The bay is there after a restart.' : 'It takes effect with a restart.'}</p>
      <${Restart} session=${session} settings=${settings} bay=${bay} check=${check} />`}
  </div>`;
}

/** What the file says and only a restart puts into force, before anything else is set up. */
export const Waiting = ({ session, settings }) => html`<section class="panel step whole" aria-label="a restart is due">
  <p class="notice warn" role="status"><b>The file says more than what runs.</b> These wait for a restart:</p>
  <ul class="mono" translate="no">${settings.waiting.map((line) => html`<li translate="no">${line}</li>`)}</ul>
  <${Restart} session=${session} settings=${settings} bay=${null} />
</section>`;

/** The bay at work under its function check, which is begun here where the gateway could not keep it. */
export function Started({ session, bay }) {
  const live = useBayState(bay);
  const { state } = live;
  const [refused, setRefused] = useState('');
  const asking = useRef(false);
  useEffect(() => {
    if (state === null || asking.current || sessionStorage.getItem(SET_UP) !== bay) return; // not when the address is opened again some day
    asking.current = true;
    const begun = live.last.function_check === 'OFF' ? post(`/api/bays/${encodeURIComponent(bay)}/function-check`, { mode: 'may_move_off' }, session.csrf) : Promise.resolve();
    begun.then(() => { sessionStorage.removeItem(SET_UP); setRefused(''); }, (error) => setRefused(error.message)).finally(() => { asking.current = false; });
  });
  const wrong = live.wrong || refused;
  const works = [['camera: {0}', state?.vision, state && visionHealth(state)], ['ranger: {0}', state?.range, state && rangeHealth(state)]]
    .map(([name, sensor, health]) => ({ said: text(name, sensor ? t(words(sensor.quality.name)) : t('not known')), detail: sensor?.detail, fine: ['ok', 'warn'].includes(health) }));
  const missing = works.filter(({ fine }) => !fine);
  return html`<section class="panel step whole" aria-labelledby="step-title">
    <h1 id="step-title">${missing.length === 0 ? text('{0} is set up', bay) : text('{0} is not set up yet', bay)}</h1>
    ${wrong && html`<p class="notice bad" role="alert">${wrong}</p>`}
    ${missing.length > 0 && html`<div class="notice bad" role="alert"><p>Set up is a bay whose camera and ranger are seen working. Missing now:</p><ul>${missing.map(({ said, detail }) => html`<li translate="no">${listed([said, detail].filter(Boolean), '; ')}</li>`)}</ul></div>`}
    <p role="status" data-started>${listed([t(decisionWords(state)), ...works.map(({ said }) => said)])} · ${state === null ? 'function check: not known' : live.last.function_check !== 'OFF' ? html`<b>function check is on</b>` : 'function check is off'} <${Age} of=${live} partMs=${live.last?.age_ms} /></p>
    <p>Its thresholds are those of the paper, or of the other bays, until a truck has stood right: teach it in, try it with a truck, then end the function check.</p>
    <p class="row"><a class="button primary" href=${`/tune/${encodeURIComponent(bay)}#teach-in`}>${text('Teach in and tune {0}', bay)}</a>
      <a class="button" href=${`/setup/release?bay=${encodeURIComponent(bay)}`}>Release</a><a class="button" href=${`/#${encodeURIComponent(bay)}`}>Operator's page</a><a class="button" href="/setup/new-bay?new">Set up another bay</a></p>
  </section>`;
}
