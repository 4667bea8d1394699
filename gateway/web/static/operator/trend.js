// R and Z over the last minutes with their thresholds; stop, in place and may move as strips below. No line across what is missing.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { nice, written } from '../lib/bars.js';
import { FONT, cleared, hatched, textScale } from '../lib/canvas.js';
import { clock, number, words } from '../lib/format.js';
import { t, text } from '../lib/lang.js';
import { Series } from '../lib/series.js';
import { distance as distanceText, inUnit, lengthUnit, places } from '../lib/units.js';
import { useKept } from './hooks.js';
import { colour, ink } from '../lib/theme.js';

const { uPlot } = /** @type {any} */ (globalThis); // vendor/uplot.js, which the page loads before

const WINDOWS = [[60, '1 min'], [180, '3 min'], [600, '10 min']];
const AXIS = 26; // height of the time axis


/** One chart of one value: its line, its threshold as a dashed line, the hysteresis as a band. */
function chart(at, { label, unit, bare }) {
  const scale = textScale();
  const font = `${13 * scale}px ${FONT}`;
  const limits = { threshold: 0, band: /** @type {[number, number]|null} */ (null), most: 1 };
  const plot = new uPlot(
    {
      width: 300,
      height: 100,
      pxAlign: 0,
      padding: [10 * scale, 30 * scale, bare ? 8 * scale : 0, 0],
      legend: { show: false },
      cursor: { sync: { key: 'trend' }, drag: { x: false, y: false }, points: { size: 7 } },
      scales: { x: { time: true }, y: { range: () => [0, limits.most] } },
      series: [{}, { label, stroke: ink('--value'), width: 1.6 * scale, spanGaps: false, points: { show: false } }],
      axes: [
        { font, stroke: ink('--muted'), grid: { show: false }, ticks: { stroke: ink('--grid') }, size: bare ? 0 : AXIS * scale, show: !bare, space: 90 * scale,
          values: (_, ticks) => ticks.map((t) => clock(t * 1000)) },
        { font, stroke: ink('--muted'), grid: { stroke: ink('--grid'), width: 1 }, ticks: { stroke: ink('--grid') }, size: 52 * scale, space: 26 * scale, label: `${label}, ${unit}`, labelSize: 20 * scale, labelFont: `600 ${font}`, labelGap: 0,
          values: (_, ticks) => written(ticks) },
      ],
      hooks: {
        drawClear: [
          (u) => {
            if (!limits.band) return;
            const [low, high] = limits.band.map((y) => u.valToPos(y, 'y', true));
            u.ctx.fillStyle = colour('--band');
            u.ctx.fillRect(u.bbox.left, high, u.bbox.width, low - high);
          },
        ],
        draw: [
          (u) => {
            const y = u.valToPos(limits.threshold, 'y', true);
            const { ctx } = u;
            ctx.save();
            ctx.strokeStyle = colour('--text');
            ctx.lineWidth = 1.4 * devicePixelRatio;
            ctx.setLineDash([7 * devicePixelRatio, 4 * devicePixelRatio]);
            ctx.beginPath();
            ctx.moveTo(u.bbox.left, y);
            ctx.lineTo(u.bbox.left + u.bbox.width, y);
            ctx.stroke();
            ctx.setLineDash([]);
            ctx.font = `600 ${13 * scale * devicePixelRatio}px ${FONT}`;
            const text = `${label}_th ${number(limits.threshold, unit === 'px' ? 0 : places(0), unit)}`;
            const tall = 17 * scale * devicePixelRatio;
            const wide = ctx.measureText(text).width + 8 * devicePixelRatio;
            const top = y - u.bbox.top > tall + 4 ? y - tall - 2 : y + 2;
            ctx.fillStyle = colour('--panel');
            ctx.fillRect(u.bbox.left + 4, top, wide, tall);
            ctx.fillStyle = colour('--text');
            ctx.textAlign = 'left';
            ctx.textBaseline = 'middle';
            ctx.fillText(text, u.bbox.left + 4 + 4 * devicePixelRatio, top + tall / 2);
            ctx.restore();
          },
        ],
      },
    },
    [[], []],
    at,
  );
  return { plot, limits };
}

const STRIPS = [['stop', '--text'], ['in_place', '--bar-strong'], ['may_move', '--bar']];

function strip(canvas, plot, series, from, to) {
  const { g, ratio, height } = cleared(canvas);
  const { left, width: across } = plot.bbox;
  const x = (at) => left + ((at - from) / (to - from)) * across;
  const row = height / STRIPS.length;
  for (const [n, [name, fill]] of STRIPS.entries()) {
    const [y, tall] = [n * row + row * 0.14, row * 0.72];
    hatched(g, left, y, across, tall, ratio);
    for (const { from: a, to: b, value } of series.stretches(name, from, to)) {
      g.fillStyle = colour(value ? fill : '--field');
      g.fillRect(x(a), y, Math.max(1, x(b) - x(a)), tall);
    }
    g.strokeStyle = colour('--line-strong');
    g.lineWidth = ratio;
    g.strokeRect(left, y, across, tall);
    g.fillStyle = colour('--text');
    g.font = `${13 * textScale() * ratio}px ${FONT}`;
    g.textAlign = 'right';
    g.textBaseline = 'middle';
    g.fillText(t(words(name)), left - 6 * ratio, y + tall / 2, left - 8 * ratio);
  }
}

