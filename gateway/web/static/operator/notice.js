// A line that warns. It always stands in the page, hidden: a screen reader then tells it when it appears, and nothing
// below changes its place in the tab order's list.

import { html } from '../lib/page.js';

/** `kind`: bad or warn; `say`: what it says; empty: it is hidden. `loud`: read out at once. */
export const Notice = ({ kind, say, loud = false, wide = false }) =>
  html`<p class=${`notice ${kind} ${wide ? 'banner' : 'small'}`} role=${loud ? 'alert' : 'status'} hidden=${!say}>${say || ''}</p>`;
