// What the tried settings do, beside those in force and the robust method: found, still, apart, how long.

import { html, translated } from '../lib/page.js';
import { NONE, known, number, signed } from '../lib/format.js';
import { listed, t, text } from '../lib/lang.js';

const percent = (share) => `${number(100 * share, 0)} %`;

function Row({ name, unit, cells, better }) {
  return html`<tr><th scope="row">${name}${unit ? html` <span class="muted">${unit}</span>` : ''}</th>
    ${cells.map((cell, n) => html`<td class=${`right ${better === n ? 'better' : ''}`}>${cell}</td>`)}</tr>`;
}

/** One bar of stages, as long as its share of the longest. */
function TimeBar({ side, longest, name }) {
  let left = 0;
  const parts = side.stages.map((stage, n) => {
    const width = (100 * stage.ms) / longest;
    const part = html`<rect x=${left} y="0" width=${Math.max(0, width - 0.15)} height="10" fill=${n % 2 ? 'var(--part)' : 'var(--part-strong)'}><title translate="no">${stage.name}: ${number(stage.ms, 2)} ms</title></rect>`;
    left += width;
    return part;
  });
  return html`<div class="timebar"><span class="name">${name}</span>
    <svg viewBox="0 0 100 10" preserveAspectRatio="none" role="img" aria-label=${text('{0}: {1} ms a frame', t(name), number(side.total_ms, 2))}>${parts}</svg>
    <span class="value right">${number(side.total_ms, side.total_ms < 10 ? 2 : 1, 'ms')}</span></div>`;
}

/** R over the frames of a recording: tried, in force, reference. */
function Trace({ result }) {
  const rows = [
    { name: 'robust, as shipped', frames: result.reference, stroke: 'var(--part)', wide: 5, dash: null },
    { name: 'in force', frames: result.in_force.frames, stroke: 'var(--text)', wide: 1.6, dash: '5 4' },
    { name: 'tried', frames: result.tried.frames, stroke: 'var(--blue)', wide: 2, dash: null },
  ];
  const radii = rows.flatMap((row) => row.frames.map((frame) => frame.radius_px)).filter(known);
  if (result.frames < 3 || !radii.length) return '';
  const [low, high] = [Math.min(...radii), Math.max(...radii)];
  const room = Math.max(1, (high - low) * 0.15);
  const x = (n) => 4 + (592 * n) / (result.frames - 1);
  const y = (radius) => 116 - (112 * (radius - low + room)) / (high - low + 2 * room);
  const path = (frames) => {
    let pen = 'M';
    return frames.map((frame, n) => {
      if (!known(frame.radius_px)) {
        pen = 'M';
        return '';
      }
      const step = `${pen}${x(n).toFixed(1)} ${y(frame.radius_px).toFixed(1)}`;
      pen = 'L';
      return step;
    }).join('');
  };
  return html`<figure class="trace"><figcaption class="small">${text('R over the recording, {0} to {1}; a gap: not found', number(low, 1), number(high, 1, 'px'))}</figcaption>
    <svg viewBox="0 0 600 120" preserveAspectRatio="none" role="img" aria-label=${`radius over ${result.frames} frames`}>
      ${rows.map((row) => html`<path d=${path(row.frames)} fill="none" stroke=${row.stroke} stroke-width=${row.wide} stroke-dasharray=${row.dash} vector-effect="non-scaling-stroke" />`)}
    </svg>
    <ul class="legend small">${rows.map((row) => html`<li><svg viewBox="0 0 30 8" aria-hidden="true"><path d="M1 4H29" stroke=${row.stroke} stroke-width=${row.wide} stroke-dasharray=${row.dash} /></svg> ${row.name}</li>`)}</ul>
  </figure>`;
}

/** One sentence for screen readers, and for a glance. */
export function summary(result) {
  if (!result) return '';
  const { tried, in_force: before } = result;
  const many = result.frames > 1;
  const seen = many ? text('found in {0} of {1} frames', percent(tried.found_share), result.frames) : tried.frames[0].found ? `marker found, R ${number(tried.frames[0].radius_px, 2, 'px')}` : 'no marker found';
  const apart = result.from_in_force ? `${number(result.from_in_force.centre_px, 2, 'px')} from the settings in force, R ${signed(result.from_in_force.radius_px, 2, 'px')}` : before.found_share > tried.found_share ? 'the settings in force find it' : '';
  const time = result.timed ? times(result.time_ratio) : '';
  return [seen, apart, time].filter(Boolean).map(translated).join('; ');
}

function times(ratio) {
  if (ratio > 0.95 && ratio < 1.05) return 'as fast as the settings in force';
  return ratio < 1 ? `${number(1 / ratio, 1)} times as fast as the settings in force` : `takes ${number(ratio, 1)} times as long as the settings in force`;
}

