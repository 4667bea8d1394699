// The views that were taken, with what the result makes of each; the one that fits worst is named.

import { html } from '../lib/page.js';
import { number } from '../lib/format.js';
import { distance } from '../lib/units.js';

export function Views({ base, view, result, remove, busy }) {
  const fits = new Map((result?.views ?? []).map((one) => [one.name, one]));
  return html`<section class="panel taken" aria-labelledby="views-title">
    <header><h2 id="views-title">Views</h2><span class="small muted">${`at most ${view.most} are kept`}</span></header>
    ${view.views.length === 0 && html`<p class="muted">None yet.</p>`}
    <ul class="views">${[...view.views].reverse().map((one) => {
      const fit = fits.get(one.name);
      const worst = result?.worst === one.name && fits.size > 3;
      return html`<li key=${one.number} data-view=${one.number} class=${fit && !fit.used ? 'out' : ''}>
        <img src=${`${base}/views/${one.number}/picture`} alt=${`view ${one.number}`} width="240" height=${Math.round((240 * view.height_px) / view.width_px)} loading="lazy" />
        <p class="small"><b>${`View ${one.number}`}</b>${worst && html` <span class="tag">fits worst</span>`}${fit && !fit.used && html` <span class="tag bad">left out</span>`}</p>
        <p class="small">${fit ? `rms ${number(fit.rms_px, 3, 'px')}` : 'not used yet'}${fit?.distance_mm ? ` · ${distance(fit.distance_mm)} · ${number(fit.tilt_deg, 0)}°` : ''}</p>
        <button type="button" class="plain small" disabled=${busy} onClick=${() => remove(one.number)} aria-label=${`Remove view ${one.number}`}>Remove</button></li>`;
    })}</ul>
  </section>`;
}
