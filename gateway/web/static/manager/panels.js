// What the figures say, panel by panel.

import { html } from '../lib/page.js';
import { stampOf, weekday } from '../lib/days.js';
import { NONE, known, number, percent, scarce, signed, words } from '../lib/format.js';
import { language, listed, t, text } from '../lib/lang.js';
import { quantity } from '../lib/quantity.js';
import { distance, inUnit, lengthUnit, places } from '../lib/units.js';
import { Health as Sign } from '../operator/signs.js';
import { Bars, Legend, Pareto, Ranges } from './charts.js';

const hours = (seconds) => seconds / 3600;
/** A length, with the unit that suits it. */
export function length(seconds) {
  if (!known(seconds)) return NONE;
  if (seconds < 99.5) return number(seconds, seconds < 9.95 ? 1 : 0, 's');
  if (seconds < 5970) return number(seconds / 60, seconds < 597 ? 1 : 0, 'min');
  return number(hours(seconds), 1, 'h');
}

/** `sheet`: as wide as the paper. */
const Panel = ({ id, title, note, children, wide = false, sheet = wide }) => html`<section class=${`panel ${wide ? 'across' : ''} ${sheet ? 'sheet' : ''}`} aria-labelledby=${`${id}-title`}>
  <header><h2 id=${`${id}-title`}>${title}</h2>${note && html`<span class="small muted">${note}</span>`}</header>
  ${children}
</section>`;

/** `n`: of how many it was made, where that is a number of trucks: of few it is grey, and says so. */
const Figure = ({ name, value, more, n }) => html`<div class=${`figure ${scarce(n) ? 'few' : ''}`}><dt>${name}</dt><dd class="value">${quantity(value)}${scarce(n) ? html` <span class="tag">n = ${n}</span>` : ''}</dd><dd class="small muted">${more}</dd></div>`;

export function KeyFigures({ view }) {
  const { times, positions, alarms, days } = view;
  const recorded = days.filter((day) => day.times.recorded_s > 0).length;
  const rate = alarms.benchmarks.find((one) => one.figure === 'per_hour')?.value;
  const z = positions.distance_mm;
  return html`<section class="panel across" aria-labelledby="key-title"><h2 id="key-title" class="sr">In short</h2><dl class="figures">
    <${Figure} name="Trucks" value=${number(positions.trucks)} more=${recorded > 1 ? `${number(positions.trucks / recorded, 1)} a day, of ${recorded} days` : `${positions.placed} of them in place`} />
    <${Figure} name="Time to position" n=${positions.to_position_s?.count} value=${length(positions.to_position_s?.median)} more=${positions.to_position_s ? `half of the trucks; 9 of 10 within ${length(positions.to_position_s.p90)}` : 'no truck came in place'} />
    <${Figure} name="Spread of Z in place" n=${z?.count} value=${z ? distance(z.deviation) : NONE} more=${z ? `standard deviation; mean ${distance(z.mean)}` : 'no truck came in place'} />
    <${Figure} name="Corrections" n=${positions.trucks || undefined} value=${positions.trucks ? number(positions.corrections / positions.trucks, 2) : NONE} more=${positions.trucks ? `a truck; ${positions.corrected} of ${positions.trucks} corrected` : 'no truck'} />
    <${Figure} name="Availability" value=${percent(times.availability, 1)} more=${`sensors good ${length(times.good_s)} of ${length(times.recorded_s)} recorded`} />
    <${Figure} name="Recorded" value=${percent(times.recorded_share, 1)} more=${`not known: ${length(times.unrecorded_s)} of ${length(times.passed_s)}`} />
    <${Figure} name="Alarms an hour" value=${number(rate, 2)} more=${`${number(alarms.announced)} in ${length(alarms.recorded_s)} recorded`} />
  </dl></section>`;
}

export const Trucks = ({ view }) => html`<${Panel} id="trucks" title="Trucks a day" note="by the day of arrival">
  <${Bars} days=${view.days} unit="trucks" total label="Trucks of each day"
    parts=${[{ fill: 'dark', text: 'in place', of: (day) => day.positions.placed }, { fill: 'never', text: 'never in place', of: (day) => day.positions.trucks - day.positions.placed }]} />
  <${Legend} items=${[['dark', 'came in place'], ['never', 'never in place'], ['unknown', 'not recorded']]} />
</${Panel}>`;

