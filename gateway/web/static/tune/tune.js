// The technician's page: settings tried on pictures, let live, and written back to the configuration's file.

import { html, render, useEffect, useMemo, useRef, useState } from '../vendor/preact-htm.js';
import { get, post, toLogin } from '../lib/api.js';
import { widthFor } from '../lib/pictures.js';
import { Brand, Pages, Who } from '../lib/top.js';
import { useLive } from '../operator/hooks.js';
import { Health as Sign } from '../operator/signs.js';
import { CheckBanner } from './check.js';
import { Effect, Remarks, summary } from './effect.js';
import { Eyedropper } from './eyedropper.js';
import { ImportButton, SaveDialog, download } from './file.js';
import { Form } from './form.js';
import { differing, followed } from './settings.js';
import { SourceBar } from './source.js';
import { Stages } from './stages.js';
import { trials } from './trials.js';

const STALE_MS = 1500;
const LIVE_PAUSE_MS = 350; // between two trials on the running picture
const TRIAL_MS = 60_000;
const TAB = `t${Math.random().toString(36).slice(2, 12)}`;

const bay = decodeURIComponent(location.pathname.split('/')[2] ?? '');
const at = (path) => `/api/bays/${encodeURIComponent(bay)}/${path}`;

/** POSTs with the session's token; a token that has gone stale is fetched anew, once. */
function useSend(session, renew) {
  const csrf = useRef(session.csrf);
  return async (path, body, timeoutMs = 15_000) => {
    for (let tries = 0; ; tries += 1) {
      try {
        return await post(at(path), body, csrf.current, { timeoutMs });
      } catch (error) {
        if (error.status === 401) toLogin();
        if (error.status !== 403 || tries > 0) throw error;
        csrf.current = (await renew()).csrf;
      }
    }
  };
}

/** The bitmap at `url`, and the frame it belongs to. */
function useBitmap(url) {
  const [bitmap, setBitmap] = useState(null);
  useEffect(() => {
    if (!url) return undefined;
    const end = new AbortController();
    (async () => {
      try {
        const answer = await fetch(url, { credentials: 'same-origin', signal: end.signal });
        if (answer.ok) setBitmap(await createImageBitmap(await answer.blob()));
      } catch (error) {
        if (!end.signal.aborted) console.warn(`no picture: ${error.message}`);
      }
    })();
    return () => end.abort();
  }, [url]);
  return bitmap;
}

function Top({ session, connected, fresh }) {
  return html`<a class="skip" href="#settings">to the settings</a><header class="top">
    <${Brand} title="Tuning" />
    <${Pages} session=${session} bay=${bay} current="Technician" />
    <label class="small">bay <select value=${bay} onChange=${(event) => location.assign(`/tune/${encodeURIComponent(event.target.value)}`)}>
      ${session.bays.map((name) => html`<option value=${name} selected=${name === bay}>${name}</option>`)}</select></label>
    <div class="facts push"><${Sign} state=${connected && fresh ? 'ok' : 'bad'} text=${connected ? (fresh ? 'connected' : 'no new data') : 'NO CONNECTION'} />
      <${Who} session=${session} /></div>
  </header>`;
}

