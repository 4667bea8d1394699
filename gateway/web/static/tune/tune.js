// The technician's page: settings tried on pictures, let live, and written back to the configuration's file.

import { html, render, useEffect, useMemo, useReducer, useRef, useState } from '../lib/page.js';
import { below, ownBay } from '../lib/address.js';
import { get, post, toLogin } from '../lib/api.js';
import { widthFor } from '../lib/pictures.js';
import { t, text } from '../lib/lang.js';
import { renewed } from '../lib/start.js';
import { titled } from '../lib/title.js';
import { Top } from '../lib/top.js';
import { Age, useLive } from '../operator/hooks.js';
import { Health as Sign } from '../operator/signs.js';
import { Camera } from './camera.js';
import { CheckBanner } from './check.js';
import { Effect, Remarks, summary } from './effect.js';
import { Eyedropper } from './eyedropper.js';
import { download } from '../lib/download.js';
import { ImportButton, SaveDialog } from './file.js';
import { Form } from './form.js';
import { differing } from './settings.js';
import { SourceBar, base64, tooMuch } from './source.js';
import { Stages } from './stages.js';
import { begun, changed, edited, profiled, said, tried } from './state.js';
import { TeachIn } from './teachin.js';
import { CancelledError, TestSets, useTestSets } from './testsets.js';
import { trials } from './trials.js';
import { Restart } from '../setup/review.js';
import { WarningDialog, confirmed } from '../lib/warnings.js';

const LIVE_PAUSE_MS = 350; // between two trials on the running picture
const TRIAL_MS = 60_000;
const RELOAD_LOOKS = 5; // for what a save puts into force without a restart
const RELOAD_LOOK_MS = 600;
const TAB = `t${Math.random().toString(36).slice(2, 12)}`;

const bay = ownBay();
const at = (path) => `/api/bays/${encodeURIComponent(bay)}/${path}`;

/** POSTs with the session's token, to a path of the bay or of the server; a stale token is fetched anew, once. */
function useSend(session, renew) {
  const csrf = useRef(session.csrf);
  return async (path, body, timeoutMs = 15_000, method = 'POST') => {
    for (let tries = 0; ; tries += 1) {
      try {
        return await post(path.startsWith('/') ? path : at(path), body, csrf.current, { timeoutMs, method });
      } catch (error) {
        if (error.status === 401) toLogin();
        if (error.status !== 403 || tries > 0) throw error;
        csrf.current = (await renew()).csrf;
      }
    }
  };
}

/** Decoded, so that it stands on the page in the moment in which it is put there. */
async function decoded(url) {
  const image = new Image();
  image.src = below(url);
  await image.decode();
  return image;
}

async function bitmapOf(url) {
  const answer = await fetch(below(url), { credentials: 'same-origin' });
  if (!answer.ok) throw new Error(`answer ${answer.status}`);
  return createImageBitmap(await answer.blob());
}

/**
 * A trial's result with all of its pictures, once every one of them is there: all that is on the page is of one frame.
 * `pictureOf`: where that frame itself is to be had. @returns {{result: any, bitmap: ImageBitmap|null, images: any[]}}
 */
function useShown(result, pictureOf) {
  const [shown, setShown] = useState({ result: null, bitmap: null, images: [] });
  useEffect(() => {
    if (!result) return;
    const stages = result.panels.filter((panel) => panel.name !== 'picture');
    const picture = bitmapOf(pictureOf(result));
    Promise.all([picture, ...stages.map((panel) => decoded(panel.url))]).then(
      ([bitmap, ...images]) => setShown((was) => {
        if (!was.result || was.result.number <= result.number) return { result, bitmap, images };
        bitmap.close();
        return was;
      }),
      (error) => { // of a trial that is gone by now: a newer one follows
        console.warn(`no picture: ${error.message}`);
        picture.then((bitmap) => bitmap.close(), () => {});
      },
    );
  }, [result]);
  useEffect(() => () => shown.bitmap?.close(), [shown.bitmap]); // when the next one stands there: it holds megabytes
  return shown;
}

