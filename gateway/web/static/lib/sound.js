// The driver's sounds. They add to the sign and say nothing that it does not; silence never means "go on".

/**
 * @typedef {{hz: number[], lengthMs: number, everyMs: number|null}} Pattern tones one after the other; null: once
 */

const NEAR_MS = 160;
const MS_PER_MM = 1.6;

/**
 * What sounds with a sign. Pure.
 * @param {import('./guidance.js').Code} code @param {string} kind @param {number|null} toGoMm @param {boolean} moves
 * @returns {Pattern|null} null: nothing
 */
export function pattern(code, kind, toGoMm, moves) {
  if (code === 'BRAKE') return { hz: [1000, 700, 1000, 700, 1000, 700], lengthMs: 120, everyMs: 940 };
  if (kind === 'halt') return { hz: [440, 440], lengthMs: 350, everyMs: moves ? 1000 : null };
  if (code === 'OK') return { hz: [660, 880, 1100], lengthMs: 140, everyMs: null };
  if (code === 'SLOW') return { hz: [880], lengthMs: 70, everyMs: Math.round(Math.min(1200, NEAR_MS + MS_PER_MM * Math.max(0, toGoMm ?? 600))) };
  if (kind === 'go' || kind === 'care') return { hz: [880], lengthMs: 120, everyMs: null };
  return null;
}

/**
 * One tone. @param {AudioContext} audio @param {number} hz @param {number} fromS from now @param {number} lengthS
 * @param {{loud: number, fades: boolean}} how
 */
export function tone(audio, hz, fromS, lengthS, { loud, fades }) {
  const [source, gain] = [audio.createOscillator(), audio.createGain()];
  const from = audio.currentTime + fromS;
  source.frequency.value = hz;
  if (fades) {
    gain.gain.setValueAtTime(loud, from);
    gain.gain.linearRampToValueAtTime(0, from + lengthS);
  } else gain.gain.value = loud;
  source.connect(gain).connect(audio.destination);
  source.start(from);
  source.stop(from + lengthS);
}

/**
 * Can it be heard? Browsers keep a page silent until somebody clicks in it, unless they are told otherwise; tones that
 * were begun meanwhile would all sound then. @param {AudioContext|null} audio
 */
export const audible = (audio) => audio !== null && audio.state === 'running';

/** Asks the browser, now and with each click, until `end` is aborted. @param {AudioContext} audio @param {AbortSignal} end */
export function allow(audio, end) {
  const resume = () => audio.resume().catch(() => {});
  resume();
  addEventListener('click', resume, { signal: end });
}

export class Sound {
  /** @type {AudioContext|null} */
  #audio = null;
  #end = new AbortController();
  #last = '';
  #nextMs = 0;

  /** @param {() => void} changed called when `on` may have changed */
  start(changed) {
    if (this.#audio !== null) return;
    this.#audio = new AudioContext();
    this.#end = new AbortController();
    this.#audio.addEventListener('statechange', changed, { signal: this.#end.signal });
    allow(this.#audio, this.#end.signal);
  }

  stop() {
    this.#end.abort();
    this.#audio?.close().catch(() => {});
    [this.#audio, this.#last] = [null, ''];
  }

  /** False also while the browser keeps it silent. */
  get on() {
    return audible(this.#audio);
  }

  /** @param {string} sign changes: it sounds at once @param {Pattern|null} what @param {number} nowMs */
  play(sign, what, nowMs) {
    const audio = this.#audio;
    if (audio === null || !audible(audio)) return;
    const changed = sign !== this.#last;
    this.#last = sign;
    if (what === null || (!changed && (what.everyMs === null || nowMs < this.#nextMs))) return;
    this.#nextMs = nowMs + (what.everyMs ?? 0);
    const lengthS = what.lengthMs / 1000;
    for (const [n, hz] of what.hz.entries()) tone(audio, hz, n * 1.3 * lengthS, lengthS, { loud: 0.4, fades: true });
  }
}
