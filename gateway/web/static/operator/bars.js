// R against R_th and Z against Z_th: the two halves of equation 14, as bars.

import { html } from '../lib/page.js';
import { barOf, nice, ticks, written } from '../lib/bars.js';
import { NONE, number, words } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { quantity } from '../lib/quantity.js';
import { inUnit, lengthUnit, places } from '../lib/units.js';

const share = (x) => `${(100 * x).toFixed(2)}%`;

/** Where the condition holds, the value, and the threshold. */
const Marks = ({ bar }) => html`<span class="zone" style=${{ left: share(bar.zone[0]), width: share(bar.zone[1] - bar.zone[0]) }}></span>
  ${bar.band && html`<span class="band" style=${{ left: share(bar.band[0]), width: share(bar.band[1] - bar.band[0]) }}></span>`}
  ${bar.fill !== null && html`<span class=${`fill ${bar.reached ? 'reached' : ''}`} style=${{ transform: `scaleX(${bar.fill.toFixed(4)})` }}></span>`}
  <span class="mark" style=${{ left: share(bar.mark) }}></span>`;

/** How R and Z are compared: what both bars of a bay are made of. */
const ofRadius = (state, limits) => ({
  value: state?.radius_px ?? null,
  threshold: limits.radius_threshold_px,
  hysteresis: limits.radius_hysteresis_px,
  reachedAbove: true,
  most: nice(1.5 * limits.radius_threshold_px),
});
const ofDistance = (state, limits) => ({
  value: inUnit(state?.distance_mm),
  threshold: inUnit(limits.distance_threshold_mm),
  hysteresis: inUnit(limits.distance_hysteresis_mm),
  reachedAbove: false,
  most: nice(inUnit(Math.min(3500, 6 * limits.distance_threshold_mm))),
});

function Bar({ name, long, value, decimals, unit, threshold, hysteresis, reachedAbove, most, why }) {
  const fine = unit === 'px' || unit === 'mm' ? 0 : decimals; // of thresholds
  const marks = ticks(most);
  const labels = written(marks);
  const bar = barOf({ value, threshold, hysteresis, reachedAbove, most });
  const sign = reachedAbove ? '≥' : '≤';
  const verdict =
    bar.reached === null
      ? text('no value: {0}', t(why))
      : bar.reached
        ? text('reached: {0} {1} {2}', name, sign, number(threshold, fine, unit))
        : bar.inBand
          ? 'in the hysteresis band'
          : 'not reached';
  return html`<div class="bar">
    <div class="row spread">
      <p><b>${name}</b> <span class="muted small">${long}</span></p>
      <p class="value big">${value === null ? NONE : quantity(number(value, decimals, unit))}</p>
    </div>
    <div class="track" role="meter" aria-label=${long} aria-valuemin="0" aria-valuemax=${most} aria-valuenow=${value ?? 0} aria-valuetext=${listed([number(value, decimals, unit), t(verdict)], ', ')}>
      <${Marks} bar=${bar} />
      ${bar.beyond && html`<div class="beyond" title="beyond the scale">▶</div>`}
      ${bar.fill === null && html`<div class="novalue">no value</div>`}
    </div>
    <div class="scale" aria-hidden="true">
      ${marks.map((at, n) => html`<span style=${{ left: share(at / most) }}>${labels[n]}</span>`)}
    </div>
    <p class="small verdict">
      <svg viewBox="0 0 12 12" aria-hidden="true"><rect x="1" y="1" width="10" height="10" fill=${bar.reached ? 'var(--text)' : 'none'} stroke="var(--text)" stroke-width="1.6" stroke-dasharray=${bar.reached === null ? '2 2' : 'none'} /></svg>
      <span>${verdict}</span>
      <span class="muted push nowrap"><span translate="no">▲ ${name}_th ${number(threshold, fine, unit)}</span>${hysteresis > 0 ? ` ${text('(hysteresis {0})', number(hysteresis, fine, unit))}` : ''}</span>
    </p>
  </div>`;
}

export function Bars({ state, limits }) {
  const vision = state?.vision.quality.name;
  const range = state?.range.quality.name;
  return html`<section class="panel position" aria-labelledby="bars-title">
    <header><h2 id="bars-title">Position against thresholds</h2></header>
    <${Bar} name="R" long="radius of the marker in the picture" ...${ofRadius(state, limits)} decimals=${1} unit="px" why=${vision ? words(vision) : 'no data'} />
    <${Bar} name="Z" long="distance to the truck" ...${ofDistance(state, limits)} decimals=${places(0)} unit=${lengthUnit()} why=${range ? words(range) : 'no data'} />
  </section>`;
}
