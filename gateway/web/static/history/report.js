// The report of *Why?* in the page's language: the gateway's own is in English, and has its sentences as codes with values.

import { get } from '../lib/api.js';
import { download } from '../lib/download.js';
import { catalogued, direction, language } from '../lib/lang.js';
import { saidText } from '../lib/said.js';

/** Puts a report into the page's language: sentences by their codes, other texts where the whole is known. @param {Document} report */
export function translate(report) {
  const said = JSON.parse(report.getElementById('said')?.textContent || '{}');
  const walk = report.createTreeWalker(report.body, NodeFilter.SHOW_TEXT);
  for (let node = walk.nextNode(); node; node = walk.nextNode()) {
    const words = node.nodeValue.trim();
    if (words === '' || node.parentElement.closest('script, style, pre')) continue;
    const shown = said[words] ? saidText({ said: said[words], detail: words }) : catalogued(words);
    if (shown) node.nodeValue = node.nodeValue.replace(words, () => shown);
  }
  Object.assign(report.documentElement, { lang: language(), dir: direction() });
}

/** @param {string} path of the gateway's report @param {string} name of the file */
export async function save(path, name) {
  const report = new DOMParser().parseFromString(await get(path, { timeoutMs: 110_000, as: 'text' }), 'text/html');
  translate(report);
  download(name, `<!DOCTYPE html>\n${report.documentElement.outerHTML}`, 'text/html');
}