function Page({ session, profile: first, taken: kept, renew }) {
  const send = useSend(session, renew);
  const { schema } = first;
  const [state, set] = useReducer(changed, null, () => begun(first, kept));
  const { inForce, settings, file, undoSteps, untried, restarting, undone, mode, taken, source, result, trouble, waiting, busy, picked, led, plan, question } = state;
  const known = useRef(first.vision); // what was told to be in force last, drawn or not
  const testSets = useTestSets(send, at);
  const tiles = useRef(null);
  const working = useRef(false);
  const live = useLive([bay], 500);
  const one = live.last?.bays.find((each) => each.bay === bay) ?? null;
  const fresh = live.fresh(one?.age_ms);
  const mine = fresh ? one : null;

  useEffect(() => { if (mine) set({ mode: mine.function_check }); }, [mine?.function_check]);

  // Trials.
  const trialQueue = useMemo(() => trials(
    ({ source: on, settings: vision, timed }) => {
      const tile = tiles.current?.querySelector('.stage')?.clientWidth || 420;
      const which = on.kind === 'live' ? { live: true } : { [on.kind]: on.name, frame: on.frame ?? 0 };
      return send('trial', { ...which, vision, timed, tab: TAB, width_px: widthFor(tile, devicePixelRatio || 1) }, TRIAL_MS);
    },
    {
      done(next, request) {
        set(tried(next, request));
        if (next !== null && differing(schema, next.settings_in_force, known.current).length) notice().catch((error) => set({ trouble: error.message }));
      },
      failed(error) {
        set({ trouble: error.message });
      },
      busy: (waiting) => set({ waiting }),
    },
  ), []);
  useEffect(() => () => trialQueue.close(), [trialQueue]);
  useEffect(() => trialQueue.want({ source, settings, inForce }), [trialQueue, source, settings, inForce]);
  useEffect(() => {
    if (source.kind !== 'live') return undefined;
    const timer = setTimeout(() => !document.hidden && trialQueue.want({ source, settings, inForce }, { timed: false }), LIVE_PAUSE_MS);
    return () => clearTimeout(timer);
  }, [trialQueue, source, settings, inForce, result, waiting, trouble, live.last]);

  const change = (name, value) => set(edited(typeof name === 'string' ? { [name]: value } : name));
  const tell = (what, bad = false) => set(said(what, bad));
  const doing = async (what, work) => {
    if (working.current) return null; // the button itself stays enabled: it keeps the focus
    working.current = true;
    set({ busy: what });
    try {
      return await work();
    } catch (error) {
      tell(error.message, true);
      return null;
    } finally {
      working.current = false;
      set({ busy: '' });
    }
  };
  const keep = async () => set({ taken: await get(at('captures')) });
  /** The frame that is on the page. */
  const freeze = () => doing('freeze', async () => {
    const one = await send('freeze', shown?.request.source.kind === 'live' ? { trial: shown.number } : {});
    await keep();
    const on = { kind: 'snapshot', name: one.name, frame: 0 };
    set({ source: on });
    return on;
  });
  const record = () => doing('record', async () => {
    const one = await send('record', { seconds: 3 }, 20_000);
    await keep();
    set({ source: { kind: 'recording', name: one.name, frame: Math.floor(one.frames / 2) } });
    tell(`${one.frames} frames recorded`);
  });
  const upload = (files) => doing('upload', async () => {
    const wrong = tooMuch(files);
    if (wrong) throw new Error(wrong);
    try {
      for (const file of files) {
        const one = await send('upload', { name: file.name.slice(0, 100), data: await base64(file) }, 30_000);
        set({ source: { kind: 'snapshot', name: one.name, frame: 0 } });
      }
    } finally {
      await keep();
    }
    tell(files.length === 1 ? '1 picture uploaded' : `${files.length} pictures uploaded`);
  });
  const pick = async (place, size, way) => {
    if (way === 'led') return set({ led: { u_px: place.u, v_px: place.v, radius_px: Math.max(1, size / 2) } });
    const seen = shown?.request.source ?? source;
    const on = seen.kind === 'live' ? await freeze() : seen;
    if (!on) return;
    try {
      const answer = await send('eyedropper', { [on.kind]: on.name, frame: on.frame ?? 0, u_px: place.u, v_px: place.v, size_px: size, mode: way, vision: settings, tab: TAB });
      if (answer === null) return; // another click came after it
      set({ picked: { answer, failed: '' } });
      change(answer.keys);
    } catch (error) {
      set({ picked: { answer: null, failed: error.message } });
      trialQueue.want({ source, settings, inForce });
    }
  };

  // Settings.
  const applyProfile = (answer) => {
    known.current = answer.vision;
    set(profiled(answer));
  };
  const refresh = async () => {
    const answer = await get(at('profile'));
    applyProfile(answer);
    return answer;
  };
  /** Something else is in force than this tab knew: somebody changed it elsewhere. */
  const notice = async () => {
    const was = known.current;
    await refresh();
    const keys = differing(schema, known.current, was);
    if (keys.length) tell(text('Changed in another tab or by somebody else, and live: {0}.', keys.join(', ')), true);
  };
  /** What is saved and in force is asked anew before a function check may end: what is live comes into force a moment after its save. */
  const mayEnd = () => doing('look', async () => {
    for (let tries = 1; (await refresh()).file.waiting.length > 0; tries += 1) {
      if (tries === RELOAD_LOOKS) return false;
      await new Promise((go) => setTimeout(go, RELOAD_LOOK_MS));
    }
    return true;
  });
  const askRestart = () => doing('restart', async () => set({ restarting: await get('/api/setup/settings') }));
  const check = (next) => doing('check', async () => {
    try {
      applyProfile(await send('function-check', { mode: next }));
    } catch (error) {
      await refresh();
      throw error;
    }
    tell(next === 'off' ? 'The function check has ended.' : next === 'may_move_off' ? 'Function check: may_move is off.' : 'Function check: may_move is kept.');
  });
  const ask = (what) => async (warnings) => {
    const accepted = await new Promise((answer) => set({ question: { what, warnings, answer } }));
    set({ question: null });
    return accepted;
  };
  /** What is to go live or into the file is scored first, in sight, and may be cancelled; the gateway would score only for some seconds. */
  const scored = async () => {
    try {
      await testSets.scoreAll(settings);
      return true;
    } catch (error) {
      if (error instanceof CancelledError) return false;
      throw error;
    }
  };
  const apply = () => doing('apply', async () => {
    let outcome = 'Nothing was changed.';
    try {
      if (!(await scored())) outcome = 'Scoring was cancelled: nothing was changed.';
      else {
        const answer = await confirmed((accepted) => send('profile/apply', { vision: settings, over: inForce, accepted }, TRIAL_MS), ask('apply'));
        if (answer !== null) {
          applyProfile(answer);
          outcome = 'These settings are live.';
        }
      }
    } finally {
      await refresh();
    }
    tell(outcome); // not sooner: until here a click does nothing
  });
  /** In a bay at work nothing changes: the click begins a function check first, and a person ends it. */
  const undo = () => doing('undo', async () => {
    try {
      if (!on) applyProfile(await send('function-check', { mode: 'may_move_off' }));
      const answer = await send('profile/undo', { over: inForce });
      applyProfile(answer);
      set({ settings: answer.vision });
    } finally {
      await refresh();
    }
    tell(on ? 'What was in force before is live again.' : 'What was in force before is live again. The function check goes on until you end it.');
  });
  const diff = () => doing('diff', async () => {
    const change = await send('profile/diff', { vision: settings });
    if (change.changes.length && !change.why_not && !(await scored())) return tell('Scoring was cancelled: nothing was changed.');
    set({ plan: change });
  });
  const save = async (shown) => {
    const done = await confirmed((accepted) => send('profile/save', { vision: settings, digest: shown.digest, accepted }, TRIAL_MS), ask('save'));
    if (done === null) throw new Error('Nothing was saved.');
    await refresh();
    return done;
  };
  const exported = () => doing('export', async () => {
    const answer = await fetch(below(at('profile/export')), { method: 'POST', credentials: 'same-origin', headers: { 'Content-Type': 'application/json', 'X-CSRF-Token': (await renew()).csrf }, body: JSON.stringify({ vision: settings }) });
    const toml = await answer.text();
    if (!answer.ok) throw new Error(JSON.parse(toml).detail ?? 'refused');
    download(`vision-${bay}.toml`, toml);
  });
  const imported = (name, toml) => doing('import', async () => {
    if (toml === null) throw new Error(text('{0}: too large for a profile', name));
    const answer = await send('profile/import', { name, text: toml });
    set({ settings: answer.vision });
    const { length: count } = answer.changes;
    tell(count === 0 ? text('{0} says just what is in force.', name) : text(count === 1 ? '{0}: one key differs from what is in force: {2}.' : '{0}: {1} keys differ from what is in force: {2}.', name, count, answer.changes.join(', ')));
  });

  // Whoever leaves in the middle is asked.
  const unlive = differing(schema, settings, inForce);
  const on = mode !== 'OFF' && mode !== null;
  useEffect(() => {
    if (!on || restarting) return undefined;
    const leaving = (event) => event.preventDefault();
    addEventListener('beforeunload', leaving);
    return () => removeEventListener('beforeunload', leaving);
  }, [on, restarting]);

  const wide = widthFor(tiles.current?.querySelector('.picture')?.clientWidth || 640, devicePixelRatio || 1);
  const pictureOf = (one) => {
    const { source: on } = one.request;
    return on.kind === 'live' ? one.panels.find((panel) => panel.name === 'picture').url : `${at(`captures/${on.name}/${on.frame ?? 0}`)}?width=${Math.max(960, wide)}`;
  };
  const { result: shown, bitmap: picture } = useShown(result, pictureOf);
  const panels = shown?.panels.filter((panel) => panel.name !== 'picture') ?? [];
  const frameId = shown?.frame_id ?? null; // of all that is on the page
  const remarks = result?.remarks ?? [];
  const elsewhere = shown !== null && !sameSource(shown.request.source, source) && !frozenFrom(shown, source, taken);
  const behind = shown !== null && ((source.kind === 'live' && !fresh) || shown.request.settings !== settings || !sameSource(shown.request.source, source));
  const stateAge = html`<${Age} of=${live} partMs=${one?.age_ms} />`;
  const linked = html`<${Sign} state=${live.connected && fresh ? 'ok' : 'bad'} text=${live.connected ? (fresh ? 'connected' : 'no new data') : 'NO CONNECTION'} />`;
  return html`<${Top} session=${session} bay=${bay} current="Tuning" facts=${linked} choose=${(name) => location.assign(below(`/tune/${encodeURIComponent(name)}`))} />
    <main id="main" tabindex="-1" class="page tuning">
      <h1 class="sr">${text('Tuning of {0}', bay)}</h1>
      <${CheckBanner} mode=${fresh ? mode : null} state=${mine?.state ?? null} age=${stateAge} change=${check} busy=${busy !== ''}
        thresholds=${mine?.thresholds ?? null} file=${file} untried=${untried} refresh=${mayEnd} restart=${askRestart} />
      ${restarting && html`<${Restart} session=${session} seconds=${restarting.restart_s} close=${() => set({ restarting: null })} />`}
      <${TeachIn} send=${send} url=${at('teach-in')} checking=${on} />
      <div class="controls">
        <${Camera} bay=${bay} send=${send} url=${at('camera')} checking=${on} led=${led} seen=${mine?.state?.beacon ?? null} />
        <section class="panel" id="settings" aria-labelledby="settings-title">
          <header><h2 id="settings-title">Settings</h2><span class="small">${unlive.length ? `${unlive.length} changed, not live` : 'as in force'}</span>
            <a class="small" href=${`/calibrate/${encodeURIComponent(bay)}`}>Calibrate the lens</a></header>
          <${Form} schema=${schema} settings=${settings} inForce=${inForce} set=${change} remarks=${remarks} picture=${result?.picture ?? null} />
        </section>
      </div>
      <div class="pictures">
        <${SourceBar} source=${source} taken=${taken} freeze=${freeze} record=${record} upload=${upload} choose=${(chosen) => set({ source: chosen })} busy=${busy} working=${waiting} />
        ${trouble && html`<p class="notice bad" role="alert">${trouble}</p>`}
        <div class=${`tiles${behind ? ' behind' : ''}${elsewhere ? ' elsewhere' : ''}`} ref=${tiles} data-trial=${shown?.number}>
          <${Eyedropper} bitmap=${picture} frame=${shown?.picture ?? null} frameId=${frameId} elsewhere=${elsewhere} pick=${pick} picked=${picked.answer} failed=${picked.failed} live=${source.kind === 'live'} robust=${settings.method === 'robust'} />
          <${Stages} panels=${panels} frameId=${frameId} />
        </div>
        <p class="sr" role="status" aria-live="polite" translate="no">${result?.request.timed ? summary(result) : ''}</p>
        </div>
      <div class="results"><${Effect} result=${result} waiting=${waiting} /><${Remarks} remarks=${remarks} light=${result?.exposure ?? null}
        judged=${result?.request.source.kind === 'live' && result.judged_id !== result.frame_id ? result.judged_id : null} /></div>
      <${TestSets} sets=${testSets} settings=${settings} shown=${() => (source.kind === 'live' ? freeze() : source)} taken=${taken} tell=${tell} />
    </main>
    <footer class="actions" aria-label="what to do with the settings">
      <div class="row">
        <button type="button" class="primary" id="apply" disabled=${!on || !unlive.length || !['', 'apply'].includes(busy)} aria-describedby="why-not-live" onClick=${apply}>Go live</button>
        <button type="button" disabled=${!undoSteps || mode === null || busy !== ''} aria-describedby="undone" onClick=${undo}>${on || !undoSteps ? 'Undo live change' : 'Begin function check and undo'}</button>
        <button type="button" disabled=${!unlive.length} onClick=${() => set({ settings: inForce })}>Take all back</button>
        ${testSets.running && html`<span class="small" role="status">${`Scoring: ${testSets.scores[testSets.running]?.view.done ?? 0} of ${testSets.scores[testSets.running]?.view.total ?? 0} pictures`}</span>
          <button type="button" onClick=${() => testSets.cancel()}>Cancel scoring</button>`}
        <span class="gap"></span>
        <button type="button" id="save" disabled=${!file.path || !['', 'diff'].includes(busy)} onClick=${diff}>Save to file…</button>
        <button type="button" disabled=${busy !== ''} onClick=${exported}>Export</button>
        <${ImportButton} take=${imported} />
      </div>
      <p class="small" id="why-not-live">
        ${!on && unlive.length ? 'To go live, begin a function check. ' : ''}${file.unsaved.length ? `${text('In force but not in the file: {0}.', file.unsaved.join(', '))} ` : ''}${file.why_not && !plan ? html`<span>${text('Saving: {0}.', file.why_not)} </span>` : ''}
        <span id="undone">${undoSteps ? `${text('Undo live change brings back: {0}.', Object.entries(undone).map(([key, value]) => `${key} = ${value ?? t('absent')}`).join(', ') || t('the same settings'))} ` : ''}</span>
        <span role="status" class=${state.said.bad ? 'said warning' : ''}>${state.said.bad ? html`<span aria-hidden="true">▲ </span>` : ''}${state.said.text}</span>
      </p>
    </footer>
    ${plan && html`<${SaveDialog} plan=${plan} live=${!unlive.length} save=${save} close=${() => set({ plan: null })} />`}
    ${question && html`<${WarningDialog} ...${question} />`}`;
}

