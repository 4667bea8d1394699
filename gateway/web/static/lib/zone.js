// The time zone of every time on the pages: that of the gateway's machine, so that its days are the plant's, and the
// same in every browser. Until the gateway has named it, the browser's own.

const formatOf = (timeZone) => new Intl.DateTimeFormat('en', { timeZone, timeZoneName: 'longOffset' });

let format = formatOf(undefined);
let name = format.resolvedOptions().timeZone;
/** Offsets by the quarter of an hour; none changes within one. @type {Map<number, number>} */
const offsets = new Map();
const QUARTER_MS = 900_000;
const MINUTE_MS = 60_000;
const MOST_OFFSETS = 1000;

/** A name that this browser does not know changes nothing. @param {string} [told] as the time zone database has it, or an offset */
export function learnZone(told) {
  if (!told) return;
  try {
    format = formatOf(told);
    name = told;
    offsets.clear();
  } catch {
    // It is named beside the times in any case.
  }
}

export const zoneName = () => name;

/** From UTC, ms; positive to the east. @param {number} unixMs */
function offsetMs(unixMs) {
  const quarter = Math.floor(unixMs / QUARTER_MS);
  const kept = offsets.get(quarter);
  if (kept !== undefined) return kept;
  const said = format.formatToParts(unixMs).find(({ type }) => type === 'timeZoneName')?.value ?? '';
  const [, sign, hours, minutes] = /([+-])(\d\d):?(\d\d)?/.exec(said) ?? ['', '+', '0', '0'];
  const found = (sign === '-' ? -1 : 1) * (60 * Number(hours) + Number(minutes ?? 0)) * MINUTE_MS;
  if (offsets.size >= MOST_OFFSETS) offsets.clear();
  offsets.set(quarter, found);
  return found;
}

/** A date whose UTC fields are those of the zone. @param {number} unixMs */
export const wall = (unixMs) => new Date(unixMs + offsetMs(unixMs));

/** "UTC+1", "UTC-3:30" at that moment. @param {number} unixMs */
export function offset(unixMs) {
  const minutes = Math.abs(offsetMs(unixMs)) / MINUTE_MS;
  if (minutes === 0) return 'UTC';
  const rest = minutes % 60 ? `:${String(minutes % 60).padStart(2, '0')}` : '';
  return `UTC${offsetMs(unixMs) < 0 ? '-' : '+'}${Math.floor(minutes / 60)}${rest}`;
}

/** "Europe/Berlin, UTC+1". @param {number} unixMs */
export function zoneText(unixMs) {
  const from = offset(unixMs);
  return /^([+-]|(Etc\/)?UTC$)/.test(name) ? from : `${name}, ${from}`;
}

/** Unix ms of a time in the zone, "2026-11-23T03:14:00"; NaN: it is none. @param {string} text */
export function unixOf(text) {
  const ms = Date.parse(`${text}Z`);
  if (Number.isNaN(ms)) return NaN;
  const near = ms - offsetMs(ms);
  return ms - offsetMs(near); // the clocks may be changed between the two
}
