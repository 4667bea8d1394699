// The score of the tried settings on a test set, beside those in force: figures, warnings, and what they say of each picture.

import { html, translated, useState } from '../lib/page.js';
import { Dialog } from '../lib/dialog.js';
import { number, percent, signed } from '../lib/format.js';
import { text } from '../lib/lang.js';
import { Ring } from './labelling.js';

const WORDS = { close: 'found, within 5 %', loose: 'found, not within 5 %', wrong: 'wrong place', missed: 'missed', false: 'false: no marker is there', clear: 'nothing, as it should be' };
const BAD = new Set(['wrong', 'missed', 'false']);
const WIDTH_PX = 1280;

function Figures({ result }) {
  const sides = [result.tried, result.in_force];
  const of = (key, decimals, unit) => sides.map((side) => number(side[key], decimals, unit));
  const counts = (key, total) => sides.map((side) => `${side[key]} of ${side[total]}`);
  /** @type {[string, string[]][]} */
  const rows = [
    ['marker found', counts('found', 'with_marker')],
    ['within 5 % of the radius', counts('close', 'with_marker')],
    ['missed', of('missed')],
    ['wrong place', of('wrong')],
    ['false, where no marker is', counts('false', 'without_marker')],
    ['error of the centre, median', of('centre_median_px', 2, 'px')],
    ['error of the centre, 95 % below', of('centre_p95_px', 2, 'px')],
    ['error of the radius, median', of('radius_median_pct', 2, '%')],
    ['error of the radius, 95 % below', of('radius_p95_pct', 2, '%')],
  ];
  return html`<table class="figures"><thead><tr><th scope="col"><span class="sr">what</span></th><th scope="col" class="right">tried</th><th scope="col" class="right">in force</th></tr></thead>
    <tbody>${rows.map(([name, cells]) => html`<tr><th scope="row">${name}</th>${cells.map((cell) => html`<td class="right">${cell}</td>`)}</tr>`)}</tbody></table>`;
}

function Answer({ side }) {
  const off = side.centre_px === null ? '' : `${number(side.centre_px, 1, 'px')}, ${signed(side.radius_pct, 1, '%')}`;
  return html`<td>${BAD.has(side.verdict) && html`<span class="tag warn" aria-hidden="true">!</span> `}<span>${WORDS[side.verdict]}</span>${off && html` <span class="small muted nowrap">${off}</span>`}</td>`;
}

const worth = (row) => row.differs || BAD.has(row.tried.verdict) || BAD.has(row.in_force.verdict);

function Rows({ rows, url, open }) {
  return html`<div class="scroll setrows" tabindex="0" role="group" aria-label="pictures of the set"><table><thead><tr><th scope="col">picture</th><th scope="col">tried</th><th scope="col">in force</th></tr></thead>
    <tbody>${rows.map((row) => html`<tr key=${row.file} data-differs=${row.differs}><th scope="row"><button type="button" class="plain" onClick=${() => open(row.file)}>
        ${worth(row) && html`<img class="shot" loading="lazy" alt="" src=${`${url(row.file)}?width=160`} />`}<span class="mono" translate="no">${row.file}</span></button></th>
      <${Answer} side=${row.tried} /><${Answer} side=${row.in_force} /></tr>`)}</tbody></table></div>`;
}

function Compared({ row, url, close }) {
  const kinds = [['label', 'label', row.label], ['in-force', 'in force', row.in_force.marker], ['tried', 'tried', row.tried.marker]];
  return html`<${Dialog} id="compared-title" kind="compared" title=${html`<span class="mono" translate="no">${row.file}</span>`} close=${close}>
    <div class="stack"><img class="shot" alt="the picture with the results of both settings" src=${`${url}?width=${Math.min(row.width_px, WIDTH_PX)}`} />
      <svg class="overlay" viewBox=${`0 0 ${row.width_px} ${row.height_px}`} aria-hidden="true">${kinds.map(([kind, , circle]) => html`<${Ring} circle=${circle} kind=${kind} size=${row} />`)}</svg></div>
    <ul class="legend small">${kinds.map(([kind, name, circle]) => html`<li><svg viewBox="0 0 30 8" class="ring" aria-hidden="true"><path class="halo" stroke-width="6" d="M1 4H29" /><path class=${kind} stroke-width="3" d="M1 4H29" /></svg>
      <span>${name}</span><span class="muted">${circle ? `u ${number(circle.u_px, 1)}, v ${number(circle.v_px, 1)}, R ${number(circle.radius_px, 1, 'px')}` : 'no marker'}</span></li>`)}</ul>
    <div class="row"><button type="button" autofocus onClick=${close}>Close</button></div>
  </${Dialog}>`;
}

const pace = (ratio) => (ratio === null ? '' : `A picture takes ${percent(ratio)} of the time that the settings in force take.`);

/** `score`: {view, vision}, of whatever settings; `settings`: on the page. */
export function SetScore({ labelled, score, settings, run, running, cancel, busy, url }) {
  const [file, setFile] = useState('');
  const view = score?.view ?? null;
  const result = view?.result ?? null;
  const row = result?.rows.find((one) => one.file === file) ?? null;
  const old = result && !running && JSON.stringify(score.vision) !== JSON.stringify(settings);
  return html`<section class="setscore" aria-labelledby="setscore-title">
    <h3 id="setscore-title">Score</h3>
    <div class="row">
      <button type="button" class="primary" disabled=${busy || !labelled} onClick=${run}>Score these settings</button>
      ${running && html`<progress max=${view?.total || 1} value=${view?.done ?? 0} aria-label="pictures scored"></progress>
        <span class="small" role="status">${`${view?.done ?? 0} of ${view?.total ?? labelled} pictures`}</span><button type="button" onClick=${cancel}>Cancel scoring</button>`}
      ${!labelled && html`<span class="small muted">Label a picture first.</span>`}
    </div>
    ${view?.failed && !running && html`<p class="notice warn" role="status">${text('Not scored: {0}', translated(view.failed))}</p>`}
    ${result && html`<div class=${old ? 'elsewhere' : ''}>
      ${old && html`<p class="notice warn">This score is of other settings than those on the page.</p>`}
      ${result.warnings.length
        ? html`<ul class="setwarnings">${result.warnings.map((each) => html`<li class="said warning" key=${each.id}><span aria-hidden="true">▲</span> <span>${each.text}</span></li>`)}</ul>`
        : html`<p role="status"><strong>Passed:</strong> <span>every marker is found, nothing else, and nothing is worse than with the settings in force.</span></p>`}
      <div class="scored"><div><${Figures} result=${result} /><p class="hint">${pace(result.time_ratio)}</p></div>
        <${Rows} rows=${result.rows} url=${url} open=${setFile} /></div>
      ${result.unread.map((one) => html`<p class="small"><span class="mono" translate="no">${one.file}</span>: <span>${one.why}</span></p>`)}
    </div>`}
    ${row && html`<${Compared} row=${row} url=${url(row.file)} close=${() => setFile('')} />`}
  </section>`;
}
