// Pictures of days, as SVG: they are as sharp on paper as on the screen. The numbers are in the table of days, too.

import { html, useEffect, useState } from '../lib/page.js';
import { nice, ticks, written } from '../lib/bars.js';
import { every, weekday } from '../lib/days.js';
import { known, number, scarce } from '../lib/format.js';
import { language, listed, t, text } from '../lib/lang.js';

const HIGH = 214;
const PAD = { left: 46, right: 8, top: 22, bottom: 34 };
const INNER_HIGH = HIGH - PAD.top - PAD.bottom;
const NARROW = matchMedia('(max-width: 700px) and not print');

/** Of the drawing, so that its letters are as large as the others on a telephone, too; drawn anew when that changes. */
function useWide() {
  const read = () => (NARROW.matches ? 360 : 640);
  const [wide, setWide] = useState(read());
  useEffect(() => {
    const changed = () => setWide(read());
    NARROW.addEventListener('change', changed);
    return () => NARROW.removeEventListener('change', changed);
  }, []);
  return wide;
}

/** Fills that differ in shape or lightness, not in colour alone. */
const FILLS = {
  dark: 'var(--value)',
  middle: 'var(--bar)',
  light: 'var(--bar-light)',
  white: 'var(--field)',
  fault: 'url(#fault)',
  unknown: 'url(#unknown)',
  never: 'url(#never)',
};

/** Patterns, once on the page. */
export const Patterns = () => html`<svg width="0" height="0" aria-hidden="true" class="patterns"><defs>
  <pattern id="unknown" width="8" height="8" patternUnits="userSpaceOnUse"><path d="M-2 10L10 -2M-2 2L2 -2M6 10L10 6" stroke="var(--part)" stroke-width="1" /></pattern>
  <pattern id="fault" width="6" height="6" patternUnits="userSpaceOnUse"><rect width="6" height="6" fill="var(--red)" /><path d="M0 0L6 6M-1 5L1 7M5 -1L7 1" stroke="#fff" stroke-width="1.1" /></pattern>
  <pattern id="never" width="6" height="6" patternUnits="userSpaceOnUse"><rect width="6" height="6" fill="var(--field)" /><path d="M0 6L6 0M-1 1L1 -1M5 7L7 5" stroke="var(--value)" stroke-width="1.2" /></pattern>
</defs></svg>`;

/** A small square of a fill with its meaning. @param {{items: [string, string][]}} of fill, words */
export const Legend = ({ items }) => html`<ul class="legend">
  ${items.map(([fill, text]) => html`<li><svg viewBox="0 0 14 14" aria-hidden="true"><rect x="0.5" y="0.5" width="13" height="13" fill=${FILLS[fill]} stroke="var(--muted)" /></svg>${text}</li>`)}
</ul>`;

/** Round places from `low` to `most`, where an axis does not begin at zero. */
function marksBetween(low, most) {
  const step = nice((most - low) / 6);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(most / step) - first + 1 }, (_, n) => (first + n) * step);
}

const inner = (wide) => wide - PAD.left - PAD.right;
const place = (wide, count, at) => PAD.left + (inner(wide) * at) / count;
const height = (value, most) => (INNER_HIGH * value) / most;

function Axes({ wide, days, most, unit, whole }) {
  const marks = ticks(most, whole);
  const labels = written(marks);
  const labelled = every(days.length, wide / 40);
  const base = PAD.top + INNER_HIGH;
  return html`<g class="axes">
    ${marks.map((tick, n) => html`<g>
      <path d=${`M${PAD.left} ${base - height(tick, most)}H${wide - PAD.right}`} class="grid" />
      <text x=${PAD.left - 5} y=${base - height(tick, most)} text-anchor="end" dominant-baseline="central">${labels[n]}</text></g>`)}
    <text x="0" y="11" class="unit">${unit}</text>
    ${days.map((day, at) => labelled(at) && html`<g>
      <text x=${place(wide, days.length, at + 0.5)} y=${base + 13} text-anchor="middle" translate="no">${weekday(day.date, language())}</text>
      <text x=${place(wide, days.length, at + 0.5)} y=${base + 27} text-anchor="middle">${day.date.slice(5)}</text></g>`)}
    <path d=${`M${PAD.left} ${base}H${wide - PAD.right}`} class="base" />
  </g>`;
}

/** Days of which nothing is known are hatched: no bar there does not mean zero. */
const Unknown = ({ wide, days }) => days.map((day, at) => day.times.recorded_s <= 0 && html`<rect x=${place(wide, days.length, at + 0.08)} y=${PAD.top} width=${(inner(wide) * 0.84) / days.length} height=${INNER_HIGH} fill="url(#unknown)"><title>${text('{0}: not recorded', day.date)}</title></rect>`);

/**
 * Bars of each day, parts one on another. @param {{days: any[], label: string, unit: string, whole?: number, total?: boolean,
 * parts: {fill: string, text: string, of: (day: any) => number}[]}} of `whole`: what the axis reaches to; none: the largest
 */
