// The timeline: R and Z with their least and largest values, the outputs as shares of time, events as marks. What was
// not recorded is hatched, and no line goes across it. What is not here yet is blank, and says that it is loading.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { nice, written } from '../lib/bars.js';
import { FONT, cleared, hatched, textScale } from '../lib/canvas.js';
import { clock, day, stamp, words } from '../lib/format.js';
import { bucketAt, bucketText, columns, stopOf } from '../lib/history.js';
import { listed, t, text } from '../lib/lang.js';
import { saidText } from '../lib/said.js';
import { colour, ink } from '../lib/theme.js';
import { inUnit, lengthUnit } from '../lib/units.js';
import { zoneName } from '../lib/zone.js';

const { uPlot } = /** @type {any} */ (globalThis); // vendor/uplot.js, which the page loads before

const ROWS = ['stop', 'in place', 'may move', 'events'];
const AXIS = 52; // two lines

/** Ticks with the date where the day changes, and at the first one; with seconds where they are less than a minute apart. */
const times = (_, ticks) =>
  ticks.map((t, n) => {
    const date = day(t * 1000);
    const time = clock(t * 1000).slice(0, ticks[1] - ticks[0] < 60 ? 8 : 5);
    return n && date === day(ticks[n - 1] * 1000) ? time : `${time}\n${date}`;
  });

function chart(at, { label, unit, names, bare, sync, moved }) {
  const scale = textScale();
  const font = `${13 * scale}px ${FONT}`;
  const limits = { most: 1 };
  const paths = uPlot.paths.stepped({ align: 1 });
  const line = (width, stroke) => ({ paths, width: width * scale, stroke, spanGaps: false, points: { show: false } });
  const plot = new uPlot(
    {
      width: 300, height: 100, pxAlign: 0, padding: [10 * scale, 20 * scale, bare ? 8 * scale : 0, 0], legend: { show: false },
      cursor: { sync: { key: sync }, drag: { x: false, y: false }, points: { show: false } },
      tzDate: (t) => uPlot.tzDate(new Date(1000 * t), zoneName()), // its days begin with the zone's
      scales: { x: { time: true }, y: { range: () => [0, limits.most] } },
      series: [{}, line(0.5, ink('--band-line')), line(0.5, ink('--band-line')), line(1.6, ink('--value'))],
      bands: [{ series: [2, 1], fill: ink('--band') }],
      axes: [
        { font, stroke: ink('--muted'), grid: { show: false }, ticks: { stroke: ink('--grid') }, size: bare ? 0 : AXIS * scale, show: !bare, space: 90 * scale, values: times },
        { font, stroke: ink('--muted'), grid: { stroke: ink('--grid'), width: 1 }, ticks: { stroke: ink('--grid') }, size: 56 * scale, space: 26 * scale, label: `${label}, ${unit}`, labelSize: 20 * scale, labelFont: `600 ${font}`, labelGap: 0,
          values: (_, ticks) => written(ticks) },
      ],
      hooks: { setCursor: [moved] },
    },
    [[], [], [], []],
    at,
  );
  return { plot, limits, names };
}