function Page({ session, profile: first, taken: kept, renew }) {
  const send = useSend(session, renew);
  const { schema } = first;
  const [inForce, setInForce] = useState(first.vision);
  const known = useRef(first.vision); // the newest that was told to be in force
  const [settings, setSettings] = useState(first.vision);
  const [file, setFile] = useState(first.file);
  const [undoSteps, setUndoSteps] = useState(first.undo_steps);
  const [mode, setMode] = useState(first.function_check.toUpperCase());
  const [taken, setTaken] = useState(kept);
  const [source, setSource] = useState({ kind: 'live' });
  const [result, setResult] = useState(null);
  const [said, setSaid] = useState({ text: '', bad: false });
  const [trouble, setTrouble] = useState('');
  const [waiting, setWaiting] = useState(false);
  const [busy, setBusy] = useState('');
  const [picked, setPicked] = useState({ answer: null, failed: '' });
  const [plan, setPlan] = useState(null);
  const tiles = useRef(null);
  const { view, connected, freshness } = useLive([bay], 500, STALE_MS);
  const fresh = freshness.fresh(performance.now(), Date.now());
  const mine = fresh ? view?.bays.find((one) => one.bay === bay) ?? null : null;

  useEffect(() => { if (mine) setMode(mine.function_check); }, [mine?.function_check]);

  // Trials.
  const trialQueue = useMemo(() => trials(
    ({ source: on, settings: vision, timed }) => {
      const tile = tiles.current?.querySelector('.stage')?.clientWidth || 420;
      const which = on.kind === 'live' ? { live: true } : { [on.kind]: on.name, frame: on.frame ?? 0 };
      return send('trial', { ...which, vision, timed, tab: TAB, width_px: widthFor(tile, devicePixelRatio || 1) }, TRIAL_MS);
    },
    {
      done(next, request) {
        setTrouble('');
        if (next === null) return; // given up for something newer, or there is no picture yet
        setResult((was) => ({ ...carried(was, next, request), request }));
        if (differing(schema, next.settings_in_force, known.current).length) refresh().catch((error) => setTrouble(error.message));
      },
      failed(error) {
        setTrouble(error.message);
      },
      busy: setWaiting,
    },
  ), []);
  useEffect(() => () => trialQueue.close(), [trialQueue]);
  useEffect(() => trialQueue.want({ source, settings, inForce }), [trialQueue, source, settings, inForce]);
  useEffect(() => {
    if (source.kind !== 'live') return undefined;
    const timer = setTimeout(() => !document.hidden && trialQueue.want({ source, settings, inForce }, { timed: false }), LIVE_PAUSE_MS);
    return () => clearTimeout(timer);
  }, [trialQueue, source, settings, inForce, result, waiting, trouble, view]);

  const change = (name, value) => setSettings((was) => (typeof name === 'string' ? { ...was, [name]: value } : { ...was, ...name }));
  const tell = (text, bad = false) => setSaid({ text, bad });
  const doing = async (what, work) => {
    setBusy(what);
    try {
      return await work();
    } catch (error) {
      tell(error.message, true);
      return null;
    } finally {
      setBusy('');
    }
  };
  const keep = async () => setTaken(await get(at('taken')));
  const freeze = () => doing('freeze', async () => {
    const one = await send('freeze', {});
    await keep();
    const on = { kind: 'snapshot', name: one.name, frame: 0 };
    setSource(on);
    return on;
  });
  const record = () => doing('record', async () => {
    const one = await send('record', { seconds: 3 }, 20_000);
    await keep();
    setSource({ kind: 'recording', name: one.name, frame: Math.floor(one.frames / 2) });
    tell(`${one.frames} frames recorded`);
  });
  const pick = async (place, size, way) => {
    const seen = result?.request.source ?? source;
    const on = seen.kind === 'live' ? await freeze() : seen;
    if (!on) return;
    try {
      const answer = await send('eyedropper', { [on.kind]: on.name, frame: on.frame ?? 0, u_px: place.u, v_px: place.v, size_px: size, mode: way, vision: settings, tab: TAB });
      if (answer === null) return; // another click came after it
      setPicked({ answer, failed: '' });
      change(answer.keys);
    } catch (error) {
      setPicked({ answer: null, failed: error.message });
      trialQueue.want({ source, settings, inForce });
    }
  };

  // Settings.
  const took = (answer) => {
    const was = known.current;
    known.current = answer.vision;
    setInForce(answer.vision);
    setSettings((draft) => followed(draft, was, answer.vision));
    setUndoSteps(answer.undo_steps);
    setMode(answer.function_check.toUpperCase());
    if (answer.file) setFile(answer.file);
  };
  const refresh = async () => took(await get(at('profile')));
  const check = (next) => doing('check', async () => {
    took(await send('function-check', { mode: next }));
    tell(next === 'off' ? 'The function check has ended.' : `Function check: may_move ${next === 'may_move_off' ? 'off' : 'kept'}.`);
  });
  const apply = () => doing('apply', async () => {
    try {
      took(await send('profile/apply', { vision: settings, over: inForce }));
    } finally {
      await refresh();
    }
    tell('These settings are live.');
  });
  const undo = () => doing('undo', async () => {
    const answer = await send('profile/undo', {});
    took(answer);
    setSettings(answer.vision);
    await refresh();
    tell('What was in force before is live again.');
  });
  const diff = () => doing('diff', async () => setPlan(await send('profile/diff', { vision: settings })));
  const save = async (shown) => {
    const done = await send('profile/save', { vision: settings, digest: shown.digest });
    await refresh();
    return done;
  };
  const exported = () => doing('export', async () => {
    const answer = await fetch(at('profile/export'), { method: 'POST', credentials: 'same-origin', headers: { 'Content-Type': 'application/json', 'X-CSRF-Token': (await renew()).csrf }, body: JSON.stringify({ vision: settings }) });
    const text = await answer.text();
    if (!answer.ok) throw new Error(JSON.parse(text).detail ?? 'refused');
    download(`vision-${bay}.toml`, text);
  });
  const imported = (name, text) => doing('import', async () => {
    if (text === null) throw new Error(`${name}: too large for a profile`);
    const answer = await send('profile/import', { name, text });
    setSettings(answer.vision);
    tell(answer.changes.length ? `${name}: ${answer.changes.length} ${answer.changes.length === 1 ? 'key differs' : 'keys differ'} from what is in force: ${answer.changes.join(', ')}.` : `${name} says just what is in force.`);
  });

  // Whoever leaves in the middle is asked.
  const unlive = differing(schema, settings, inForce);
  const on = mode !== 'OFF' && mode !== null;
  useEffect(() => {
    if (!on) return undefined;
    const leaving = (event) => event.preventDefault();
    addEventListener('beforeunload', leaving);
    return () => removeEventListener('beforeunload', leaving);
  }, [on]);

  const panels = result?.panels.filter((panel) => panel.name !== 'picture') ?? [];
  const wide = widthFor(tiles.current?.querySelector('.picture')?.clientWidth || 640, devicePixelRatio || 1);
  const shown = result?.request.source ?? null; // what is on the page, all of it of one frame
  const frozen = shown && shown.kind !== 'live' ? `${at(`taken/${shown.name}/${shown.frame ?? 0}`)}?width=${Math.max(960, wide)}` : null;
  const picture = useBitmap(frozen ?? result?.panels.find((panel) => panel.name === 'picture')?.url);
  const remarks = result?.remarks ?? [];
  const behind = result !== null && (result.request.settings !== settings || !sameSource(result.request.source, source));
  return html`<${Top} session=${session} connected=${connected} fresh=${fresh} />
    <main class="page tuning">
      <h1 class="sr">Tuning of ${bay}</h1>
      <${CheckBanner} mode=${fresh ? mode : null} state=${mine?.state ?? null} change=${check} busy=${busy !== ''} />
      <div class="controls">
        <section class="panel" id="settings" aria-labelledby="settings-title">
          <header><h2 id="settings-title">Settings</h2><span class="small">${unlive.length ? `${unlive.length} changed, not live` : 'as in force'}</span></header>
          <${Form} schema=${schema} settings=${settings} inForce=${inForce} set=${change} remarks=${remarks} picture=${result?.picture ?? null} />
        </section>
      </div>
      <div class="pictures">
        <${SourceBar} source=${source} taken=${taken} freeze=${freeze} record=${record} choose=${setSource} busy=${busy} working=${waiting} />
        ${trouble && html`<p class="notice bad" role="alert">${trouble}</p>`}
        <div class=${`tiles${behind ? ' behind' : ''}`} ref=${tiles}>
          <${Eyedropper} bitmap=${picture} frame=${result?.picture ?? null} pick=${pick} picked=${picked.answer} failed=${picked.failed} live=${source.kind === 'live'} />
          <${Stages} panels=${panels} />
        </div>
        <p class="sr" role="status" aria-live="polite">${result?.request.timed ? summary(result) : ''}</p>
        </div>
      <div class="results"><${Effect} result=${result} waiting=${waiting} /><${Remarks} remarks=${remarks} light=${result?.exposure ?? null} /></div>
    </main>
    <footer class="actions" aria-label="what to do with the settings">
      <div class="row">
        <button type="button" class="primary" id="apply" disabled=${!on || !unlive.length || busy !== ''} aria-describedby="why-not-live" onClick=${apply}>Go live</button>
        <button type="button" disabled=${!on || !undoSteps || busy !== ''} onClick=${undo}>Undo live change</button>
        <button type="button" disabled=${!unlive.length} onClick=${() => setSettings(inForce)}>Take all back</button>
        <span class="gap"></span>
        <button type="button" id="save" disabled=${!file.path || busy !== ''} onClick=${diff}>Save to file…</button>
        <button type="button" disabled=${busy !== ''} onClick=${exported}>Export</button>
        <${ImportButton} take=${imported} />
      </div>
      <p class="small" id="why-not-live">
        ${!on && unlive.length ? 'To go live, begin a function check. ' : ''}${file.unsaved.length ? `In force but not in the file: ${file.unsaved.join(', ')}. ` : ''}${file.why_not && !plan ? html`<span>Saving: ${file.why_not}. </span>` : ''}
        <span role="status" class=${said.bad ? 'said warning' : ''}>${said.bad ? html`<span aria-hidden="true">▲ </span>` : ''}${said.text}</span>
      </p>
    </footer>
    ${plan && html`<${SaveDialog} plan=${plan} live=${!unlive.length} save=${save} close=${() => setPlan(null)} />`}`;
}

