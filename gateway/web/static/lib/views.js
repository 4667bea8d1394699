// The JSON of the server as the pages use it: one place that knows its field names. Pure.

import { NONE, age, count, day, known, number, percent, signed, words } from './format.js';
import { listed, t, text } from './lang.js';
import { saidText } from './said.js';
import { inUnit, lengthUnit } from './units.js';

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

/**
 * Thresholds of a bay as they are in force. @returns {{radius_threshold_px: number, distance_threshold_mm: number,
 * radius_hysteresis_px: number, distance_hysteresis_mm: number}}
 */
export function limitsOf(bay) {
  const { radius_threshold_px, distance_threshold_mm, radius_hysteresis_px, distance_hysteresis_mm } = bay.thresholds;
  return { radius_threshold_px, distance_threshold_mm, radius_hysteresis_px, distance_hysteresis_mm };
}

/** Where the marker should be. @returns {{u_px: number|null, v_px: number|null, tolerance_px: number|null}} */
export function aimOf(bay) {
  const { u_px, v_px, tolerance_px } = bay.aim;
  return { u_px, v_px, tolerance_px };
}

const VISION_FINE = ['GOOD', 'NO_TARGET', 'COASTED', 'WAITING'];
const RANGE_FINE = ['GOOD', 'WAITING'];
const RANGE_EMPTY = ['NO_ECHO', 'TOO_FAR']; // right, where no marker is in sight, or a truck arrives from far off

/** Is the camera side in order? @returns {'ok'|'off'|'bad'} */
export function visionHealth(state) {
  const { name } = state.vision.quality;
  return name === 'WAITING' ? 'off' : VISION_FINE.includes(name) ? 'ok' : 'bad';
}

/** Why there may be no picture, in words; empty: nothing is wrong with the camera, or nothing known. */
export function cameraFault(state) {
  if (state === null || visionHealth(state) !== 'bad') return '';
  const { quality } = state.vision;
  const detail = saidText(state.vision);
  return detail ? listed([t(words(quality.name)), detail], ': ') : words(quality.name);
}

/** Of the picture itself, whatever is in it. @returns {{state: 'ok'|'off'|'warn', text: string}} */
export function pictureHealth(state) {
  const { picture } = state;
  if (!picture) return { state: 'off', text: 'not known' };
  const faults = picture.faults.map((name) => t(words(name)));
  return faults.length ? { state: 'warn', text: listed(faults, ', ') } : { state: 'ok', text: 'in order' };
}

/** @returns {'ok'|'off'|'warn'|'bad'} */
export function rangeHealth(state) {
  const { name } = state.range.quality;
  if (name === 'WAITING') return 'off';
  if (RANGE_FINE.includes(name)) return 'ok';
  if (RANGE_EMPTY.includes(name)) return state.vision.quality.name === 'NO_TARGET' || state.may_move ? 'ok' : 'warn';
  return name === 'UNSTABLE' || name === 'TOO_NEAR' ? 'warn' : 'bad';
}

/** @returns {'ok'|'off'|'bad'} */
export function plcHealth(state) {
  return { UNUSED: 'off', WAITING: 'off', ALIVE: 'ok' }[state.plc.link] ?? 'bad';
}

const NE107_ORDER = ['FAILURE', 'FUNCTION_CHECK', 'OUT_OF_SPECIFICATION', 'MAINTENANCE_REQUIRED', 'GOOD'];

/** How much a bay needs looking at: 0 most. @param {any} state null: nothing known @param {number} alarms that stand */
export function urgency(state, alarms = 0) {
  if (state === null) return 0;
  const at = NE107_ORDER.indexOf(state.ne107.name);
  return Math.min(at + 1, alarms > 0 ? 3.5 : Infinity); // a signal that this page does not know counts most
}

/** Those in trouble first, then by name as people count (bay2 before bay10). @param {{name: string, rank: number}[]} bays */
export function inOrder(bays) {
  const names = new Intl.Collator('en', { numeric: true });
  return [...bays].sort((a, b) => a.rank - b.rank || names.compare(a.name, b.name));
}

/** What the decision is called. @param {any} state null: not known */
export function decisionWords(state) {
  if (state === null) return 'NOT KNOWN';
  if (state.stop) return state.in_place ? 'IN PLACE' : 'STOP';
  return state.may_move ? 'MAY MOVE' : 'NO STOP, MAY NOT MOVE';
}

/** Is a truck in place? That alone is a condition for loading. @param {any} state null: not known */
export function placeWords(state) {
  if (state === null) return NONE;
  if (!state.in_place) return 'no';
  return state.held ? text('yes, held {0}', age(state.held_ms)) : text('yes, seen {0}', age(state.in_place_ms));
}

const MOVED = { NO: 'no', DISTANCE: 'yes, by distance', MARKER: 'yes, marker elsewhere' };

/** Has the truck moved since it was in place? @param {any} state null: not known */
export const movedWords = (state) => (state === null ? NONE : state.rolling ? 'rolls now' : MOVED[state.moved] ?? 'yes');

/** What was learned of R times Z; null: nothing yet. @returns {{value: string, rest: string, jump: string}|null} */
export function scaleWords(scale) {
  if (!scale || !known(scale.px_mm)) return null;
  return {
    value: number(inUnit(scale.px_mm), 0, `px ${lengthUnit()}`),
    rest: `spread ${percent(scale.spread, 1)}, ${count(scale.visits)} visits, newest ${day(scale.newest_ms)}`,
    jump: known(scale.jump) ? `newest differs by ${signed(100 * scale.jump, 0, '%')}` : '',
  };
}

/** States of ISA-18.2 in which an alarm waits for somebody to take notice. */
export const TO_ACKNOWLEDGE = ['unacknowledged', 'returned', 'latched_unacknowledged'];

/** An alarm's priority as a number, as its sign shows it. */
export const LEVELS = { high: 3, medium: 2, low: 1 };

/** Alarms of a bay that an operator looks at: none that is normal, or put away on purpose. */
export const standing = (alarm) => !['normal', 'shelved', 'suppressed', 'out_of_service'].includes(alarm.state);

/** May this visitor acknowledge? It needs a login, unless everybody is a technician. */
export const mayAcknowledge = (session) =>
  session.role === 'technician' || (session.role === 'viewer' && session.name !== null);

/** How many alarms there are, each form a text of its own. @param {number} all @param {number} open not acknowledged */
export function alarmCount(all, open) {
  if (all === 1) return open ? '1 alarm, not acknowledged' : '1 alarm';
  return open ? `${all} alarms, ${open} not acknowledged` : `${all} alarms`;
}