/** The rows below the charts. `atMs`: the chosen moment; `viewed`: the time that the buckets are of, null: none. */
function strip(canvas, plot, { buckets, lengthMs, events, sinceMs, untilMs, atMs, viewed, busy }) {
  const { g, ratio, height } = cleared(canvas);
  const { left, width: across } = plot.bbox;
  const x = (ms) => left + Math.min(1, Math.max(0, (ms - sinceMs) / (untilMs - sinceMs))) * across;
  const row = height / ROWS.length;
  const [known, end] = viewed ? [x(viewed.sinceMs), x(viewed.untilMs)] : [left, left];
  const box = (n) => [n * row + row * 0.12, row * 0.76];
  for (const [n, name] of ROWS.entries()) {
    const [y, tall] = box(n);
    if (n < 3) hatched(g, known, y, end - known, tall, ratio);
    g.strokeStyle = colour('--line-strong');
    g.lineWidth = ratio;
    if (n < 3) g.strokeRect(left, y, across, tall);
    g.fillStyle = colour('--text');
    g.font = `${Math.min(row * 0.55, 13 * textScale() * ratio)}px ${FONT}`;
    g.textAlign = 'right';
    g.textBaseline = 'middle';
    g.fillText(t(name), left - 6 * ratio, y + tall / 2, left - 8 * ratio);
  }
  g.textAlign = 'center';
  for (const [from, to] of busy ? [[left, known], [end, left + across]] : []) {
    const words = t('Loading.');
    if (g.measureText(words).width < to - from) g.fillText(words, (from + to) / 2, row / 2);
  }
  const part = (n, from, to, share, fill) => {
    const [y, tall] = box(n);
    if (share <= 0) return;
    g.fillStyle = fill;
    g.fillRect(from, y + tall * (1 - Math.min(1, share)), Math.max(1, to - from), tall * Math.min(1, share));
  };
  for (const bucket of buckets) {
    if (bucket.recorded_s <= 0) continue;
    // As wide as what was recorded of it: the rest stays hatched.
    const share = Math.min(1, (1000 * bucket.recorded_s) / lengthMs);
    const [from, to] = [x(bucket.t_ms), x(bucket.t_ms + lengthMs * (share > 0.98 ? 1 : share))];
    for (let n = 0; n < 3; n += 1) part(n, from, to, 1, colour('--field'));
    const { all, fault } = stopOf(bucket);
    part(0, from, to, all / bucket.recorded_s, colour('--part-strong'));
    part(0, from, to, fault / bucket.recorded_s, colour('--red'));
    part(1, from, to, bucket.in_place_s / bucket.recorded_s, colour('--bar-strong'));
    part(2, from, to, bucket.may_move_s / bucket.recorded_s, colour('--bar'));
  }
  const [y, tall] = box(3);
  for (const event of events) {
    const [at, bad] = [x(event.t_ms), event.bad];
    g.fillStyle = bad ? colour('--red') : colour('--text');
    g.beginPath();
    if (bad) { // a triangle on its base, else a bar: never colour alone
      g.moveTo(at, y);
      g.lineTo(at + 5 * ratio, y + tall);
      g.lineTo(at - 5 * ratio, y + tall);
    } else g.rect(at - ratio, y, 2 * ratio, tall);
    g.fill();
  }
  if (atMs !== null && atMs >= sinceMs && atMs <= untilMs) {
    g.strokeStyle = colour('--focus');
    g.lineWidth = 2 * ratio;
    g.beginPath();
    g.moveTo(x(atMs), 0);
    g.lineTo(x(atMs), height);
    g.stroke();
  }
}

/**
 * `viewed`: the time that the view is of, which may be another than the shown one while the next view is on its way (`busy`).
 * @param {{view: {buckets: any[], bucket_ms: number}|null, viewed: {sinceMs: number, untilMs: number}|null, busy: boolean, events: any[], sinceMs: number, untilMs: number,
 * atMs: number|null, pick: (ms: number) => void, pan?: (share: number) => void, label: string}} props
 */
