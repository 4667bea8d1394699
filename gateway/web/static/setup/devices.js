// Cameras and boards of the gateway's machine: the list, which renews itself, and a live look at one of them, or at those
// of a bay that runs.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { get, pause, post } from '../lib/api.js';
import { age, number, words } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { OVERVIEW_LIMIT_MS, moment } from '../lib/freshness.js';
import { follow } from '../lib/pictures.js';
import { Age, useFresh, usePolled } from '../operator/hooks.js';
import { distance, units } from '../lib/units.js';
import { rangeHealth, visionHealth } from '../lib/views.js';

const LIST_MS = 4000;
const AGAIN_MS = 3000; // while another page looks at a device
const NEWS_MS = 15_000; // an answer waits for news for some seconds
const STATE_MS = 500;
const PICTURE_PX = 640;

/** What is plugged in, asked again and again while `wanted`. @returns {{cameras: any[]|null, ports: any[]|null, wrong: string}} */
export function useDevices(wanted) {
  const [found, setFound] = useState({ cameras: null, ports: null, wrong: '' });
  useEffect(() => {
    if (!wanted) return undefined;
    const end = new AbortController();
    (async () => {
      while (!end.signal.aborted) {
        try {
          const devices = await get('/api/setup/devices', { signal: end.signal, timeoutMs: 30_000 });
          setFound({ ...devices, wrong: '' });
        } catch (error) {
          if (!end.signal.aborted) setFound((known) => ({ ...known, wrong: error.message }));
        }
        await pause(LIST_MS, end.signal);
      }
    })();
    return () => end.abort();
  }, [wanted]);
  return found;
}

/**
 * A live look at what `question` names (`{camera: {...}}` or `{ranger: {...}}`; null: at nothing). It ends with the page.
 * `{flash: {port, bay}}` puts the firmware on a board, which goes on to its end.
 * @returns {{seen: any, wrong: string, again: () => void}}
 */
export function usePreview(session, question) {
  const live = useFresh(OVERVIEW_LIMIT_MS, () => [0]);
  const [state, setState] = useState({ key: '', seen: null, wrong: '' });
  const [turn, setTurn] = useState(0);
  const former = useRef(null);
  const key = question === null ? '' : JSON.stringify(question);
  useEffect(() => {
    if (!key) return undefined;
    const end = new AbortController();
    const show = (seen, wrong) => { if (!end.signal.aborted) setState({ key, seen, wrong }); };
    (async () => {
      show(null, '');
      let look = null;
      let asked;
      while (look === null && !end.signal.aborted) {
        try {
          asked = moment();
          const { flash, ...wanted } = JSON.parse(key);
          look = await post(flash ? '/api/setup/flash' : '/api/setup/look', { ...wanted, ...flash, replaces: former.current }, session.csrf);
        } catch (error) {
          show(null, error.message);
          if (error.body?.error !== 'busy') return;
          await pause(AGAIN_MS, end.signal);
        }
      }
      if (look === null) return;
      former.current = look.look;
      try {
        while (look.end === null && !end.signal.aborted) {
          show(look, '');
          live.take(look, asked);
          asked = moment();
          look = await get(`/api/setup/look/${look.look}?after=${look.piece}`, { signal: end.signal, timeoutMs: NEWS_MS });
        }
        show(look, '');
        live.take(look, asked);
      } catch (error) {
        show(null, error.message);
      }
    })();
    return () => {
      end.abort();
      if (former.current !== null) post(`/api/setup/look/${former.current}/end`, {}, session.csrf).catch(() => {});
    };
  }, [key, turn]);
  const current = state.key === key;
  const seen = current ? state.seen : null;
  return { seen: seen && !live.fresh(0) ? { ...seen, figures: null } : seen, wrong: current ? state.wrong : '', again: () => setTurn(turn + 1) };
}

const WORDS = { ok: 'OK', warning: 'Warning', fault: 'Fault', waiting: 'Waiting' };
const TAGS = { ok: '', warning: 'warn', fault: 'bad', waiting: '' };

/** One line of an examination: what came back, and what to do; as of `gateway doctor`, in English. */
export const Line = ({ line }) => html`<p class="line"><span class=${`tag ${TAGS[line.verdict] ?? ''}`}>${WORDS[line.verdict] ?? line.verdict}</span>
  <span translate="no">${line.part}${line.name && ` ${line.name}`}: ${line.tried}: <b>${line.result}</b>${line.remedy && html` <span class="remedy" translate="no">→ ${line.remedy}</span>`}</span></p>`;

