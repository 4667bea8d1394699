// Geometry of a bar that compares a value with its threshold. Pure.

import { known, number } from './format.js';

/** The next round number that is not smaller: 1, 1.5, 2, 2.5, 3, 4, 5, 6, 8 times a power of ten. */
export function nice(value) {
  if (!known(value) || value <= 0) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  const step = [1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10].find((n) => n * power >= value * (1 - 1e-9));
  return (step ?? 10) * power;
}

/** Round places for labels, 4 to 6 of them with both ends. @param {number} most @param {boolean} [whole] of what is counted */
export function ticks(most, whole = false) {
  const step = [1, 2, 2.5, 5, 10].map((n) => n * 10 ** Math.floor(Math.log10(most) - 0.7)).find((n) => most / n <= 6 && (!whole || Number.isInteger(n)));
  const out = [];
  for (let at = 0; at <= most * (1 + 1e-9); at += step) out.push(Math.round(at * 1000) / 1000);
  return out;
}

/** How many decimals these marks need so that each reads as what it is, 3 at most. @param {number[]} marks */
export function decimalsOf(marks) {
  for (let decimals = 0; decimals < 3; decimals += 1) if (marks.every((mark) => Math.abs(mark - Number(mark.toFixed(decimals))) < 1e-6 * Math.max(1, Math.abs(mark)))) return decimals;
  return 3;
}

/** The marks of an axis as they are written. @param {number[]} marks */
export const written = (marks) => marks.map((mark) => number(mark, decimalsOf(marks)));

/**
 * Where things stand on the bar, all as shares of its length, 0 to 1.
 *
 * `reachedAbove` true: the condition holds from the threshold upwards (R), else downwards (Z). The band is where the
 * condition, once it holds, goes on holding: from the threshold back by the hysteresis.
 * @param {{value: number|null, threshold: number, hysteresis?: number, reachedAbove: boolean, most: number}} bar
 */
export function barOf({ value, threshold, hysteresis = 0, reachedAbove, most }) {
  const share = (x) => Math.min(1, Math.max(0, x / most));
  const ends = reachedAbove ? [threshold - hysteresis, threshold] : [threshold, threshold + hysteresis];
  return {
    most,
    fill: known(value) ? share(value) : null,
    beyond: known(value) && value > most,
    mark: share(threshold),
    band: hysteresis > 0 ? ends.map(share) : null,
    zone: reachedAbove ? [share(threshold), 1] : [0, share(threshold)],
    reached: known(value) ? (reachedAbove ? value >= threshold : value <= threshold) : null,
    inBand: known(value) && hysteresis > 0 && value > ends[0] && value < ends[1],
  };
}
