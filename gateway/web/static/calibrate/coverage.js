// Where in the picture the board has been, how it was tilted, at which distances; and which kinds of views are missing.

import { html } from '../lib/page.js';
import { number } from '../lib/format.js';

const NEEDS = [
  ['views', 'enough views'],
  ['left', 'left edge farther away'],
  ['right', 'right edge farther away'],
  ['top', 'upper edge farther away'],
  ['bottom', 'lower edge farther away'],
  ['distance', 'near and far'],
  ['coverage', 'most of the picture'],
];
// The board seen from the front with one edge farther away: that edge is shorter.
const SHAPES = {
  views: 'M3 5H13V13H3ZM6 5V3H16V11H13',
  left: 'M3 5.5L17 2V16L3 12.5Z',
  right: 'M3 2L17 5.5V12.5L3 16Z',
  top: 'M6 3H14L18 15H2Z',
  bottom: 'M2 3H18L14 15H6Z',
  distance: 'M2 2H18V16H2ZM7 6H13V12H7Z',
  coverage: 'M2 2H18V16H2ZM2 9H18M10 2V16',
};

export function Missing({ view }) {
  const missing = NEEDS.filter(([kind]) => view.missing.includes(kind));
  return html`<ul class="needs" aria-label="kinds of views">${NEEDS.map(([kind, name]) => {
    const open = view.missing.includes(kind);
    return html`<li class=${open ? 'open' : ''} data-need=${kind} data-open=${String(open)}>
      <svg viewBox="0 0 20 18" aria-hidden="true"><path d=${SHAPES[kind]} fill="none" stroke="currentColor" stroke-width="1.4" /></svg>
      <span>${name}</span><span class="sign small"><span aria-hidden="true">${open ? '○' : '✓'}</span> ${open ? 'missing' : 'seen'}</span></li>`;
  })}</ul>
  <p class="small" role="status">${missing.length ? '' : 'Every kind of view is there.'}</p>`;
}

/** The picture in cells: how often corners were seen in each, and the outlines of the boards. */
export function Coverage({ view }) {
  const [across, down] = [view.coverage[0]?.length ?? 8, view.coverage.length || 6];
  const [width, height] = [view.width_px, view.height_px];
  const most = Math.max(1, ...view.coverage.flat());
  const line = width / 320;
  return html`<figure class="coverage"><svg viewBox=${`0 0 ${width} ${height}`} role="img" aria-label=${`the board was seen in ${number(100 * view.covered)} % of the picture`}>
      ${view.coverage.map((cells, row) => cells.map((count, column) => html`<rect x=${(column * width) / across} y=${(row * height) / down} width=${width / across} height=${height / down}
        class=${count ? 'seen' : 'unseen'} fill-opacity=${count ? (0.15 + 0.6 * count / most).toFixed(2) : 1} stroke="var(--line)" stroke-width=${line / 2} />`))}
      ${view.views.map((one) => html`<polygon points=${one.outline.map((point) => point.join(',')).join(' ')} fill="none" stroke="var(--text)" stroke-width=${line} stroke-opacity="0.6" />`)}
    </svg>
    <figcaption class="small">${`Seen in ${number(100 * view.covered)} % of the picture; the largest board is ${number(view.distances, 2)} times the smallest. Stronger: more corners. Outlines: the boards.`}</figcaption></figure>`;
}
