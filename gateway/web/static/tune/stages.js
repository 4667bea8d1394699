// The stages of the trial side by side.

import { listed } from '../lib/lang.js';
import { html, translated } from '../lib/page.js';

/** Of the candidates: several rejections in one text. */
const detailOf = ({ name, detail }) => (name === 'candidates' ? detail.split(/; (?=[a-z]+: )/) : [detail]).map(translated).join('; ');

/** All are of frame `frameId`. */
export function Stages({ panels, frameId }) {
  return panels.map((panel) => html`<figure class="tile stage" data-panel=${panel.name} data-frame=${frameId} key=${panel.name}>
    <figcaption><h3>${panel.title}</h3><span class="small" translate="no">${detailOf(panel)}</span></figcaption>
    <img class="shot" src=${panel.url} width=${panel.width_px} height=${panel.height_px} alt=${listed([translated(panel.title), detailOf(panel)], ': ')} decoding="async" />
  </figure>`);
}