export function Timeline({ view, viewed, busy, events, sinceMs, untilMs, atMs, pick, pan, label }) {
  const holder = useRef(null);
  const paint = useRef(() => {});
  const [cursor, setCursor] = useState(/** @type {number|null} */ (null));
  const live = useRef({});
  const of = view === null ? null : viewed;
  live.current = { view, viewed: of, busy, events, sinceMs, untilMs, atMs, pick, pan };

  useEffect(() => {
    const [first, second, below] = holder.current.children;
    const sync = `history-${label}`;
    const moved = (u) => setCursor(u.cursor.left >= 0 && u.cursor.left != null ? Math.round(1000 * u.posToVal(u.cursor.left, 'x')) : null);
    const radius = chart(first, { label: 'R', unit: 'px', names: ['r_min', 'r_max', 'r_mean'], bare: true, sync, moved });
    const distance = chart(second, { label: 'Z', unit: lengthUnit(), names: ['z_min', 'z_max', 'z_mean'], bare: false, sync, moved });
    const draw = () => {
      const now = live.current;
      const buckets = now.view?.buckets ?? [];
      const lengthMs = now.view?.bucket_ms ?? 60_000;
      for (const one of [radius, distance]) {
        const [at, ...values] = columns(buckets, lengthMs, one.names);
        const data = [at, ...(one === distance ? values.map((column) => column.map(inUnit)) : values)];
        one.limits.most = nice(1.05 * data[2].reduce((most, value) => Math.max(most, value ?? 0), 0.01));
        one.plot.batch(() => {
          one.plot.setData(data, false);
          one.plot.setScale('x', { min: now.sinceMs / 1000, max: now.untilMs / 1000 });
        });
      }
      strip(below, distance.plot, { ...now, buckets, lengthMs });
    };
    const resize = () => {
      const { clientWidth: width, clientHeight: height } = holder.current;
      const room = height - below.clientHeight - 6;
      if (width < 50 || room < 80) return;
      const axis = AXIS * textScale();
      const [upper, lower] = [Math.floor((room - axis) / 2), Math.ceil((room + axis) / 2)];
      second.style.top = `${upper}px`;
      radius.plot.setSize({ width, height: upper });
      distance.plot.setSize({ width, height: lower });
      draw();
    };
    const picked = (event) => {
      const { left } = radius.plot.over.getBoundingClientRect();
      const ms = Math.round(1000 * radius.plot.posToVal(event.clientX - left, 'x'));
      const now = live.current;
      if (ms >= now.sinceMs && ms <= now.untilMs) now.pick(ms);
    };
    const wheel = (event) => {
      if (!live.current.pan || (!event.deltaX && !event.shiftKey)) return; // upright, the page scrolls
      event.preventDefault();
      live.current.pan(Math.sign(event.deltaX || event.deltaY) * 0.08);
    };
    const at = holder.current;
    at.addEventListener('click', picked);
    at.addEventListener('wheel', wheel, { passive: false });
    const watch = new ResizeObserver(resize);
    watch.observe(at);
    paint.current = draw;
    resize();
    return () => {
      watch.disconnect();
      at.removeEventListener('click', picked);
      at.removeEventListener('wheel', wheel);
      radius.plot.destroy();
      distance.plot.destroy();
    };
  }, [label]);
  useEffect(() => paint.current(), [view, of?.sinceMs, of?.untilMs, busy, events, sinceMs, untilMs, atMs]);

  const readMs = cursor ?? atMs;
  const lengthMs = view?.bucket_ms ?? 60_000;
  const near = readMs === null ? [] : events.filter((event) => Math.abs(event.t_ms - readMs) < (untilMs - sinceMs) / 200).slice(0, 3);
  const here = of !== null && readMs !== null && readMs >= of.sinceMs && readMs <= of.untilMs;
  const read = here ? bucketText(bucketAt(view.buckets, lengthMs, readMs), lengthMs) : busy && readMs !== null ? text('Loading.') : '';
  const keys = (event) => {
    const share = { ArrowLeft: -0.1, ArrowRight: 0.1, PageUp: -1, PageDown: 1 }[event.key];
    if (!share || !pan) return;
    event.preventDefault();
    pan(share);
  };
  return html`<div class="timeline">
    <p class="read small"><span class="value">${readMs === null ? '' : stamp(readMs)}</span> ${read}
      ${near.map((event) => html` <span class=${`tag ${event.bad ? 'bad' : ''}`}>${listed([clock(event.t_ms), t(words(event.kind)), saidText(event).slice(0, 60)])}</span>`)}</p>
    <div class="charts" ref=${holder} tabindex=${pan ? 0 : undefined} onKeyDown=${keys} role="img"
      aria-label=${text('{0}: R in px, Z in {1}, outputs and events from {2} to {3}; {4}', t(label), lengthUnit(), stamp(sinceMs), stamp(untilMs), read)}>
      <div></div><div></div><canvas class="strip"></canvas>
    </div>
  </div>`;
}
