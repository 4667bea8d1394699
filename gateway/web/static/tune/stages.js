// The stages of the trial side by side.

import { html } from '../vendor/preact-htm.js';

export function Stages({ panels }) {
  return panels.map((panel) => html`<figure class="tile stage" data-panel=${panel.name} key=${panel.name}>
    <figcaption><h3>${panel.title}</h3><span class="small">${panel.detail}</span></figcaption>
    <img class="shot" src=${panel.url} width=${panel.width_px} height=${panel.height_px} alt=${`${panel.title}: ${panel.detail}`} decoding="async" />
  </figure>`);
}
