// How old is what the page shows? One rule for every page. Pure: the two clocks are an argument.
//
// The age of an answer is what its sender said plus what has passed since the page asked for it: it can't have been made
// before, so one that was long on its way is never taken for a new one. Only the time for which the sender says it held
// the question does not count. No clock of the gateway's is asked. `performance.now()` is not moved by people, but
// stands still on some machines while they sleep; the wall clock runs on, but may be set. So both are asked: they must
// have gone forward by the same amount, or nothing is known until the next answer.

/** Older than this, nothing is shown as if it were true, ms: on pages for desks; what comes once a second, such as all bays; to a driver. */
export const [LIMIT_MS, OVERVIEW_LIMIT_MS, DRIVER_LIMIT_MS] = [1500, 3000, 500];

/** How far the two clocks may drift apart between two answers, ms. */
const DRIFT_MS = 250;

/** @typedef {{steadyMs: number, wallMs: number}} Moment */

/** @returns {Moment} now */
export const moment = () => ({ steadyMs: performance.now(), wallMs: Date.now() });

/** ms from one moment to another; Infinity: the clocks do not agree. @param {Moment} from @param {Moment} to */
function passedMs(from, to) {
  const [steady, wall] = [to.steadyMs - from.steadyMs, to.wallMs - from.wallMs];
  return steady >= 0 && Math.abs(steady - wall) <= DRIFT_MS ? Math.max(steady, wall) : Infinity;
}

export class Freshness {
  /** @param {number} limitMs older than this is stale */
  constructor(limitMs) {
    this.limitMs = limitMs;
    /** @type {{ageMs: number, at: Moment}|null} */
    this.last = null;
    /** Since when it has been fresh without a break. @type {Moment|null} */
    this.since = null;
  }

  /**
   * An answer came `now` that was asked for at `asked`. `sentAgeMs`: its age when it was sent; `heldMs`: how long the sender
   * held the question. @param {number} sentAgeMs @param {Moment} asked @param {Moment} now
   */
  received(sentAgeMs, asked, now, heldMs = 0) {
    if (!this.fresh(now)) this.since = null;
    const wayMs = passedMs(asked, now);
    const held = Number.isFinite(heldMs) ? Math.min(Math.max(0, heldMs), wayMs) : 0;
    const makesSense = Number.isFinite(sentAgeMs) && sentAgeMs >= 0 && Number.isFinite(wayMs);
    this.last = makesSense ? { ageMs: sentAgeMs + wayMs - held, at: now } : null;
    this.since = this.fresh(now) ? this.since ?? now : null;
  }

  /** Nothing is known until the next answer: the link is lost, or an answer made no sense. */
  forget() {
    this.last = this.since = null;
  }

  /** Age of the answer, ms; Infinity: nothing is known. @param {Moment} now */
  ageMs(now) {
    const ageMs = this.last === null ? Infinity : this.last.ageMs + passedMs(this.last.at, now);
    if (ageMs === Infinity) this.forget();
    return ageMs;
  }

  /** Is a part of the answer that was `partMs` old when it was sent still true? @param {Moment} now @param {number|null} [partMs] null: not known */
  fresh(now, partMs = 0) {
    return Number.isFinite(partMs) && this.ageMs(now) + /** @type {number} */ (partMs) <= this.limitMs;
  }

  /** For how long it has been fresh without a break, ms. @param {Moment} now */
  freshForMs(now) {
    return this.fresh(now) && this.since !== null ? passedMs(this.since, now) : 0;
  }
}
