// What the tuning page knows, as one record. It changes by these actions only: each makes of the record, and of what
// came, the fields that are new. What has no action of its own is set by its name. Pure.

import { followed } from './settings.js';

/** What is told of a bay's settings, with every answer that changes them. */
const told = (profile) => ({
  inForce: profile.vision,
  undoSteps: profile.undo_steps,
  undone: profile.undo, // what one step back brings back
  untried: profile.untried,
  mode: profile.function_check.toUpperCase(),
});

/** @param {any} profile @param {any[]} taken kept frames and recordings */
export const begun = (profile, taken) => ({
  ...told(profile),
  settings: profile.vision, // as they are edited here
  file: profile.file,
  taken,
  source: { kind: 'live' }, // what they are tried on
  result: null, // the newest trial's
  picked: { answer: null, failed: '' }, // by the eyedropper
  led: null, // where the beacon's LED was clicked
  said: { text: '', bad: false },
  trouble: '', // of the newest trial
  waiting: false, // a trial is under way
  busy: '', // what a button has begun
  plan: null, // the difference that a save would make
  question: null, // warnings that someone is to accept
  restarting: null, // the settings page's file, for the question
});

/** Others are in force: what nobody has edited here follows. */
export const profiled = (answer) => (was) => ({
  ...told(answer),
  settings: followed(was.settings, was.inForce, answer.vision),
  file: answer.file ?? was.file,
});

/** Of the settings that are edited here. */
export const edited = (keys) => (was) => ({ settings: { ...was.settings, ...keys } });

/** A trial has ended; without a result it was given up for something newer, or there is no picture yet. */
export const tried = (result, request) => (was) => ({
  trouble: '',
  result: result === null ? was.result : { ...carried(was.result, result, request), request },
});

export const said = (text, bad = false) => ({ said: { text, bad } });

/** The record with a change: fields, or an action. The same one where nothing is new. @param {any} was @param {any} change */
export function changed(was, change) {
  const fields = typeof change === 'function' ? change(was) : change;
  return Object.entries(fields).every(([name, value]) => Object.is(was[name], value)) ? was : { ...was, ...fields };
}

/** A look without times keeps the times that were measured for these very settings; and the exposure, of another frame. */
function carried(was, next, request) {
  const alike = was && was.request.settings === request.settings && was.request.inForce === request.inForce && was.request.source.kind === request.source.kind;
  if (!alike || request.timed || !was.timed) return { ...next, judged_id: next.frame_id };
  const times = (side, old) => ({ ...side, total_ms: old.total_ms, stages: old.stages });
  return { ...next, timed: true, time_ratio: was.time_ratio, exposure: was.exposure, judged_id: was.judged_id, tried: times(next.tried, was.tried), in_force: times(next.in_force, was.in_force) };
}
