// The calibration page: a board is held before the bay's camera, views are taken by themselves, and the lens follows.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { below, ownBay } from '../lib/address.js';
import { get, post, toLogin } from '../lib/api.js';
import { guarded, start } from '../lib/start.js';
import { titled } from '../lib/title.js';
import { Top } from '../lib/top.js';
import { BoardForm } from './board.js';
import { Coverage, Missing } from './coverage.js';
import { Live } from './live.js';
import { Result } from './result.js';
import { Views } from './views.js';

const bay = ownBay();
const BASE = `/api/bays/${encodeURIComponent(bay)}/calibration`;
const WATCH_MS = 5000; // while another user calibrates, or nobody
const RESULT_MS = 120_000;

/** POSTs and DELETEs with the session's token; a stale one is fetched anew, once. */
function useSend(session) {
  const csrf = useRef(session.csrf);
  return async (path, body, { method = 'POST', timeoutMs = 15_000 } = {}) => {
    for (let tries = 0; ; tries += 1) {
      try {
        return await post(`${BASE}${path}`, body, csrf.current, { timeoutMs, method });
      } catch (error) {
        if (error.status === 401) toLogin();
        if (error.status !== 403 || tries > 0) throw error;
        csrf.current = (await get('/api/session')).csrf;
      }
    }
  };
}

function App({ session }) {
  const send = useSend(session);
  const [view, setView] = useState(null);
  const [result, setResult] = useState(null);
  const [radius, setRadius] = useState(''); // of the marker, as typed
  const [trouble, setTrouble] = useState('');
  const [busy, setBusy] = useState(false);
  const running = view?.phase === 'running' && view.mine;
  const marker = Number(radius) > 0 && Number(radius) <= 10_000 ? Number(radius) : null;

  const doing = async (work) => {
    setBusy(true);
    setTrouble('');
    try {
      return await work();
    } catch (error) {
      setTrouble(error.name === 'TypeError' ? 'no connection to the gateway' : error.message);
      return null;
    } finally {
      setBusy(false);
    }
  };
  const load = () => doing(async () => setView(await get(BASE)));
  useEffect(() => { load(); }, []);
  useEffect(() => {
    if (running || view === null) return undefined;
    const timer = setInterval(() => get(BASE).then(setView, () => {}), WATCH_MS);
    return () => clearInterval(timer);
  }, [running, view === null]);
  // What follows from the views, whenever they have changed.
  useEffect(() => {
    if (!running) return setResult(null);
    const end = new AbortController();
    const query = marker === null ? '' : `?marker_radius_mm=${marker}`;
    get(`${BASE}/result${query}`, { signal: end.signal, timeoutMs: RESULT_MS }).then(setResult, (error) => {
      if (!end.signal.aborted) setTrouble(error.message);
    });
    return () => end.abort();
  }, [running, view?.revision, marker]);

  const begin = (board) => doing(async () => {
    setResult(null);
    setView(await send('', board));
  });
  const finish = () => doing(async () => setView(await send('', undefined, { method: 'DELETE' })));
  const remove = (number) => doing(async () => setView(await send(`/views/${number}`, undefined, { method: 'DELETE' })));
  const looked = (look) => {
    if (look.revision !== view.revision) load();
  };
  const lost = async (why) => { // the session has ended meanwhile
    await load();
    setTrouble(why);
  };
  return html`
    <${Top} session=${session} bay=${bay} current="Lens" choose=${(name) => location.assign(below(`/calibrate/${encodeURIComponent(name)}`))} />
    <main id="main" tabindex="-1" class="page calibration">
      <div class="whole head"><h1>Camera calibration: <span translate="no">${bay}</span></h1>
        ${trouble && html`<p class="notice bad" role="alert">${trouble}</p>`}</div>
      ${view === null && !trouble && html`<p role="status">Loading…</p>`}
      ${view?.phase === 'running' && !view.mine && html`<div class="notice warn whole" role="status"><p>Another user is calibrating this camera: <b translate="no">${view.who}</b></p>
        <p>${`${view.views.length} views so far. You can begin when that has ended.`}</p>
        <p><button type="button" disabled=${busy} onClick=${finish}>End it, its views are lost</button></p></div>`}
      ${view?.phase === 'none' && html`<${BoardForm} base=${BASE} begin=${begin} busy=${busy} />`}
      ${running && html`
        <${Live} base=${BASE} send=${send} view=${view} looked=${looked} lost=${lost} />
        <div class="outcome">
          <section class="panel" aria-labelledby="coverage-title"><header><h2 id="coverage-title">What the views show</h2><span class="small" data-count>${`${view.views.length} of ${view.wanted} views`}</span></header>
            <${Missing} view=${view} /><${Coverage} view=${view} /></section>
          <${Result} session=${session} base=${BASE} view=${view} result=${result} radius=${radius} setRadius=${setRadius} marker=${marker} />
          <p class="row"><button type="button" disabled=${busy} onClick=${finish}>End this calibration, its views are lost</button></p>
        </div>
        <${Views} base=${BASE} view=${view} result=${result} remove=${remove} busy=${busy} />`}
    </main>`;
}

titled('Calibration {0}', bay);
start(guarded(App));
