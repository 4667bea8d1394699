// Light or dark: as the system, until the viewer chooses. Set on the page before it draws.

import { remember, remembered } from './memory.js';

const KEY = 'gateway.theme';
const system = typeof matchMedia === 'undefined' ? null : matchMedia('(prefers-color-scheme: dark)');

/** What was chosen. @returns {'auto'|'light'|'dark'} */
export function theme() {
  const kept = new URLSearchParams(location.search).get('theme') ?? remembered(KEY);
  return kept === 'light' || kept === 'dark' ? kept : 'auto';
}

export const dark = () => theme() === 'dark' || (theme() === 'auto' && system !== null && system.matches);

function apply() {
  document.documentElement.dataset.theme = dark() ? 'dark' : 'light';
}

/** @param {string} name auto, light or dark */
export function setTheme(name) {
  remember(KEY, name === 'auto' ? null : name);
  apply();
}

/** A colour of the style sheet, for a canvas. @param {string} name as "--text" */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** The same for uPlot, which asks when it draws. @param {string} name */
export const ink = (name) => () => colour(name);

if (system !== null) {
  apply();
  system.addEventListener('change', apply);
}