const TIME_PARTS = [
  { fill: 'dark', text: 'may move', of: (day) => hours(day.times.may_move_s) },
  { fill: 'middle', text: 'stop: truck at the mark', of: (day) => hours(day.times.stop_s.at_mark) },
  { fill: 'light', text: 'stop: nothing measured', of: (day) => hours(day.times.stop_s.no_measurement) },
  { fill: 'fault', text: 'stop: fault', of: (day) => hours(day.times.stop_s.fault) },
  { fill: 'white', text: 'neither', of: (day) => hours(day.times.neither_s) },
  { fill: 'unknown', text: 'not recorded', of: (day) => hours(day.times.unrecorded_s) },
];

export const DayTimes = ({ view }) => html`<${Panel} id="times" title="What the time was" note="hours of each day">
  <${Bars} days=${view.days} unit="h" whole=${Math.max(24, ...view.days.map((day) => hours(day.times.passed_s)))} label="Hours of each day by what the bay showed" parts=${TIME_PARTS} />
  <${Legend} items=${TIME_PARTS.map((part) => [part.fill, part.text])} />
</${Panel}>`;

const range_note = 'bar: 8 of 10 trucks; line: median; dashed: of fewer than 10 trucks';

export const ToPosition = ({ view }) => html`<${Panel} id="position" title="Time to position" note=${range_note}>
  <${Ranges} days=${view.days} unit="s" fromZero label="Time from arrival until in place, each day" of=${(day) => day.positions.to_position_s} />
</${Panel}>`;

/** Figures of millimetres in the viewer's unit. */
const inLengthUnit = (figures) => (figures ? Object.fromEntries(Object.entries(figures).map(([name, value]) => [name, name === 'count' ? value : inUnit(value)])) : figures);

export function Accuracy({ view }) {
  const p = view.positions;
  const rows = [
    ['Offset to the right', lengthUnit(), inLengthUnit(p.offset_mm), signed, places(1)], ['Offset in the picture', 'px', p.offset_px, signed], ['Distance Z', lengthUnit(), inLengthUnit(p.distance_mm), number, places(1)],
    ['Radius R', 'px', p.radius_px, number], ['Rolled after stop', lengthUnit(), inLengthUnit(p.overrun_mm), number, places(1)], ['Stop latency', 'ms', p.stop_latency_ms, number], ['Time to position', 's', p.to_position_s, number], ['Length of visit', 's', p.length_s, number],
  ];
  return html`<${Panel} id="accuracy" sheet title="Accuracy" note="when each truck was last in place">
    <table class="stack"><thead><tr><th scope="col">Value</th><th scope="col" class="right">Trucks</th><th scope="col" class="right">Median</th><th scope="col" class="right">8 of 10 within</th><th scope="col" class="right">Mean</th><th scope="col" class="right">Deviation</th></tr></thead><tbody>
      ${rows.map(([name, unit, one, shown, decimals = 1]) => html`<tr class=${scarce(one?.count) ? 'few' : ''}><th scope="row">${listed([t(name), unit], ', ')}</th>
        ${one ? html`<td class="right" data-name="trucks">${one.count}</td><td class="right value" data-name="median">${shown(one.median, decimals)}</td><td class="right nowrap" data-name="8 of 10 within">${shown(one.p10, decimals)} … ${shown(one.p90, decimals)}</td><td class="right" data-name="mean">${shown(one.mean, decimals)}</td><td class="right" data-name="deviation">${number(one.deviation, decimals)}</td>` : html`<td class="right" data-name="trucks">0</td><td class="right" data-name="median">${NONE}</td><td class="right">${NONE}</td><td class="right">${NONE}</td><td class="right">${NONE}</td>`}</tr>`)}
    </tbody></table>
    ${!view.aim && html`<p class="small muted">${text('No aim point is configured: set {0} for the offset.', 'guidance.aim_u_px')}</p>`}
    <p class="small muted">${`${p.placed} of ${p.trucks} trucks came in place; ${p.moved} moved though they were to stand.`}${p.interrupted + p.unwatched_end > 0 && html` ${`${p.interrupted} visits went over a restart of the gateway (their times are left out), ${p.unwatched_end} ended while it was off.`}`}</p>
  </${Panel}>`;
}

