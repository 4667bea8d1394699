// What the trend shows: a bounded row of samples, with a gap wherever nothing was known. Pure.

import { known } from './format.js';

/** Without a sample for longer than this, the line is broken. */
export const GAP_S = 1.0;
const MOST_S = 600;
const PER_S = 10;

/**
 * @typedef {object} Sample
 * @property {number|null} radius_px @property {number|null} distance_mm
 * @property {boolean|null} stop @property {boolean|null} in_place @property {boolean|null} may_move
 */

export class Series {
  constructor(mostS = MOST_S, perS = PER_S) {
    this.mostS = mostS;
    this.apartS = 0.9 / perS; // samples that come faster are left out
    this.clear();
  }

  clear() {
    /** @type {{t: number[], radius: (number|null)[], distance: (number|null)[], stop: (boolean|null)[], in_place: (boolean|null)[], may_move: (boolean|null)[]}} */
    this.row = { t: [], radius: [], distance: [], stop: [], in_place: [], may_move: [] };
  }

  /** @param {number} tS never goes back @param {Sample} sample */
  add(tS, sample) {
    const { t } = this.row;
    const last = t[t.length - 1];
    if (last !== undefined) {
      const changed =
        sample.stop !== this.row.stop[t.length - 1] || known(sample.radius_px) !== known(this.row.radius[t.length - 1]);
      if (tS <= last || (tS - last < this.apartS && !changed)) return;
      if (tS - last > GAP_S) this._push(last + GAP_S / 2, null);
    }
    this._push(tS, sample);
    let old = 0;
    while (old < t.length && t[old] < tS - this.mostS) old += 1;
    // Moving the arrays costs as much for one as for many.
    if (old > 100) for (const column of Object.values(this.row)) column.splice(0, old);
  }

  _push(tS, sample) {
    const { t, radius, distance, stop, in_place, may_move } = this.row;
    t.push(tS);
    radius.push(known(sample?.radius_px) ? sample.radius_px : null);
    distance.push(known(sample?.distance_mm) ? sample.distance_mm : null);
    stop.push(sample?.stop ?? null);
    in_place.push(sample?.in_place ?? null);
    may_move.push(sample?.may_move ?? null);
  }

  /** Stretches of the same value, for a strip: from, to, value; null ones are left out. @param {'stop'|'in_place'|'may_move'} name */
  stretches(name, fromS, toS) {
    const { t } = this.row;
    const values = this.row[name];
    const out = /** @type {{from: number, to: number, value: boolean}[]} */ ([]);
    for (let n = 0; n < t.length; n += 1) {
      const value = values[n];
      if (value === null) continue;
      const from = Math.max(fromS, t[n]);
      const to = Math.min(toS, t[n + 1] ?? Math.min(toS, t[n] + GAP_S));
      if (to <= from) continue;
      const last = out[out.length - 1];
      if (last && last.value === value && last.to >= from - 1e-9) last.to = to;
      else out.push({ from, to, value });
    }
    return out;
  }

  /** Largest of what the window shows; null: nothing. @param {'radius'|'distance'} name */
  most(name, fromS) {
    let most = null;
    for (let n = this.row.t.length - 1; n >= 0 && this.row.t[n] >= fromS; n -= 1) {
      const value = this.row[name][n];
      if (value !== null && (most === null || value > most)) most = value;
    }
    return most;
  }
}
