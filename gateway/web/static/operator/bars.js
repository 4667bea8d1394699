// R against R_th and Z against Z_th: the two halves of equation 14, as bars.

import { html } from '../vendor/preact-htm.js';
import { barOf, nice, ticks } from '../lib/bars.js';
import { NONE, number, words } from '../lib/format.js';

const share = (x) => `${(100 * x).toFixed(2)}%`;

function Bar({ name, long, value, decimals, unit, threshold, hysteresis, reachedAbove, most, why }) {
  const bar = barOf({ value, threshold, hysteresis, reachedAbove, most });
  const sign = reachedAbove ? '≥' : '≤';
  const verdict =
    bar.reached === null
      ? `no value: ${why}`
      : bar.reached
        ? `reached: ${name} ${sign} ${number(threshold, 0, unit)}`
        : bar.inBand
          ? 'in the hysteresis band'
          : 'not reached';
  return html`<div class="bar">
    <div class="row spread">
      <p><b>${name}</b> <span class="muted small">${long}</span></p>
      <p class="value big">${value === null ? NONE : number(value, decimals, unit)}</p>
    </div>
    <div class="track" role="meter" aria-label=${long} aria-valuemin="0" aria-valuemax=${most} aria-valuenow=${value ?? 0} aria-valuetext=${`${number(value, decimals, unit)}, ${verdict}`}>
      <div class="zone" style=${{ left: share(bar.zone[0]), width: share(bar.zone[1] - bar.zone[0]) }}></div>
      ${bar.band && html`<div class="band" style=${{ left: share(bar.band[0]), width: share(bar.band[1] - bar.band[0]) }}></div>`}
      ${bar.fill !== null && html`<div class=${`fill ${bar.reached ? 'reached' : ''}`} style=${{ transform: `scaleX(${bar.fill.toFixed(4)})` }}></div>`}
      ${bar.beyond && html`<div class="beyond" title="beyond the scale">▶</div>`}
      ${bar.fill === null && html`<div class="novalue">no value</div>`}
      <div class="mark" style=${{ left: share(bar.mark) }}></div>
    </div>
    <div class="scale" aria-hidden="true">
      ${ticks(most).map((at) => html`<span style=${{ left: share(at / most) }}>${number(at)}</span>`)}
    </div>
    <p class="small verdict">
      <svg viewBox="0 0 12 12" aria-hidden="true"><rect x="1" y="1" width="10" height="10" fill=${bar.reached ? '#1f2529' : 'none'} stroke="#1f2529" stroke-width="1.6" stroke-dasharray=${bar.reached === null ? '2 2' : 'none'} /></svg>
      <span>${verdict}</span>
      <span class="muted push nowrap">▲ ${name}<sub>th</sub> ${number(threshold, 0, unit)}${hysteresis > 0 ? ` (hysteresis ${number(hysteresis, 0, unit)})` : ''}</span>
    </p>
  </div>`;
}

export function Bars({ state, limits }) {
  const vision = state?.vision.quality.name;
  const range = state?.range.quality.name;
  return html`<section class="panel" aria-labelledby="bars-title">
    <header><h2 id="bars-title">Position against thresholds</h2></header>
    <${Bar} name="R" long="radius of the marker in the picture" value=${state?.radius_px ?? null} decimals=${1} unit="px"
      threshold=${limits.radius_threshold_px} hysteresis=${limits.radius_hysteresis_px} reachedAbove=${true}
      most=${nice(1.5 * limits.radius_threshold_px)} why=${vision ? words(vision) : 'no data'} />
    <${Bar} name="Z" long="distance to the truck" value=${state?.distance_mm ?? null} decimals=${0} unit="mm"
      threshold=${limits.distance_threshold_mm} hysteresis=${limits.distance_hysteresis_mm} reachedAbove=${false}
      most=${Math.min(4000, nice(6 * limits.distance_threshold_mm))} why=${range ? words(range) : 'no data'} />
  </section>`;
}