const sameSource = (a, b) => a.kind === b.kind && a.name === b.name && a.frame === b.frame;

/** A look without times keeps the times that were measured for these very settings. */
function carried(was, next, request) {
  const alike = was && was.request.settings === request.settings && was.request.inForce === request.inForce && was.request.source.kind === request.source.kind;
  if (!alike || request.timed || !was.timed) return next;
  const times = (side, old) => ({ ...side, total_ms: old.total_ms, stages: old.stages });
  return { ...next, timed: true, time_ratio: was.time_ratio, exposure: was.exposure, tried: times(next.tried, was.tried), in_force: times(next.in_force, was.in_force) };
}

function App() {
  const [loaded, setLoaded] = useState(null);
  const [failed, setFailed] = useState('');
  const renew = () => get('/api/session');
  useEffect(() => {
    let timer = 0;
    const load = async () => {
      try {
        const session = await renew();
        if (session.role !== 'technician') return toLogin();
        const [profile, taken] = await Promise.all([get(at('profile')), get(at('taken'))]);
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
  if (loaded) return html`<${Page} ...${loaded} renew=${renew} />`;
  return html`<main class="page"><p class=${`notice ${failed ? 'bad' : ''}`} role="status">${failed || 'Loading…'}</p></main>`;
}

document.title = `Tuning ${bay}`;
render(html`<${App} />`, document.body);
