// A value of which the number is read first: its unit stands small and grey beside it.

import { html } from './page.js';

// As lib/format.js writes it: a number and its unit, or several of them (5 min 3 s), joined by a narrow space.
const VALUE = /^[+\u2212]?\d[\d.\u202f]*\u202f[^\s\d\u202f]+(?: \d+\u202f[^\s\d\u202f]+)*$/;
const UNIT = /(\u202f[^\s\d\u202f]+)/;

/** The units of a value; texts in which there is more than a value, and all else, stay as they are. @param {any} shown */
export const quantity = (shown) =>
  typeof shown === 'string' && VALUE.test(shown)
    ? shown.split(UNIT).map((part, n) => (n % 2 ? html`<span class="unit" translate="no">${part}</span>` : part))
    : shown;