function Ended({ look, again }) {
  const end = look.seen?.end;
  if (!end && !look.wrong) return null;
  return html`<div class=${`notice ${end?.verdict === 'ok' ? '' : 'bad'}`}>
    ${end ? html`<${Line} line=${end} />` : html`<p>${look.wrong}</p>`}
    <button type="button" onClick=${again}>Look again</button></div>`;
}

/** Where the marker was seen in a picture. */
const Ring = ({ width, height, u, v, radius }) => html`<svg viewBox=${`0 0 ${width} ${height}`} aria-hidden="true"><circle cx=${u} cy=${v} r=${radius} /></svg>`;

const shownDistance = (mm) => (mm === null ? '—' : units() === 'imperial' ? distance(mm) : number(mm / 10, 1, 'cm'));

const Figure = ({ name, children }) => html`<div><dt>${name}</dt><dd class="value">${children}</dd></div>`;

/** The live picture of a camera. `what`: for people. */
export function CameraLook({ look, what }) {
  const { seen } = look;
  const figures = seen?.figures;
  return html`<section class="look" aria-label="live picture">
    ${figures && html`<div class="shot">
      <img src=${`/api/setup/look/${seen.look}/picture?piece=${seen.piece}`} alt=${text('what {0} shows now', what)} width=${figures.width_px} height=${figures.height_px} />
      ${figures.marker && html`<${Ring} width=${figures.width_px} height=${figures.height_px} u=${figures.marker[0]} v=${figures.marker[1]} radius=${figures.marker[2]} />`}
    </div>
    <dl class="figures">
      <${Figure} name="picture">${`${figures.width_px} x ${figures.height_px} px`}<//>
      <${Figure} name="rate">${number(figures.rate_hz, 1, '/s')}<//>
      <${Figure} name="age on arrival">${number(figures.late_ms, 0, 'ms')}<//>
      <${Figure} name="proved to be new">${text('{0} of {1}', figures.fresh, figures.frames)}<//>
      <${Figure} name="marker">${figures.marker ? `R ${number(figures.marker[2], 1, 'px')}` : 'none in sight'}<//>
    </dl>`}
    <div role="status">${seen?.line && !seen.end && html`<${Line} line=${seen.line} />`}
    ${!seen?.line && !seen?.end && !look.wrong && html`<p>${text('Opening {0} …', what)}</p>`}</div>
    <${Ended} look=${look} again=${look.again} />
  </section>`;
}

/** The live distance of a board. */
export function RangerLook({ look, what }) {
  const { seen } = look;
  const figures = seen?.figures;
  return html`<section class="look" aria-label="live distance">
    ${figures && html`<p class="distance"><span class="value">${shownDistance(figures.distance_mm)}</span></p>
    <dl class="figures">
      <${Figure} name="board">${figures.identity ? html`<span translate="no">${figures.identity}</span>` : 'not known yet'}<//>
      <${Figure} name="noise (σ)">${figures.noise_mm === null ? '—' : distance(figures.noise_mm, 1)}<//>
      <${Figure} name="distances">${number(figures.rate_hz, 1, '/s')}<//>
      <${Figure} name="lines">${listed([number(figures.lines_hz, 1, '/s'), text('{0} damaged', figures.damaged)], ', ')}<//>
    </dl>`}
    <div role="status">${seen?.line && !seen.end && html`<${Line} line=${seen.line} />`}
    ${!seen?.line && !seen?.end && !look.wrong && html`<p>${text('Opening {0} …', what)}</p>`}</div>
    <${Ended} look=${look} again=${look.again} />
  </section>`;
}

/** The firmware on its way to a board. `close`: looks at the board, which starts anew. */
export function FlashLook({ look, what, close }) {
  const { seen } = look;
  const end = seen?.end;
  const done = end?.verdict === 'ok' ? 1 : seen?.figures?.done ?? 0;
  return html`<section class="look" aria-label="firmware of the board">
    <p>${text('The firmware goes to {0}. Leave the cable in.', what)}</p>
    <p class="row"><progress value=${done} max="1" aria-label="progress"></progress> <span class="value">${number(100 * done, 0, '%')}</span></p>
    <div role="status">${(end ?? seen?.line) && html`<${Line} line=${end ?? seen.line} />`}${look.wrong && html`<p class="notice bad">${look.wrong}</p>`}</div>
    ${(end || look.wrong) && html`<div class="row"><button type="button" class=${end?.verdict === 'ok' ? 'primary' : ''} onClick=${close}>Look at the board</button>
      ${end?.verdict !== 'ok' && html`<button type="button" class="primary" onClick=${look.again}>Put it on again</button>`}</div>`}
  </section>`;
}

