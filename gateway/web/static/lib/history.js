// What was recorded, made ready to be drawn and read: windows of time, columns with gaps, words. Pure.

import { decoded } from './address.js';
import { NONE, clock, known, number, words } from './format.js';
import { listed, t, text } from './lang.js';
import { inUnit, lengthUnit, places } from './units.js';

const HOUR = 3_600_000;
/** Lengths of the timeline. @type {Record<string, {ms: number, word: string}>} */
export const SCALES = {
  quarter: { ms: HOUR / 4, word: '15 min' },
  hour: { ms: HOUR, word: 'hour' },
  shift: { ms: 8 * HOUR, word: '8 h' },
  day: { ms: 24 * HOUR, word: 'day' },
  month: { ms: 30 * 24 * HOUR, word: '30 days' },
};

/** The shortest that shows all that is recorded, a day at most: with it a page begins. @param {number} spanMs recorded @returns {string} */
export const firstScale = (spanMs) => Object.keys(SCALES).find((name) => name === 'day' || SCALES[name].ms >= spanMs) ?? 'day';

/** Reasons for stop that are no fault: the truck is where it should be, or nobody is there, or the gateway was told. */
const NORMAL = new Set(['none', 'target_reached', 'stop_latched', 'clearing', 'starting', 'no_target', 'target_coasted', 'range_too_far', 'no_echo', 'shutdown']);
/** Kinds of events that are marked on the timeline. */
export const MARKED = ['sensor_fault', 'plc_lost', 'rolling', 'moved', 'operator_mark', 'function_check_begun', 'settings_changed', 'alarm_action', 'pictures_not_kept', 'start', 'shutdown'];
export const BAD = new Set(['sensor_fault', 'plc_lost', 'rolling', 'moved']);

const USUAL = 'as usual';
/** A visit in which nothing was abnormal. */
export const usual = (visit) => verdict(visit) === USUAL;

const during = (visit, tMs) => tMs >= visit.begun_ms && tMs <= visit.begun_ms + 1000 * visit.length_s;

/** Is an event something abnormal? Where no PLC releases trucks, each one that leaves rolls and moves: its visit says whether it was to stand. */
export const abnormalEvent = (event, visits) =>
  ['rolling', 'moved'].includes(event.kind)
    ? visits.some((visit) => visit.unintended && during(visit, event.t_ms))
    : abnormal(event.kind);

/** Is a stop for this reason, or an event of this kind, something abnormal? */
export const abnormal = (name) => BAD.has(name) || !(NORMAL.has(name) || MARKED.includes(name));

/** For an input of kind datetime-local. */
export const inputTime = (unixMs) => clock(unixMs, { date: true }).replace(' ', 'T');

/**
 * The address of a moment, `bay/unix ms/scale`, and back; what does not fit is left out. `/why` behind it asks why.
 * @param {string} hash @param {string[]} bays
 */