export const Distance = ({ view }) => html`<${Panel} id="distance" title="Distance Z in place" note=${range_note}>
  <${Ranges} days=${view.days} unit=${lengthUnit()} label="Distance of the trucks when last in place, each day" of=${(day) => inLengthUnit(day.positions.distance_mm)} />
</${Panel}>`;

const KIND_WORDS = { at_mark: 'truck at the mark', no_measurement: 'nothing measured', fault: 'fault' };

export function Causes({ view }) {
  const { causes, recorded_s: recorded } = view.times;
  const faults = causes.filter((cause) => cause.kind === 'fault');
  return html`<${Panel} id="causes" sheet title="Stops by cause" note=${`of ${length(recorded)} recorded`}>
    <h3>Faults</h3>
    ${faults.length
      ? html`<${Pareto} fill="fault" label="Faults that stopped the bay, the longest first" rows=${faults.map((cause) => ({ name: words(cause.reason), title: cause.text, value: cause.seconds, text: `${length(cause.seconds)}, ${number(cause.times)}×` }))} />`
      : html`<p>${recorded > 0 ? html`<${Sign} state="ok" text="No fault stopped the bay." />` : html`<span class="muted">Nothing is recorded.</span>`}</p>`}
    <h3>All causes</h3>
    <table class="stack"><thead><tr><th scope="col">Why stop was on</th><th scope="col">Kind</th><th scope="col" class="right">Length</th><th scope="col" class="right">Seconds</th><th scope="col" class="right">Share</th><th scope="col" class="right">Times</th></tr></thead><tbody>
      ${causes.map((cause) => html`<tr title=${cause.text}><th scope="row">${words(cause.reason)}</th><td>${KIND_WORDS[cause.kind] ?? words(cause.kind)}</td><td class="right value">${length(cause.seconds)}</td><td class="right" data-name="seconds">${number(cause.seconds)}</td><td class="right" data-name="share">${percent(recorded > 0 ? cause.seconds / recorded : null, 1)}</td><td class="right" data-name="times">${number(cause.times)}</td></tr>`)}
    </tbody></table>
    ${causes.length === 0 && html`<p class="muted">Stop was never on, or nothing is recorded.</p>`}
  </${Panel}>`;
}

const VERDICT = { acceptable: ['ok', 'acceptable'], manageable: ['warn', 'manageable'], too_many: ['bad', 'too many'] };
const SHARES = new Set(['busy_share', 'flood_share']);

function limit({ figure, acceptable, most, below }) {
  const text = (value) => (SHARES.has(figure) ? percent(value) : number(value));
  if (below) return `below ${text(acceptable)}`;
  return acceptable === most ? (acceptable === 0 ? 'none' : `up to ${text(most)}`) : `up to ${text(acceptable)}; at most ${text(most)}`;
}

function Standing({ title, rows }) {
  return html`<h3>${title}</h3><ul class="plain">${rows.map((one) => html`<li><b>${one.title}</b> <span class="mono small" translate="no">${one.id}</span> <span>${one.over ? `from ${stampOf(one.since)} to ${stampOf(one.until)}` : `since ${stampOf(one.since)}`}</span></li>`)}</ul>`;
}

