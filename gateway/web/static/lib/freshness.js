// How old is what the page shows? Pure: both clocks are arguments.
//
// The age of a message is what its sender said plus what has passed since. `performance.now()` is not moved by people,
// but stands still on some machines while they sleep; the wall clock runs on, but may be set. So both are asked: they
// must have gone forward by the same amount, or nothing is known until the next message.

/** How far the two clocks may drift apart between two messages, ms. */
const DRIFT_MS = 250;

export class Freshness {
  /** @param {number} limitMs older than this is stale @param {number} driftMs */
  constructor(limitMs, driftMs = DRIFT_MS) {
    this.limitMs = limitMs;
    this.driftMs = driftMs;
    /** @type {{sentAgeMs: number, steadyMs: number, wallMs: number}|null} */
    this.last = null;
  }

  /**
   * A message came. `sentAgeMs`: its age when it was sent; `askedMs`: steady time at which it was asked for, where that
   * is known: it can't have been sent before, so a message that was long on its way is never taken for a new one.
   * `heldMs`: how long the sender says it kept the question before it answered.
   * @param {number} sentAgeMs @param {number} steadyMs @param {number} wallMs
   */
  received(sentAgeMs, steadyMs, wallMs, askedMs = steadyMs, heldMs = 0) {
    if (![sentAgeMs, steadyMs, wallMs].every(Number.isFinite) || sentAgeMs < 0) {
      this.last = null;
      return;
    }
    const way = Math.max(0, steadyMs - askedMs);
    const held = Number.isFinite(heldMs) ? Math.min(Math.max(0, heldMs), way) : 0;
    this.last = { sentAgeMs: sentAgeMs + way - held, steadyMs, wallMs };
  }

  /** Nothing is known until the next message: the page was hidden, frozen, or a message made no sense. */
  forget() {
    this.last = null;
  }

  /** Age of what is shown, ms; Infinity: unknown. @param {number} steadyMs @param {number} wallMs */
  ageMs(steadyMs, wallMs) {
    if (this.last === null) return Infinity;
    const steady = steadyMs - this.last.steadyMs;
    const wall = wallMs - this.last.wallMs;
    if (!(steady >= 0) || !(Math.abs(steady - wall) <= this.driftMs)) {
      this.last = null;
      return Infinity;
    }
    return this.last.sentAgeMs + Math.max(steady, wall);
  }

  /** @param {number} steadyMs @param {number} wallMs */
  fresh(steadyMs, wallMs) {
    return this.ageMs(steadyMs, wallMs) <= this.limitMs;
  }
}
