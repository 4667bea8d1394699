// What a guidance code means to a display: which way, how urgent, what to show beside it. Pure.

import { known } from './format.js';

/** @typedef {'WAIT'|'FORWARD'|'BACK'|'LEFT'|'RIGHT'|'SLOW'|'STOP'|'OK'|'TOO_FAR'|'FAULT'|'LEAVE'|'DRIVE_UP'|'BRAKE'} Code */

/**
 * `kind` colours the display: go, care, halt, wait, done. `drives`: the truck is told to come nearer or to leave, which
 * no code does while stop is on. BACK does not: a truck that stands too far in goes back under stop.
 * @type {Record<Code, {kind: 'go'|'care'|'halt'|'wait'|'done', symbol: string, drives: boolean}>}
 */
export const CODES = {
  WAIT: { kind: 'wait', symbol: 'pause', drives: false },
  FORWARD: { kind: 'go', symbol: 'up', drives: true },
  BACK: { kind: 'care', symbol: 'down', drives: false },
  LEFT: { kind: 'go', symbol: 'left', drives: true },
  RIGHT: { kind: 'go', symbol: 'right', drives: true },
  SLOW: { kind: 'care', symbol: 'slow', drives: true },
  STOP: { kind: 'halt', symbol: 'stop', drives: false },
  OK: { kind: 'done', symbol: 'tick', drives: false },
  TOO_FAR: { kind: 'halt', symbol: 'stop', drives: false },
  FAULT: { kind: 'halt', symbol: 'stop', drives: false },
  LEAVE: { kind: 'go', symbol: 'leave', drives: true },
  DRIVE_UP: { kind: 'go', symbol: 'ahead', drives: true },
  BRAKE: { kind: 'halt', symbol: 'brake', drives: false },
};

/**
 * @typedef {object} DriverView
 * @property {string} bay @property {string} [title] of the bay @property {Code} code @property {string} text @property {boolean} stop
 * @property {number|null} amount_mm @property {number|null} closing_mm_s @property {number|null} to_go_mm
 * @property {number} age_ms @property {number} [held_ms] @property {string|null} [language] the PLC's recipe wants it
 */

/**
 * A message of the driver's link, or null where it makes no sense: the display then says STOP.
 * @param {string} text @param {string|null} bay that was asked for; null: whichever the server shows
 * @returns {DriverView|null}
 */
export function driverView(text, bay) {
  let message;
  try {
    message = JSON.parse(text);
  } catch {
    return null;
  }
  const number = (value) => value === null || known(value);
  const whole =
    message !== null &&
    typeof message === 'object' &&
    typeof message.bay === 'string' &&
    (bay === null || message.bay === bay) &&
    Object.hasOwn(CODES, message.code) &&
    typeof message.stop === 'boolean' &&
    known(message.age_ms) &&
    message.age_ms >= 0 &&
    (message.language == null || typeof message.language === 'string') &&
    [message.amount_mm, message.closing_mm_s, message.to_go_mm].every(number);
  if (!whole || (message.stop && CODES[message.code].drives)) return null;
  return message;
}

/** The word of a code, as a key of the language's texts. A fault is shown as STOP. @param {Code} code */
export const wordOf = (code) => `driver|${code === 'FAULT' ? 'STOP' : code.replaceAll('_', ' ')}`;

/** Codes whose amount the driver needs to see; beside the others it would only be noise. */
export const WITH_AMOUNT = ['FORWARD', 'SLOW', 'BACK', 'TOO_FAR', 'LEFT', 'RIGHT'];

const COLUMN_MM = 3000;
const PAST_MM = 500;

/**
 * The distance column, as shares of its height from its foot: the stopping place, and how far the truck is.
 * @param {number|null} toGoMm
 */
export function column(toGoMm) {
  const line = COLUMN_MM / (COLUMN_MM + PAST_MM);
  if (!known(toGoMm)) return { line, at: null, past: false };
  const at = (COLUMN_MM - Math.min(COLUMN_MM, Math.max(-PAST_MM, toGoMm))) / (COLUMN_MM + PAST_MM);
  return { line, at, past: toGoMm < 0 };
}