export function Alarms({ view }) {
  const { alarms } = view;
  const all = Object.values(alarms.by_priority).reduce((sum, count) => sum + count, 0);
  const share = (name) => (all ? percent((alarms.by_priority[name] ?? 0) / all) : NONE);
  return html`<${Panel} id="alarms" sheet title="Alarms" note=${text('beside {0}', alarms.source)}>
    <table class="stack"><thead><tr><th scope="col">Of this bay and the gateway</th><th scope="col" class="right">Here</th><th scope="col">Standard, for one operator</th><th scope="col">So it is</th></tr></thead><tbody>
      ${alarms.benchmarks.map((one) => html`<tr data-figure=${one.figure}><th scope="row">${one.title}</th><td class="right value">${SHARES.has(one.figure) ? percent(one.value, 1) : number(one.value, Number.isInteger(one.value) ? 0 : 2)}</td><td class="nowrap" data-name="standard">${limit(one)}</td>
        <td>${one.verdict ? html`<${Sign} state=${VERDICT[one.verdict][0]} text=${VERDICT[one.verdict][1]} />` : html`<span class="muted">too little recorded</span>`}</td></tr>`)}
      <tr class=${scarce(all) && all > 0 ? 'few' : ''}><th scope="row">${scarce(all) && all > 0 ? text('high / medium / low priority, of {0} alarms', all) : 'high / medium / low priority'}</th><td class="right value nowrap">${share('high')} / ${share('medium')} / ${share('low')}</td><td class="nowrap" data-name="standard">${text('about {0}', '5 % / 15 % / 80 %')}</td><td></td></tr>
    </tbody></table>
    <p class="small muted">${alarms.peak ? `Most in 10 min: from ${stampOf(alarms.peak)}. ` : ''}${view.days.length < 30 ? 'The standard judges by 30 days or more.' : ''}</p>
    ${alarms.frequent.length > 0 && html`<h3>Most frequent</h3><${Pareto} label="The most frequent alarms" rows=${alarms.frequent.map((one) => ({ name: one.title, title: one.id, value: one.times, text: `${number(one.times)}×` }))} />`}
    ${alarms.stale.length > 0 && html`<${Standing} title="Active for more than 24 h" rows=${alarms.stale} />`}
    ${alarms.standing.length > 0 && html`<${Standing} title="Active at the end" rows=${alarms.standing} />`}
    ${alarms.chattering.length > 0 && html`<h3>Chattering</h3><p class="mono small">${alarms.chattering.join(', ')}</p>`}
  </${Panel}>`;
}

export const AlarmDays = ({ view }) => html`<${Panel} id="alarm-days" title="Alarms a day">
  <${Bars} days=${view.days} unit="alarms" total label="Alarms of each day" parts=${[{ fill: 'middle', text: 'alarms', of: (day) => day.alarms }]} />
  <${Legend} items=${[['middle', 'announced'], ['unknown', 'not recorded']]} />
</${Panel}>`;

export const DayTable = ({ view }) => html`<${Panel} id="days" title="Day by day" note=${text('days of {0}', view.time_zone)} wide>
  <table class="stack days"><thead><tr>
    <th scope="col">Day</th><th scope="col">From</th><th scope="col" class="right">Trucks</th><th scope="col" class="right">In place</th><th scope="col" class="right">Time to position</th><th scope="col" class="right">Corrections</th><th scope="col" class="right">May move</th><th scope="col" class="right">Faults</th><th scope="col" class="right">Available</th><th scope="col" class="right">Recorded</th><th scope="col" class="right">Not recorded</th><th scope="col" class="right">Alarms</th>
  </tr></thead><tbody>
    ${view.days.map(({ date, begin, times, positions, alarms }) => {
      const blank = times.recorded_s <= 0 && positions.trucks === 0;
      return html`<tr class=${blank ? 'blank' : ''}><th scope="row" class="nowrap"><span translate="no">${date} ${weekday(date, language())}</span></th><td class="nowrap">${begin.slice(11, 16)} ${begin.slice(19)}</td>
        ${blank
          ? html`<td colspan="8" class="muted">${times.passed_s > 0 ? 'not recorded' : 'not yet'}</td>`
          : html`<td class="right value" data-name="trucks">${positions.trucks}</td><td class="right" data-name="in place">${positions.placed}</td><td class=${`right ${scarce(positions.to_position_s?.count) ? 'few' : ''}`} data-name="time to position">${length(positions.to_position_s?.median)}</td><td class="right" data-name="corrections">${positions.corrections}</td><td class="right" data-name="may move">${length(times.may_move_s)}</td><td class="right" data-name="faults">${length(times.stop_s.fault)}</td><td class="right" data-name="available">${percent(times.availability, 1)}</td><td class="right" data-name="recorded">${length(times.recorded_s)}</td>`}
        <td class="right" data-name="not recorded">${length(times.unrecorded_s)}</td><td class="right" data-name="alarms">${blank ? NONE : alarms}</td></tr>`;
    })}
  </tbody></table>
</${Panel}>`;