export function Trend({ state, limits, bay }) {
  const holder = useRef(null);
  const tools = useRef(null);
  const [seconds, setSeconds] = useKept('operator.trend', 60);
  const [paused, setPaused] = useState(false);
  const [cursor, setCursor] = useState(null);
  const live = useRef({});
  live.current = { seconds, paused, limits };

  useEffect(() => {
    const series = new Series();
    const [first, second, below] = holder.current.children;
    const radius = chart(first, { label: 'R', unit: 'px', bare: true });
    const distance = chart(second, { label: 'Z', unit: lengthUnit(), bare: false });
    const start = { steady: performance.now(), wall: Date.now() };
    const time = () => (start.wall + performance.now() - start.steady) / 1000; // never steps, whoever sets the clock
    const follow = (u) => {
      const at = u.cursor.idx;
      const { t, radius: r, distance: z, stop } = series.row;
      setCursor(u.cursor.left >= 0 && at != null && t[at] ? { t: t[at], r: r[at], z: z[at], stop: stop[at] } : null);
    };
    for (const { plot } of [radius, distance]) plot.hooks.setCursor = [...(plot.hooks.setCursor ?? []), follow];
    const paint = () => {
      if (document.hidden || live.current.paused) return;
      const to = time();
      const from = to - live.current.seconds;
      const { limits: now } = live.current;
      const rows = [
        [radius, 'radius', now.radius_threshold_px, [now.radius_threshold_px - now.radius_hysteresis_px, now.radius_threshold_px], 1.5],
        [distance, 'distance', inUnit(now.distance_threshold_mm), [inUnit(now.distance_threshold_mm), inUnit(now.distance_threshold_mm + now.distance_hysteresis_mm)], 3],
      ];
      for (const [one, name, threshold, band, room] of rows) {
        one.limits.threshold = threshold;
        one.limits.band = band[1] > band[0] ? band : null;
        one.limits.most = nice(Math.max(room * threshold, 1.05 * (series.most(name, from) ?? 0)));
        one.plot.batch(() => {
          one.plot.setData([series.row.t, series.row[name]], false);
          one.plot.setScale('x', { min: from, max: to });
        });
      }
      strip(below, distance.plot, series, from, to);
    };
    const resize = () => {
      const { clientWidth: width, clientHeight: height } = holder.current;
      const room = height - below.clientHeight - 8;
      if (width < 50 || room < 100) return;
      const axis = AXIS * textScale();
      const [upper, lower] = [Math.floor((room - axis) / 2), Math.ceil((room + axis) / 2)];
      second.style.top = `${upper}px`;
      radius.plot.setSize({ width, height: upper });
      distance.plot.setSize({ width, height: lower });
      paint();
    };
    const watch = new ResizeObserver(resize);
    watch.observe(holder.current);
    resize();
    const slow = matchMedia('(prefers-reduced-motion: reduce)').matches;
    const timer = setInterval(paint, slow ? 1000 : 200);
    tools.current = { series, time, paint };
    return () => {
      clearInterval(timer);
      watch.disconnect();
      radius.plot.destroy();
      distance.plot.destroy();
      tools.current = null;
    };
  }, [bay]);

  // Every message is one sample; where the page knows nothing, it says so with a gap.
  useEffect(() => {
    if (!tools.current) return;
    const { series, time } = tools.current;
    series.add(time(), state
      ? { radius_px: state.radius_px, distance_mm: inUnit(state.distance_mm), stop: state.stop, in_place: state.in_place, may_move: state.may_move }
      : { radius_px: null, distance_mm: null, stop: null, in_place: null, may_move: null });
  }, [state]);
  useEffect(() => tools.current?.paint(), [seconds, paused]);

  const read = cursor
    ? text('{0}: R {1}, Z {2}, stop {3}', clock(cursor.t * 1000), number(cursor.r, 1, 'px'), number(cursor.z, places(0), lengthUnit()), t(cursor.stop === null ? 'unknown' : cursor.stop ? 'on' : 'off'))
    : text('now: R {0}, Z {1}', number(state?.radius_px, 1, 'px'), distanceText(state?.distance_mm));
  return html`<section class="panel trend" aria-labelledby="trend-title">
    <header>
      <h2 id="trend-title">Trend</h2>
      <div class="row compact">
        <span class="small value">${read}</span>
        <div class="group" role="group" aria-label="length of the trend">
          ${WINDOWS.map(([s, text]) => html`<button type="button" aria-pressed=${String(seconds === s)} onClick=${() => setSeconds(s)}>${text}</button>`)}
        </div>
        <button type="button" aria-pressed=${String(paused)} onClick=${() => setPaused(!paused)}>Pause</button>
      </div>
    </header>
    <div class="charts" ref=${holder} role="img" aria-label=${text('Trend of R in px and Z in {0} over {1} s; {2}', lengthUnit(), seconds, read)}>
      <div></div><div></div><canvas class="strip"></canvas>
    </div>
  </section>`;
}