export function placeOf(hash, bays) {
  const [bay, at, scale, why] = hash.replace(/^#/, '').split('/').map(decoded);
  const ms = Number(at);
  return {
    bay: bays.includes(bay) ? bay : bays[0] ?? null,
    atMs: at && Number.isSafeInteger(ms) && ms >= 0 && ms < 4_102_444_800_000 ? ms : null,
    scale: Object.hasOwn(SCALES, scale ?? '') ? scale : null,
    why: why === 'why',
  };
}

export const hashOf = ({ bay, atMs, scale, why }) => `#${[encodeURIComponent(bay), atMs, scale, ...(why ? ['why'] : [])].join('/')}`;

/** The window of this length round `atMs`, none of it later than `lastMs` unless the moment itself is. */
export function windowAt(atMs, scale, lastMs) {
  const { ms } = SCALES[scale];
  const half = Math.round(ms / 2);
  const untilMs = known(lastMs) && atMs <= lastMs ? Math.min(atMs + half, Math.max(lastMs, atMs)) : atMs + half;
  const ends = Math.ceil(untilMs / 60_000) * 60_000;
  return { sinceMs: Math.max(0, ends - ms), untilMs: ends };
}

/** The time that an answer is of, by its address; null: there is none. @param {string|null} path */
export function spanOf(path) {
  if (path === null) return null;
  const query = new URLSearchParams(path.slice(path.indexOf('?')));
  return { sinceMs: Number(query.get('since_ms')), untilMs: Number(query.get('until_ms')) };
}

/**
 * Columns for steps that break where nothing is recorded: each bucket at its begin, and the end of each row of them.
 * @param {{t_ms: number}[]} buckets ascending @param {number} lengthMs @param {string[]} names
 * @returns {(number|null)[][]} seconds, and one column for each name
 */
export function columns(buckets, lengthMs, names) {
  const out = /** @type {(number|null)[][]} */ ([[], ...names.map(() => [])]);
  const push = (tMs, bucket) => {
    out[0].push(tMs / 1000);
    for (const [n, name] of names.entries()) out[n + 1].push(bucket && known(bucket[name]) ? bucket[name] : null);
  };
  for (const [n, bucket] of buckets.entries()) {
    push(bucket.t_ms, bucket);
    const next = buckets[n + 1];
    if (next && next.t_ms - bucket.t_ms <= lengthMs) continue;
    const end = bucket.t_ms + lengthMs;
    push(end - 1, bucket);
    if (next) push(end, null);
  }
  return out;
}

/** The bucket that holds the moment; null: nothing was recorded then. */
export function bucketAt(buckets, lengthMs, atMs) {
  let [low, high] = [0, buckets.length - 1];
  while (low <= high) {
    const middle = (low + high) >> 1;
    if (buckets[middle].t_ms > atMs) high = middle - 1;
    else low = middle + 1;
  }
  const found = buckets[high];
  return found && atMs < found.t_ms + lengthMs ? found : null;
}

/** Seconds of stop in all, and those for a reason that is a fault. */
export function stopOf(bucket) {
  let [all, fault] = [0, 0];
  for (const [reason, seconds] of Object.entries(bucket.stop_s)) {
    all += seconds;
    if (abnormal(reason)) fault += seconds;
  }
  return { all, fault };
}

const length = (seconds) => (seconds < 120 ? number(seconds, seconds < 10 ? 1 : 0, 's') : number(seconds / 60, 0, 'min'));
const spread = (least, mean, most, unit, decimals = 0) => (known(mean) ? text('{0} to {1}, mean {2}', number(least, decimals), number(most, decimals, unit), number(mean, decimals)) : NONE);

/** A bucket in words; null: nothing was recorded. */
export function bucketText(bucket, lengthMs) {
  if (!bucket) return 'nothing recorded';
  const parts = [`R ${spread(bucket.r_min, bucket.r_mean, bucket.r_max, 'px')}`, `Z ${spread(inUnit(bucket.z_min), inUnit(bucket.z_mean), inUnit(bucket.z_max), lengthUnit(), places(0))}`];
  if (bucket.may_move_s > 0) parts.push(text('may move {0}', length(bucket.may_move_s)));
  if (bucket.in_place_s > 0) parts.push(text('in place {0}', length(bucket.in_place_s)));
  const reasons = Object.entries(bucket.stop_s).sort(([, a], [, b]) => b - a).slice(0, 2);
  if (reasons.length) parts.push(text('stop {0}', reasons.map(([reason, seconds]) => `${length(seconds)} (${t(words(reason))})`).join(', ')));
  const missing = lengthMs / 1000 - bucket.recorded_s;
  if (missing > 0.02 * (lengthMs / 1000)) parts.push(text('not recorded {0}', length(missing)));
  return listed(parts);
}

/** Kinds of visits, as the server finds them. @type {Record<string, string>} */
export const VISIT_KINDS = {
  all: 'all',
  faults: 'with faults',
  odd: 'not as usual',
  moved: 'moved, though it was to stand',
  dust: 'with dust in the picture',
  never: 'never in place',
  corrected: 'with corrections',
  interrupted: 'interrupted',
};

export const faultsText = (visit) =>
  listed(visit.faults.map((fault) => `${t(words(fault.reason))} ${length(fault.seconds)}${fault.times > 1 ? ` (${text('{0} times', fault.times)})` : ''}`), ', ');

/** A visit in a few words, the gravest first. */
export function verdict(visit) {
  if (visit.unintended) return VISIT_KINDS.moved;
  if (visit.faults.length) return faultsText({ faults: [visit.faults.reduce((worst, fault) => (fault.seconds > worst.seconds ? fault : worst))] });
  if (visit.to_position_s === null) return VISIT_KINDS.never;
  if (visit.interrupted) return VISIT_KINDS.interrupted;
  return visit.end === 'gateway_off' ? words(visit.end) : USUAL;
}

/**
 * The moment of a visit to ask about: that of its motion, else of its fault, else when it was in place, Unix ms.
 * @param {any} visit @param {{t_ms: number, kind: string}[]} events abnormal ones, ascending
 */
export function momentOf(visit, events) {
  const kinds = visit.unintended ? ['rolling', 'moved'] : visit.faults.length ? ['sensor_fault', 'plc_lost'] : [];
  // An event's time is cut to whole ms: what it changed is so in the next one.
  const event = events.find(({ kind, t_ms }) => kinds.includes(kind) && during(visit, t_ms));
  return event ? event.t_ms + 1 : visit.begun_ms + Math.round(1000 * (visit.to_position_s ?? visit.length_s / 2));
}

/** Of a picture in a film: how long it is shown, ms. Silences between pictures are not waited for. */
export function frameMs(pictures, n, speed) {
  const next = pictures[n + 1];
  if (!next) return null;
  return Math.max(40, Math.min(1500, next.t_ms - pictures[n].t_ms) / speed);
}

/** The picture shown at that moment: the newest before it, else the first. */
export function pictureAt(pictures, atMs) {
  let found = 0;
  for (const [n, picture] of pictures.entries()) if (picture.t_ms <= atMs) found = n;
  return found;
}
