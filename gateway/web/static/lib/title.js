// The title of the tab, in the viewer's language: what the page is about, and before it the number of alarms.

import { t } from './lang.js';

let [about, alarms] = [document.title, 0];

function show() {
  const text = alarms > 0 ? `(${alarms}) ${about}` : about;
  if (document.title !== text) document.title = text;
}

/** @param {string} text in English, with {0} for `name` @param {string} [name] shown as it is */
export function titled(text, name = '') {
  about = t(text, [name]);
  show();
}

/** @param {number} count */
export function alarmsInTitle(count) {
  alarms = count;
  show();
}
