// Where the readings of a teach-in lie in their plot. Pure.

import { known } from '../lib/format.js';

/** Room of the plot, in the units of its view box. */
export const WIDTH = 600;
export const HEIGHT = 150;
const EDGE = 8;

/**
 * Scales that hold every reading and every line, with some room.
 * @param {(number|null)[]} values @param {number[]} lines @param {number} seconds
 */
export function scales(values, lines, seconds) {
  const all = [...values, ...lines].filter(known);
  const [low, high] = all.length ? [Math.min(...all), Math.max(...all)] : [0, 1];
  const room = Math.max((high - low) * 0.12, Math.abs(high) * 0.002, 1e-6);
  return {
    x: (s) => EDGE + ((WIDTH - 2 * EDGE) * s) / Math.max(seconds, 1e-6),
    y: (value) => EDGE + ((HEIGHT - 2 * EDGE) * (high + room - value)) / (high - low + 2 * room),
  };
}

/** One path of dots: a stroke of no length with round ends, for each reading that is known. */
export function dots(times, values, { x, y }) {
  return values.map((value, n) => (known(value) ? `M${x(times[n]).toFixed(1)} ${y(value).toFixed(1)}h0` : '')).join('');
}