/** Offered where a board does not say that it carries the gateway's firmware. */
export const OfferFirmware = ({ put, why }) => html`<div class="notice">
  <p>An Arduino Uno can be given the gateway's firmware here. The program that is on it now is overwritten.</p>
  ${why && html`<p class="muted">${why}</p>`}
  <button type="button" disabled=${Boolean(why)} onClick=${put}>Put the gateway's firmware on this board</button></div>`;

/** The newest of a bay that runs, again and again: as `usePolled`; `state` null: not known (any more). */
export function useBayState(bay) {
  const polled = usePolled(`/api/bays/${encodeURIComponent(bay)}/state`, STATE_MS);
  return { ...polled, state: polled.fresh(polled.last?.age_ms) ? polled.last.state : null };
}

/** What the bay makes of a sensor. @param {{sensor: any, health: string}} at of the state; health as in lib/views.js */
const Sensor = ({ sensor, health }) => html`<p class="line" role="status"><span class=${`tag ${health === 'ok' || health === 'off' ? '' : health}`}>${words(sensor.quality.name)}</span><span translate="no">${sensor.detail}</span></p>`;

/** What the camera of a bay that runs sees, from the bay's own pictures: the camera is not opened a second time. */
export function BayCamera({ bay }) {
  const { state } = useBayState(bay);
  const canvas = useRef(null);
  const picture = useFresh();
  useEffect(() => {
    picture.forget(true);
    return follow(bay, {
      width: () => PICTURE_PX,
      picture(now, asked, heldMs) {
        const { bitmap } = now;
        const { width, height } = bitmap;
        if (canvas.current) {
          Object.assign(canvas.current, { width, height });
          canvas.current.getContext('2d').drawImage(bitmap, 0, 0);
        }
        bitmap.close();
        picture.take(now, asked, heldMs);
      },
      trouble: () => {},
    });
  }, [bay]);
  const shown = picture.last;
  const live = picture.fresh(shown?.age_ms);
  const circle = shown?.view?.circle;
  return html`<section class="look" aria-label="live picture">
    <div class="shot" hidden=${!live}>
      <canvas ref=${canvas} role="img" aria-label=${text('Live picture of {0}', bay)}></canvas>
      ${live && circle && html`<${Ring} ...${shown.frame} ...${circle} />`}
    </div>
    ${!live && html`<p><b>No live picture.</b></p>`}
    ${live && html`<dl class="figures">
      <${Figure} name="picture">${`${shown.frame.width} x ${shown.frame.height} px`}<//>
      <${Figure} name="rate">${number(state?.rates.vision_hz, 1, '/s')}<//>
      <${Figure} name="age of the picture"><${Age} of=${picture} partMs=${shown.age_ms} /><//>
      <${Figure} name="marker">${circle ? `R ${number(circle.radius, 1, 'px')}` : 'none in sight'}<//>
    </dl>`}
    ${state && html`<${Sensor} sensor=${state.vision} health=${visionHealth(state)} />`}
  </section>`;
}

const NO_FIRMWARE = ['STALE', 'WAITING', 'WRONG_VERSION'];

/** What the ranger of a bay that runs measures. `put`: gives its board the firmware; null: it can't be given one. */
export function BayRanger({ bay, put }) {
  const { state } = useBayState(bay);
  const wanted = put !== null && state !== null && NO_FIRMWARE.includes(state.range.quality.name);
  return html`<section class="look" aria-label="live distance">
    <p class="distance"><span class="value">${shownDistance(state?.distance_mm ?? null)}</span></p>
    <dl class="figures">
      <${Figure} name="distances">${number(state?.rates.range_hz, 1, '/s')}<//>
      <${Figure} name="age of the distance">${age(state?.range.age_ms)}<//>
      <${Figure} name="damaged lines">${number(state?.counters.range_damaged)}<//>
    </dl>
    ${state && html`<${Sensor} sensor=${state.range} health=${rangeHealth(state)} />`}
    ${wanted && html`<${OfferFirmware} put=${put} why=${state.function_check === 'OFF' ? t('Begin a function check of this bay first.') : ''} />`}
  </section>`;
}
