// Values as people read them. Pure: no clock, no page.

import { offset, wall } from './zone.js';

/** What stands where there is no value: never 0, never the last good one. */
export const NONE = '–';

const MINUS = '\u2212';
const MM_PER_INCH = 25.4;
const NARROW = '\u202f'; // no break between groups of digits, nor between number and unit

/** @param {unknown} value @returns {value is number} */
export const known = (value) => typeof value === 'number' && Number.isFinite(value);

/**
 * A number with a fixed count of decimals; thousands in groups.
 * @param {number|null|undefined} value @param {number} decimals @param {string} unit
 */
export function number(value, decimals = 0, unit = '') {
  if (!known(value)) return NONE;
  const digits = Math.abs(value).toFixed(decimals);
  const sign = value < 0 && Number(digits) !== 0 ? MINUS : '';
  const [whole, rest] = digits.split('.');
  const grouped = whole.length > 4 ? whole.replace(/\B(?=(\d{3})+$)/g, NARROW) : whole;
  return sign + grouped + (rest ? `.${rest}` : '') + (unit ? NARROW + unit : '');
}

export const px = (value, decimals = 1) => number(value, decimals, 'px');
export const hz = (value) => number(value, 1, 'Hz');

/** A number that may go either way: always with its sign. */
export function signed(value, decimals = 0, unit = '') {
  const text = number(value, decimals, unit);
  return known(value) && value > 0 && !/^[0.]+$/.test(value.toFixed(decimals)) ? `+${text}` : text;
}

/** A time that has passed, from milliseconds to days. @param {number|null|undefined} ms */
export function age(ms) {
  if (!known(ms)) return NONE;
  const t = Math.max(0, ms);
  if (t < 999.5) return number(t, 0, 'ms');
  if (t < 59_950) return number(t / 1000, 1, 's');
  const s = Math.round(t / 1000);
  if (s < 3600) return `${Math.floor(s / 60)}${NARROW}min ${s % 60}${NARROW}s`;
  const min = Math.floor(s / 60);
  if (min < 60 * 48) return `${Math.floor(min / 60)}${NARROW}h ${min % 60}${NARROW}min`;
  return `${Math.floor(min / 1440)}${NARROW}d`;
}

/** Fewer than these tell little of the others: their figures are grey, with their number. */
const FEW = 10;
/** @param {number|null|undefined} n how many there were */
export const scarce = (n) => known(n) && n < FEW;

/** To the nearest whole; 12 345 -> "12 345". */
export const count = (value) => number(value, 0);

/** Unix ms as the time of day in the pages' zone; on request with the date. */
export function clock(unixMs, { date = false, ms = false } = {}) {
  if (!known(unixMs)) return NONE;
  const text = wall(unixMs).toISOString().replace('T', ' ');
  return text.slice(date ? 0 : 11, ms ? 23 : 19);
}

/** Date and time; with the offset where it is another than now, as the page names it. */
export function stamp(unixMs, { ms = false, nowMs = Date.now() } = {}) {
  const from = known(unixMs) ? offset(unixMs) : '';
  return clock(unixMs, { date: true, ms }) + (from && from !== offset(nowMs) ? ` ${from}` : '');
}

/** Time of day; with its date where that is not the day of `nowMs`. */
export const moment = (unixMs, { ms = false, nowMs = Date.now() } = {}) => clock(unixMs, { ms, date: day(unixMs) !== day(nowMs) });

/** Unix ms as the day in the pages' zone. */
export const day = (unixMs) => (known(unixMs) ? clock(unixMs, { date: true }).slice(0, 10) : NONE);

/** A share as a percentage. */
export const percent = (share, decimals = 0) => number(known(share) ? 100 * share : null, decimals, '%');

/** A name of the wire (NO_TARGET, stop_raised) as words. @param {string} name */
export const words = (name) => String(name ?? '').toLowerCase().replaceAll('_', ' ');

/**
 * The distance a driver reads: metres from 1 m on, feet from 3 ft on; steps that do not flicker.
 * @param {number|null} value in mm @param {string} units metric or imperial @returns {[string, string]} number, unit
 */
export function driverDistance(value, units = 'metric') {
  if (!known(value)) return [NONE, ''];
  const t = Math.abs(value);
  if (units === 'imperial') {
    const inches = t / MM_PER_INCH;
    return inches >= 35.5 ? [number(Math.round(inches / 12 / 0.2) * 0.2, 1), 'ft'] : [number(inches, 0), 'in'];
  }
  if (t >= 995) return [number(Math.round(t / 50) / 20, 2), 'm'];
  return [number(Math.round(t / 10), 0), 'cm'];
}

/** @param {number|null} value in mm/s @returns {[string, string]} number, unit */
export function driverSpeed(value, units = 'metric') {
  if (!known(value)) return [NONE, ''];
  return units === 'imperial' ? [number(Math.abs(value) / MM_PER_INCH, 0), 'in/s'] : [number(Math.abs(value) / 10, 0), 'cm/s'];
}
