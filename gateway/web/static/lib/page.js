// What the pages for desks are written with: Preact, whose texts appear in the viewer's language.
//
// Each text of an element, and each attribute that people read, is looked up in the language's file as it is drawn: as it
// stands, then with its values as {0}, {1} (of plural forms that of the first value), then part by part. What is not found
// stays English.
// Nothing is looked up where a page is English.
// Texts that are somebody's own (names, notes) stand in an element with `translate="no"` of the same template.

import * as preact from '../vendor/preact-htm.js';
import { below } from './address.js';
import { catalogued, choice, chosen, isMade, languages, load, missed } from './lang.js';

export { createContext, h, render, useCallback, useContext, useEffect, useErrorBoundary, useLayoutEffect, useMemo, useReducer, useRef, useState } from '../vendor/preact-htm.js';

const READ = ['aria-label', 'title', 'placeholder', 'alt', 'aria-valuetext', 'aria-description', 'data-name']; // data-name: shown beside the value on narrow screens
// A value as lib/format.js writes it: a time with its date, a number with its unit (joined by a narrow space), or none.
const VALUE = /\d+\u202f(?:min|h) \d+\u202f(?:s|min)|\d{4}-\d\d-\d\d(?: \d\d:\d\d(?::\d\d(?:\.\d+)?)?)?(?: [+-]\d\d:\d\d)?|[+\u2212-]?\d+(?:[.,:\u202f]\d+)*(?:e[+-]?\d+)?(?:\u202f[^\s\d.,;)]+)*|(?<!\S)\u2013(?!\S)/g;
const UNITS = /(?<![\p{L}\d])(?:[mcdk]?m|px|in|ft|[mµ]?s|min|Hz|dB|MB|MiB|GiB)(?![\p{L}\d])/gu;
const WORD = /\p{L}{2}/u; // what has no word is a value
const NAME = /^[\w./:-]*(?:[\d_]|\w[./:]\w)[\w./:-]*$/; // of a bay, a key, a file: bay1, state_dir, camera.url
const SHORT_NAME = /^[A-Za-z]{1,2}$/; // of a parameter (fx), where it is a part of a text
const PARTS = ['; ', ': ']; // between the parts of the gateway's own texts

/** A text in the viewer's language. @param {string} text */
export function translated(text) {
  const inner = text.trim();
  if (inner === '' || catalogued('') === undefined || isMade(inner) || isMade(text)) return text;
  const found = whole(inner) ?? inParts(inner);
  if (found === null) {
    missed(keyOf(inner));
    return text;
  }
  return text.replace(inner, () => found);
}

/** A text as the key of the language's file: its values are {0}, {1}. @param {string} text */
function keyOf(text) {
  let n = 0;
  return text.replace(VALUE, () => `{${n++}}`);
}

/** @param {string} text @returns {string|null} null: the language's file does not have it */
function whole(text) {
  const found = catalogued(text);
  if (typeof found === 'string') return found;
  if (NAME.test(text) || !WORD.test(text.replace(UNITS, ''))) return text;
  const numbers = text.match(VALUE) ?? [];
  const made = numbers.length ? catalogued(keyOf(text), parseFloat(numbers[0].replaceAll('\u202f', ''))) : null;
  return made?.replace(/\{(\d+)\}/g, (all, at) => numbers[Number(at)] ?? all) ?? null;
}

/**
 * A text of several, which the language's file has or which are names; what the gateway's own text says of something else
 * ("no camera fits: ...") stays as it is. Null: it is none. @param {string} text @returns {string|null}
 */
function inParts(text) {
  for (const between of PARTS) {
    const parts = text.split(between);
    if (parts.length === 1) continue;
    const found = parts.map((part) => whole(part) ?? inParts(part) ?? (SHORT_NAME.test(part) ? part : null));
    if (found[0] === null || (between === '; ' && found.includes(null))) return null;
    return found.map((one, n) => {
      if (one === null) missed(keyOf(parts[n]));
      return one ?? parts[n];
    }).join(between);
  }
  return null;
}

const DONE = Symbol('translated');

function walk(node) {
  if (Array.isArray(node)) return node.map(walk);
  if (node === null || typeof node !== 'object' || node.props === undefined || node[DONE]) return node;
  node[DONE] = true;
  const { type, props } = node;
  const own = typeof type === 'string';
  if (own && props.translate === 'no') return node;
  if (own) for (const name of READ) if (typeof props[name] === 'string') props[name] = translated(props[name]);
  if (props.children !== undefined) props.children = of(props.children, own);
  return node;
}

/** @param {any} children @param {boolean} own of an element: a component's texts are translated where it draws them */
const of = (children, own) =>
  Array.isArray(children) ? children.map((child) => of(child, own)) : typeof children === 'string' ? (own ? translated(children) : children) : walk(children);

const PLACED = Symbol('placed');
const ADDRESSES = ['href', 'src', 'action'];

/** The gateway's addresses in elements, as the browser reaches them. */
function placed(node) {
  if (Array.isArray(node)) for (const one of node) placed(one);
  else if (node !== null && typeof node === 'object' && node.props !== undefined && !node[PLACED]) {
    node[PLACED] = true;
    for (const name of ADDRESSES) if (typeof node.type === 'string' && String(node.props[name]).startsWith('/')) node.props[name] = below(node.props[name]);
    placed(node.props.children);
  }
  return node;
}

/** @type {typeof preact.html} */
export const html = (strings, ...values) => {
  const made = preact.html(strings, ...values);
  if (below('') !== '') placed(made);
  return catalogued('') === undefined ? made : walk(made);
};

/** The languages of these pages. @type {{code: string, name: string}[]} */
export let offered = [];

// Before a page that imports this draws anything. (The scripts' own tests have no document.)
if (typeof document !== 'undefined') {
  try {
    offered = (await languages()).filter(({ pages, code }) => pages || code === 'en');
    await load(chosen(offered.map(({ code }) => code), new URLSearchParams(location.search).get('lang') ?? choice(), navigator.languages));
  } catch {
    // It stays English: that a page works does not depend on its language.
  }
}
