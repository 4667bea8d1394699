// The page's language: texts by the English text, which is the key and what stands there without a catalogue. A key may
// begin with what it is about and a bar ("driver|STOP"), where one English word has several meanings.

import { below } from './address.js';
import { remembered, remember } from './memory.js';

/** @typedef {{name: string, direction: 'ltr'|'rtl', texts: Record<string, string|Record<string, string>>}} Catalogue */

/** @type {Catalogue} */
const ENGLISH = { name: 'English', direction: 'ltr', texts: {} };
let code = 'en';
let catalogue = ENGLISH;
let plural = new Intl.PluralRules('en');

/** @param {string} newCode @param {Catalogue} newCatalogue */
export function use(newCode, newCatalogue) {
  [code, catalogue, plural] = [newCode, newCatalogue, new Intl.PluralRules(newCode)];
}

export const language = () => code;
export const direction = () => catalogue.direction;

const filled = (text, values) => text.replace(/\{(\w+)\}/g, (all, name) => (Object.hasOwn(values, name) ? String(values[name]) : all));
const english = (key) => key.replace(/^\w+\|/, '');
const known = (key) => (Object.hasOwn(catalogue.texts, key) ? catalogue.texts[key] : null);

/**
 * What the language's file has for a text, of its plural forms that of `n`; null: nothing, undefined: there is no file.
 * @param {string} key @param {number} n
 * @returns {string|null|undefined}
 */
export function catalogued(key, n = NaN) {
  if (catalogue === ENGLISH) return undefined;
  const found = known(key);
  if (typeof found === 'string') return found;
  return found === null ? null : (found[plural.select(n)] ?? found.other);
}

const MAX_MISSING = 1000;
/** Texts that the language's file does not have, for those who write it. @type {Set<string>} */
const missing = new Set();
/** @type {any} */ (globalThis).missingTexts = missing; // in the browser's console

/** Notes a text that was not found; one without a word is none. @param {string} key */
export function missed(key) {
  if (catalogue !== ENGLISH && !made.has(key) && missing.size < MAX_MISSING && /\p{L}{2}/u.test(key)) missing.add(key);
}

/** A text. @param {string} key the English text @param {Record<string, unknown>|unknown[]} [values] for its {places} */
export function t(key, values = {}) {
  const found = known(key);
  if (found === null) missed(key);
  return filled(typeof found === 'string' ? found : english(key), values);
}

/** What was made of texts and their values: it is not looked up again where it is drawn. @type {Set<string>} */
const made = new Set();
const MOST_MADE = 1000;
export const isMade = (shown) => made.has(shown);

/**
 * A whole text with its values in it, as {0}, {1}: where a value is a word, or the text is put together before it is drawn.
 * @param {string} key the English text @param {...unknown} values texts in the viewer's language, or numbers as people read them
 */
export function text(key, ...values) {
  const found = catalogued(key, parseFloat(String(values[0])));
  if (found === null) missed(key);
  return ready(filled(found ?? english(key), values));
}

/** Texts in a row, none of them part of another's sentence; empty ones are left out. @param {(string|null|undefined|false)[]} texts */
export const listed = (texts, between = ' · ') => ready(texts.filter(Boolean).join(between));

function ready(shown) {
  if (made.size >= MOST_MADE) made.clear();
  made.add(shown);
  return shown;
}

/**
 * The language to show: the one asked for, else the first of the reader's that there is, else English.
 * @param {readonly string[]} codes that there are @param {string|null} wanted @param {readonly string[]} readers
 */
export function chosen(codes, wanted, readers = []) {
  for (const asked of [wanted ?? '', ...readers]) {
    const short = asked.toLowerCase().split('-')[0];
    if (codes.includes(short)) return short;
  }
  return 'en';
}

const json = async (path) => {
  const answer = await fetch(below(path), { cache: 'no-cache', signal: AbortSignal.timeout(3000) });
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.json();
};

/** The languages of this gateway. @returns {Promise<{code: string, name: string, direction: string, pages: boolean}[]>} */
export const languages = async () => (await json('/api/languages')).languages;

let [loads, newest] = [0, 0]; // how often a language was asked for, and which of these is shown

/** Shows the page in this language, unless one that was asked for later is shown already. @param {string} wanted its code */
export async function load(wanted) {
  loads += 1;
  const mine = loads;
  const found = await json(`/api/languages/${wanted}`);
  if (mine < newest) return;
  newest = mine;
  use(wanted, wanted === 'en' && Object.keys(found.texts).every((key) => key.includes('|')) ? ENGLISH : found);
  document.documentElement.lang = wanted;
  document.documentElement.dir = catalogue.direction;
}

const KEY = 'gateway.language';
export const choice = () => remembered(KEY);
export const choose = (wanted) => remember(KEY, wanted);