export function Effect({ result, waiting }) {
  if (!result) return html`<section class="panel effect" aria-labelledby="effect-title"><header><h2 id="effect-title">Effect</h2></header><p class="muted">Nothing has been tried yet.</p></section>`;
  const { tried, in_force: before, reference } = result;
  const at = result.frames > 1 ? result.shown : 0;
  const of = (frames) => frames[Math.min(at, frames.length - 1)];
  const sides = [of(tried.frames), of(before.frames), of(reference)];
  const wobble = (side, part) => (side.jitter ? number(side.jitter[part], 3) : NONE);
  const longest = Math.max(tried.total_ms, before.total_ms, 1e-6);
  const away = (apart) => (apart ? result.frames > 1 ? text('{0}, at most {1}', number(apart.centre_px, 2), number(apart.centre_largest_px, 2)) : number(apart.centre_px, 2) : NONE);
  const larger = (apart) => (apart ? signed(apart.radius_px, 2) : NONE);
  return html`<section class="panel effect" aria-labelledby="effect-title" aria-busy=${waiting}>
    <header><h2 id="effect-title">Effect</h2><span class="small muted">${listed([result.frames > 1 ? text('{0} frames', result.frames) : t('one frame'), result.cut_short && t('cut short')], ', ')}</span></header>
    <p class="verdict" translate="no">${summary(result)}</p>
    <div class="scroll plainscroll"><table>
      <thead><tr><th scope="col"><span class="sr">what</span></th><th scope="col" class="right">tried</th><th scope="col" class="right">in force</th><th scope="col" class="right">robust, as shipped</th></tr></thead>
      <tbody>
        <${Row} name="found" cells=${[percent(tried.found_share), percent(before.found_share), percent(reference.filter((one) => one.found).length / reference.length)]} />
        <${Row} name="u" unit="px" cells=${sides.map((one) => number(one.u_px, 2))} />
        <${Row} name="v" unit="px" cells=${sides.map((one) => number(one.v_px, 2))} />
        <${Row} name="R" unit="px" cells=${sides.map((one) => number(one.radius_px, 2))} />
        <${Row} name="confidence" cells=${sides.map((one) => number(one.confidence, 2))} />
        ${result.frames > 1 && html`
          <${Row} name="jitter of u, v" unit="px" cells=${[`${wobble(tried, 'u_px')}, ${wobble(tried, 'v_px')}`, `${wobble(before, 'u_px')}, ${wobble(before, 'v_px')}`, NONE]} />
          <${Row} name="jitter of R" unit="px" cells=${[wobble(tried, 'radius_px'), wobble(before, 'radius_px'), NONE]} />`}
        <${Row} name="tried lies off by" unit="px" cells=${['', away(result.from_in_force), away(result.from_reference)]} />
        <${Row} name="tried R is larger by" unit="px" cells=${['', larger(result.from_in_force), larger(result.from_reference)]} />
      </tbody>
    </table></div>
    <${Trace} result=${result} />
    <h3>Time a frame</h3>
    <${TimeBar} side=${tried} longest=${longest} name="tried" /><${TimeBar} side=${before} longest=${longest} name="in force" />
    <p class="hint">${result.timed ? 'Medians, the two in turn on this machine; the ratio holds when it is busy, too. The shades are the stages.' : 'A single look; the time is measured when the controls rest.'}</p>
  </section>`;
}

/** `judged`: the frame that the light was judged on, where the one on the page is another. */
export function Remarks({ remarks, light, judged }) {
  const loose = remarks.filter((remark) => !remark.key);
  const keyed = remarks.filter((remark) => remark.key);
  const all = [...loose, ...keyed];
  return html`<section class="panel remarks" aria-labelledby="remarks-title">
    <header><h2 id="remarks-title">Remarks</h2></header>
    ${all.length
      ? html`<ul>${all.map((remark) => html`<li class=${`said ${remark.warning ? 'warning' : ''}`}><span aria-hidden="true">${remark.warning ? '▲' : '•'}</span>
          ${remark.text}${remark.key ? html` <a class="nowrap" href=${`#k-${remark.key}`} onClick=${(event) => jump(event, remark.key)}>to the control</a>` : ''}</li>`)}</ul>`
      : html`<p class="muted">Nothing speaks against these settings in these frames.</p>`}
    <h3>Exposure</h3>
    ${light && judged !== null && html`<p class="hint">${`Judged on frame ${judged}. Freeze the picture to judge it anew.`}</p>`}
    ${light
      ? html`<ul>${light.advice.map((one) => html`<li class="said"><span aria-hidden="true">•</span> ${one}</li>`)}</ul>
          <p class="hint" translate="no">${figures(light)}</p>`
      : html`<p class="muted">Judged when the controls rest.</p>`}
  </section>`;
}

function jump(event, key) {
  event.preventDefault();
  /** @type {HTMLElement|null} */
  const control = document.querySelector(`[name='${key}'], [name^='${key}.']`);
  control?.closest('details')?.setAttribute('open', '');
  control?.scrollIntoView({ block: 'center' });
  control?.focus();
}

function figures({ figures: f, marker_seen: seen }) {
  const facts = [
    ['noise', `${number(f.noise, 1)} ${translated('grey levels')}`],
    ['clipped highlights', percent(f.clipped)],
    ...(known(f.marker_v) ? [['marker V', number(f.marker_v)], ['marker S', number(f.marker_s)], ['marker clipped', percent(f.marker_clipped)]] : []),
    ...(known(f.edge_px) ? [['rim width', number(f.edge_px, 1, 'px')]] : []),
    ...(known(f.warmth) ? [['red over blue of grey', number(f.warmth, 2)]] : []),
  ];
  const all = facts.map(([name, value]) => `${translated(name)} ${value}`);
  return [...all, ...(seen ? [] : [translated('no marker is sure, so nothing is said of it')])].join('; ');
}
