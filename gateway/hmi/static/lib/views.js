// The JSON of the server as the pages use it: one place that knows its field names. Pure.

import { known } from './format.js';

/**
 * What was seen in one frame, px of that frame.
 * @typedef {object} FrameView
 * @property {{u: number, v: number, radius: number}|null} circle
 * @property {{u: number, v: number, major: number, minor: number, angle: number}|null} ellipse
 * @property {{u: number, v: number, radius: number}|null} predicted not measured: where it should be
 * @property {string} quality
 */

const circleOf = (raw) =>
  raw && [raw.u, raw.v, raw.radius_px].every(known) ? { u: raw.u, v: raw.v, radius: raw.radius_px } : null;

/** @returns {FrameView} */
export function frameView(raw) {
  const rim = raw.ellipse;
  const whole = rim && [rim.u, rim.v, rim.semi_major_px, rim.semi_minor_px, rim.angle_rad].every(known);
  return {
    circle: circleOf(raw.circle),
    ellipse: whole
      ? { u: rim.u, v: rim.v, major: Math.max(0, rim.semi_major_px), minor: Math.max(0, rim.semi_minor_px), angle: rim.angle_rad }
      : null,
    predicted: circleOf(raw.predicted),
    quality: String(raw.quality ?? ''),
  };
}

/** Size of a frame from `X-Frame-Size`, "640x480"; null where it makes no sense. @param {string|null} text */
export function frameSize(text) {
  const found = /^(\d{1,5})x(\d{1,5})$/.exec(text ?? '');
  const [width, height] = found ? [Number(found[1]), Number(found[2])] : [0, 0];
  return width > 0 && height > 0 ? { width, height } : null;
}
