// Events as words, and the filter over them. Pure.

import { words } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';
import { REASONS } from '../lib/reasons.js';
import { saidText } from '../lib/said.js';

/** Kinds of events by what they are about. */
const GROUPS = {
  all: () => true,
  stop: (kind) => /^(stop|latch|target|in_place|moved|rolling|released|visit)/.test(kind),
  sensors: (kind) => /^(sensor|target)/.test(kind),
  plc: (kind) => /^(plc|write|recipe|latch)/.test(kind),
  service: (kind) => /^(start|shutdown|function|settings|operat)/.test(kind),
};
export const GROUP_WORDS = { all: 'all', stop: 'stop and position', sensors: 'sensors', plc: 'PLC', service: 'service' };

/** Is it of the group, and does it hold all the words, as shown or in English? Addresses of writers count, too. */
export function matches(event, group, wanted) {
  if (!(GROUPS[group] ?? GROUPS.all)(event.kind)) return false;
  const searched = [event.kind, words(event.kind), t(words(event.kind)), event.bay, event.sensor, words(event.quality?.name), event.detail, event.reason?.text, event.reason?.name, eventText(event)].join(' ').toLowerCase();
  return wanted.toLowerCase().split(/\s+/).every((word) => searched.includes(word));
}

/** In the viewer's words: what the event adds to its kind. */
export function eventText(event) {
  const parts = [];
  if (event.sensor) parts.push(t(words(event.sensor)));
  if (event.quality && event.quality.name !== 'GOOD') parts.push(t(words(event.quality.name)));
  if (event.write?.name) parts.push(`${event.write.name}: ${event.write.old ?? '–'} → ${event.write.new ?? '–'}`);
  if (event.kind === 'stop_raised' && event.reason) parts.push(t(REASONS[event.reason.name]?.[0] ?? event.reason.text));
  if (event.detail) parts.push(saidText(event));
  if (event.write?.address) parts.push(text('by {0}', [event.write.subject, event.write.address].filter(Boolean).join(', ')));
  return listed(parts);
}
