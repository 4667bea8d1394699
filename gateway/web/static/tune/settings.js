// The settings as the page edits them: which keys there are comes from the gateway, with range, unit and meaning. Pure.

import { number } from '../lib/format.js';
import { text } from '../lib/lang.js';

/**
 * @typedef {object} Key one key of `[vision]`, as the gateway describes it
 * @property {string} name @property {'both'|'paper'|'robust'} belongs
 * @property {'choice'|'flag'|'whole'|'number'|'colour'|'rgb'} kind
 * @property {string} meaning @property {string} unit @property {any} default
 * @property {number|null} low @property {number|null} high @property {number|null} step @property {string[]} choices
 */

/** A key as people read it: `gaussian_kernel_px` -> `gaussian kernel`; its unit stands beside it. */
export function title(key) {
  const bare = key.unit ? key.name.replace(/_[a-z0-9]+$/, '') : key.name;
  return bare.replaceAll('_', ' ');
}

/** The groups in which the keys stand on the page, by method. The ranges of red have controls of their own. */
export function groups(schema) {
  const of = (belongs, test) => schema.filter((key) => key.belongs === belongs && test(key.name));
  const blur = (name) => /^(gaussian|morph)_/.test(name);
  const red = (name) => /^red_/.test(name);
  return {
    method: of('both', () => true),
    clean: of('paper', blur),
    gates: of('paper', (name) => !blur(name) && !red(name)),
    robust: of('robust', () => true),
  };
}

/** Are two values of a setting the same? Colours are lists. */
export const same = (a, b) => (Array.isArray(a) ? a.length === b?.length && a.every((n, i) => n === b[i]) : a === b);

/** The keys in which two settings differ, in the schema's order. */
export const differing = (schema, a, b) => schema.map((key) => key.name).filter((name) => !same(a[name], b[name]));

/** A draft when what is in force changes from `was` to `now`: keys that nobody has touched follow. */
export const followed = (draft, was, now) => Object.fromEntries(Object.entries(draft).map(([name, value]) => [name, same(value, was[name]) && name in now ? now[name] : value]));

/** How finely a slider moves: of shares, as finely as the default is given, and by hundredths at least. */
export function stepOf(key) {
  if (key.step) return key.step;
  const span = key.high - key.low;
  if (span > 1) return span <= 20 ? 0.05 : 1;
  return Math.min(0.01, 10 ** -decimals(key.default));
}

/** A range over many powers of ten is laid out by them. */
export const widely = (key) => key.high - key.low > 100_000;

/** A slider's place, 0 to 1000, for a value of a wide range; 0 for its lower end. */
export function placeOf(key, value) {
  const span = key.high - key.low;
  return Math.round((1000 * Math.log1p(Math.max(0, value - key.low))) / Math.log1p(span));
}

/** The value at a slider's place, to two digits. */
export function valueAt(key, place) {
  const raw = Math.expm1((place / 1000) * Math.log1p(key.high - key.low)) + key.low;
  if (raw < 1) return Math.round(raw * 10) / 10;
  const power = 10 ** (Math.floor(Math.log10(raw)) - 1);
  return Math.min(key.high, Math.round(Math.round(raw / power) * power));
}

/** What is typed, as a value of this key; null: not one. */
export function typed(key, text) {
  const value = Number(text.replace(',', '.')); // as on the settings page
  if (text.trim() === '' || !Number.isFinite(value) || value < key.low || value > key.high) return null;
  if (key.kind === 'whole' && (!Number.isInteger(value) || (value - key.low) % (key.step ?? 1) !== 0)) return null;
  return value;
}

/** The range of a key in the viewer's words. */
export const range = (key) => text(key.step === 2 ? '{0} to {1}, odd' : '{0} to {1}', number(key.low, decimals(key.low)), number(key.high, decimals(key.high)));

const decimals = (value) => String(value).split('.')[1]?.length ?? 0;

/** A number without 1e+8. */
export const plain = (value) => (Number.isInteger(value) ? value.toLocaleString('en', { useGrouping: false }) : String(value));

/** An HSV colour on the file's scale (H 0 to 180, S and V 0 to 255) as CSS. */
export function css([h, s, v]) {
  const part = (n) => {
    const k = (n + h / 30) % 6;
    return Math.round(v * (1 - (s / 255) * Math.max(0, Math.min(k, 4 - k, 1))));
  };
  return `rgb(${part(5)}, ${part(3)}, ${part(1)})`;
}

/** Is this text a colour as the file has it? */
export const isColour = (text) => /^#[0-9a-f]{6}$/i.test(text ?? '');

/** For `ref`: an element with this ground. @param {string} colour in CSS */
export const painted = (colour) => (/** @type {HTMLElement|null} */ element) => {
  if (element) element.style.backgroundColor = colour;
};

/** The limits of a colour's part, given the other corner, so that low never lies above high. */
export function partLimits(name, axis, settings) {
  const most = axis === 0 ? 180 : 255;
  const other = settings[name.replace(/_(low|high)_/, (_, side) => (side === 'low' ? '_high_' : '_low_'))][axis];
  return name.includes('_low_') ? [0, other] : [other, most];
}