const sameSource = (a, b) => a.kind === b.kind && a.name === b.name && a.frame === b.frame;

/** Is the chosen source the very frame that is on the page, frozen? */
const frozenFrom = (shown, source, taken) =>
  source.kind === 'snapshot' && taken.find((one) => one.name === source.name)?.frame_ids[0] === shown.frame_id;

function App() {
  const [loaded, setLoaded] = useState(null);
  const [failed, setFailed] = useState('');
  useEffect(() => {
    let timer = 0;
    const load = async () => {
      try {
        const session = await renewed();
        if (session.role !== 'technician') return toLogin();
        const [profile, taken] = await Promise.all([get(at('profile')), get(at('captures'))]);
        setLoaded({ session, profile, taken });
        setFailed('');
      } catch (error) {
        if (error.status === 401) return toLogin();
        setFailed(error.name === 'TypeError' ? 'no connection to the gateway' : error.message);
        if (error.status !== 404) timer = setTimeout(load, 1500);
      }
      return undefined;
    };
    load();
    return () => clearTimeout(timer);
  }, []);
  if (loaded) return html`<${Page} ...${loaded} renew=${renewed} />`;
  return html`<main class="page"><p class=${`notice ${failed ? 'bad' : ''}`} role="status">${failed || 'Loading…'}</p></main>`;
}

titled('Tuning {0}', bay);
render(html`<${App} />`, document.body);