export function Bars({ days, parts, unit, label, whole, total = false }) {
  const wide = useWide();
  const sum = (day) => parts.reduce((all, part) => all + part.of(day), 0);
  const most = whole ?? Math.max(4, nice(Math.max(...days.map(sum)) * 1.08));
  const each = inner(wide) / days.length;
  const bar = Math.min(0.72 * each, 46);
  const base = PAD.top + INNER_HIGH;
  return html`<svg class="chart" viewBox=${`0 0 ${wide} ${HIGH}`} role="img" aria-label=${label}>
    <${Axes} wide=${wide} days=${days} most=${most} unit=${unit} whole=${total} />
    <${Unknown} wide=${wide} days=${days} />
    ${days.map((day, at) => {
      let top = base;
      const x = place(wide, days.length, at + 0.5) - bar / 2;
      return html`<g>
        ${parts.map((part) => {
          const value = part.of(day);
          const tall = height(value, most);
          top -= tall;
          return tall > 0 && html`<rect x=${x} y=${top} width=${bar} height=${tall} fill=${FILLS[part.fill]} class="part"><title>${listed([day.date, ': ', t(part.text), ' ', number(value, Number.isInteger(value) ? 0 : 1, unit === 'h' ? 'h' : '')], '')}</title></rect>`;
        })}
        ${total && each > 20 && sum(day) > 0 && html`<text x=${x + bar / 2} y=${top - 5} text-anchor="middle" class="total">${number(sum(day))}</text>`}
      </g>`;
    })}
  </svg>`;
}

/**
 * For each day where most of its values lie: a bar from p10 to p90, a line at the median. A band marks what is wanted.
 * @param {{days: any[], label: string, unit: string, of: (day: any) => any, fromZero?: boolean}} of
 */
export function Ranges({ days, of, unit, label, fromZero = false }) {
  const wide = useWide();
  const found = days.map(of);
  const values = found.filter(Boolean).flatMap((one) => [one.p10, one.p90, one.median]);
  const [least, largest] = values.length ? [Math.min(...values), Math.max(...values)] : [0, 1];
  const room = Math.max(0.15 * (largest - least), fromZero ? 0 : 0.003 * largest);
  const low = fromZero ? 0 : least - room;
  const most = fromZero ? nice(largest * 1.1) : largest + room;
  const base = PAD.top + INNER_HIGH;
  const y = (value) => base - (INNER_HIGH * (value - low)) / (most - low);
  const each = inner(wide) / days.length;
  const bar = Math.min(0.5 * each, 30);
  const marks = fromZero ? ticks(most) : marksBetween(low, most);
  const labels = written(marks);
  const labelled = every(days.length, wide / 40);
  return html`<svg class="chart" viewBox=${`0 0 ${wide} ${HIGH}`} role="img" aria-label=${label}>
    <g class="axes">
      ${marks.map((mark, n) => html`<g><path d=${`M${PAD.left} ${y(mark)}H${wide - PAD.right}`} class="grid" /><text x=${PAD.left - 5} y=${y(mark)} text-anchor="end" dominant-baseline="central">${labels[n]}</text></g>`)}
      <text x="0" y="11" class="unit">${unit}</text>
      ${days.map((day, at) => labelled(at) && html`<g><text x=${place(wide, days.length, at + 0.5)} y=${base + 13} text-anchor="middle" translate="no">${weekday(day.date, language())}</text><text x=${place(wide, days.length, at + 0.5)} y=${base + 27} text-anchor="middle">${day.date.slice(5)}</text></g>`)}
      <path d=${`M${PAD.left} ${base}H${wide - PAD.right}`} class="base" />
    </g>
    <${Unknown} wide=${wide} days=${days} />
    ${found.map((one, at) => {
      if (!one) return '';
      const x = place(wide, days.length, at + 0.5);
      const [top, under] = [y(one.p90), y(one.p10)];
      const few = scarce(one.count);
      return html`<g data-few=${few ? one.count : undefined}><title>${text('{0}: median {1}, {2} to {3}, {4} trucks', days[at].date, number(one.median, 1, unit), number(one.p10, 1), number(one.p90, 1, unit), one.count)}</title>
        <rect x=${x - bar / 2} y=${top} width=${bar} height=${Math.max(1.5, under - top)} fill=${few ? 'none' : FILLS.light} stroke="var(--muted)" stroke-dasharray=${few ? '4 3' : undefined} />
        <path d=${`M${x - bar / 2 - 3} ${y(one.median)}h${bar + 6}`} stroke=${few ? 'var(--muted)' : FILLS.dark} stroke-width="3" />
        ${few && each > 30 && html`<text x=${x} y=${top - 5} text-anchor="middle" class="few">n = ${one.count}</text>`}
      </g>`;
    })}
  </svg>`;
}

/**
 * Longest first, with the share of all that is reached so far. @param {{rows: {name: string, title: string, value: number, text: string}[], label: string, fill?: string}} of
 */
export function Pareto({ rows, label, fill = 'dark' }) {
  const whole = rows.reduce((sum, row) => sum + row.value, 0);
  const most = Math.max(...rows.map((row) => row.value), 1e-9);
  let so = 0;
  return html`<table class="pareto" aria-label=${label}><thead><tr><th scope="col">Cause</th><th scope="col"><span class="sr">Bar</span></th><th scope="col" class="right">Amount</th><th scope="col" class="right">Together</th></tr></thead><tbody>
    ${rows.map((row) => {
      so += row.value;
      return html`<tr><th scope="row" title=${row.title}>${row.name}</th>
        <td class="bar"><svg viewBox="0 0 100 10" preserveAspectRatio="none" aria-hidden="true"><rect width=${Math.max(0.5, (100 * row.value) / most)} height="10" fill=${FILLS[fill]} /></svg></td>
        <td class="right value">${row.text}</td><td class="right">${whole > 0 && known(so) ? number((100 * so) / whole, 0, '%') : '–'}</td></tr>`;
    })}
  </tbody></table>`;
}
