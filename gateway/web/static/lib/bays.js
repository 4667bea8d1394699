// What people call a bay: its title, with its name beside it; the name alone where it has no title. And the one that is chosen.

import { remember, remembered } from './memory.js';

/** @type {Record<string, string>} */
let titles = {};

/** @param {Record<string, string>} [found] by the bays' names, as the session has them */
export function learnTitles(found = {}) {
  titles = found;
}

/** @param {string} name @returns {string} empty: it has none */
export const titleOf = (name) => (Object.hasOwn(titles, name) ? titles[name] : '');

/** @param {string} name */
export const called = (name) => (titleOf(name) ? `${titleOf(name)} (${name})` : name);

const KEY = 'gateway.bay';

/** The bay that was looked at last in this tab; null: none. @param {string[]} bays @param {string|null} [bay] that is looked at */
export function chosenBay(bays, bay) {
  if (bay) remember(KEY, bay, true);
  const kept = bay ?? remembered(KEY, true);
  return kept !== null && bays.includes(kept) ? kept : null;
}
