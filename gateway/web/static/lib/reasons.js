// Why a bay is as it is, in words for people: what is so, then what happens next. Pure.

/** By reason: in short, and as a sentence. One that is not here is shown in the gateway's own words. */
export const REASONS = {
  TARGET_REACHED: ['at the mark', 'The truck is at the mark. It is in place once it has stood still for a moment, straight and not too far in.'],
  STOP_LATCHED: ['stop is kept', 'The stop is kept: until somebody resets it, the PLC releases the truck, or the truck has left.'],
  MOVED: ['moved without release', 'The truck has left its place without being released. Reset, release, or let it leave.'],
  CLEARING: ['clear in a moment', 'Nothing stops the truck any more: the stop ends when that has been so for a moment.'],
  STARTING: ['starting', 'The gateway has just started: camera or distance sensor have sent nothing yet.'],
  VISION_STALE: ['no new picture', 'The camera has stopped sending new pictures.'],
  CAMERA_DOWN: ['no camera', 'The camera is not connected, or cannot be opened.'],
  NO_TARGET: ['no marker in sight', 'The camera sees no marker: no truck, or the marker is covered.'],
  VISION_FAULT: ['picture not evaluated', 'The program that looks for the marker has failed; it is started again by itself.'],
  TARGET_COASTED: ['marker hidden', 'The marker is hidden for the moment: only guessed, not seen.'],
  VISION_AGE_UNPROVEN: ['age of picture unknown', 'Nothing proves how old the camera’s pictures are: they are not used.'],
  BEACON_LOST: ['pictures not proven', 'The pictures do not show the code of the LED: they may be old.'],
  RANGE_STALE: ['no new distance', 'The distance sensor has stopped sending.'],
  RANGER_DOWN: ['no distance sensor', 'The distance sensor is not connected, or its port cannot be opened.'],
  NO_ECHO: ['nothing in front', 'The distance sensor hears no echo: nothing stands before it, or the echo does not come back.'],
  RANGE_TOO_NEAR: ['sensor covered', 'Something is right before the distance sensor, nearer than it can measure.'],
  RANGE_TOO_FAR: ['too far away', 'The truck is farther away than the distance sensor can measure.'],
  RANGER_STUCK: ['sensor broken', 'The distance sensor does not react: its wires or the sensor itself are broken.'],
  RANGE_UNSTABLE: ['distance jumps', 'The measured distance jumps, so that none can be trusted.'],
  RANGER_VERSION: ['wrong firmware', 'The distance sensor has the firmware of another version: flash the one of this gateway.'],
  RANGERS_DISAGREE: ['rangers disagree', 'The distance sensors of this bay contradict each other, so that none can be trusted.'],
  SENSORS_DISAGREE: ['sensors disagree', 'Camera and distance sensor contradict each other: one of them sees something that is not the truck.'],
  GATEWAY_FAULT: ['gateway fault', 'The gateway itself does not decide any more. Restart it, and report its log.'],
  SHUTDOWN: ['shutting down', 'The gateway is being shut down.'],
  PLC_LOST: ['PLC lost', 'The PLC does not answer: its sign of life is missing.'],
};

const MOVES = {
  ARRIVING: 'A truck arrives. It may drive up; it is still too far away for the distance sensor.',
  APPROACHING: 'The truck may drive on to the mark.',
  RELEASED: 'Released: the truck may leave.',
  LEAVING: 'The truck is on its way out.',
};

const TOO_FAR_IN = {
  BACK: 'The truck stands too far in: it must go back.',
  TOO_FAR: 'The truck is too far in and still moving: it must stop.',
};

/** As a sentence. @param {any} state null: not known @returns {string} */
export function why(state) {
  if (state === null) return 'Nothing new from the gateway: treat the bay as STOP.';
  if (state.guidance?.name === 'BRAKE') return 'The truck rolls: if it is being loaded, stop loading and raise the spout.';
  if (state.in_place && state.held) return 'In place: loading may go on. The marker is covered; the distance shows that the truck stands still.';
  if (state.in_place) return 'Loading may start.';
  if (state.stop && state.reason.name === 'TARGET_REACHED') return TOO_FAR_IN[state.guidance?.name] ?? REASONS.TARGET_REACHED[1];
  if (state.stop) return REASONS[state.reason.name]?.[1] ?? state.reason.text;
  if (state.may_move) return MOVES[state.phase] ?? 'Nothing stops the truck: it may drive.';
  return 'Nothing stops the truck, but it may not drive yet: the PLC or a technician withholds it.';
}
