// Which board is held before the camera, and how to hold it.

import { html, useState } from '../lib/page.js';
import { text } from '../lib/lang.js';
import { remember, remembered } from '../lib/memory.js';

const KEY = 'gateway.calibration.board';
const USUAL = { kind: 'checkerboard', columns: 9, rows: 6, pitch_mm: 25, distortion: 'auto' };
const KINDS = [
  ['checkerboard', 'checkerboard', 'inner corners in a row', 'inner corners in a column', 'side of a square, mm'],
  ['circles', 'circles', 'circles in a row', 'circles in a column', 'distance of neighbours, mm'],
  ['asymmetric-circles', 'circles, every other row shifted', 'circles in a row', 'rows', 'distance from row to row, mm'],
];
const LIMITS = { columns: [3, 100], rows: [3, 100], pitch_mm: [0.1, 10_000] };

function kept() {
  try {
    return { ...USUAL, ...JSON.parse(remembered(KEY) ?? '{}') };
  } catch {
    return USUAL;
  }
}

const right = (key, value) => Number.isFinite(value) && value >= LIMITS[key][0] && value <= LIMITS[key][1] && (key === 'pitch_mm' || Number.isInteger(value));

export function BoardForm({ base, begin, busy }) {
  const [board, setBoard] = useState(kept);
  const [, , columns, rows, pitch] = KINDS.find(([kind]) => kind === board.kind) ?? KINDS[0];
  const wrong = Object.keys(LIMITS).filter((key) => !right(key, board[key]));
  const go = (event) => {
    event.preventDefault();
    if (wrong.length) return;
    remember(KEY, JSON.stringify(board));
    begin(board);
  };
  const query = new URLSearchParams({ kind: board.kind, columns: board.columns, rows: board.rows, pitch_mm: board.pitch_mm });
  const field = (key, label, step) => html`<label>${label}
    <input type="number" min=${LIMITS[key][0]} max=${LIMITS[key][1]} step=${step} value=${board[key]} aria-invalid=${String(wrong.includes(key))} onInput=${(event) => setBoard({ ...board, [key]: event.target.value === '' ? '' : Number(event.target.value) })} />
    ${wrong.includes(key) && html`<small role="alert">${LIMITS[key][0]} to ${LIMITS[key][1]}</small>`}</label>`;
  return html`<section class="panel whole board" aria-labelledby="board-title">
    <header><h2 id="board-title">The board</h2></header>
    <form class="fields" onSubmit=${go}>
      <label>kind <select value=${board.kind} onChange=${(event) => setBoard({ ...board, kind: event.target.value })}>
        ${KINDS.map(([kind, name]) => html`<option value=${kind} selected=${kind === board.kind}>${name}</option>`)}</select></label>
      ${field('columns', columns, 1)}${field('rows', rows, 1)}${field('pitch_mm', pitch, 'any')}
      <label>distortion <select value=${board.distortion} onChange=${(event) => setBoard({ ...board, distortion: event.target.value })}>
        ${['auto', '0', '4', '5', '8'].map((name) => html`<option value=${name} selected=${name === board.distortion}>${name === 'auto' ? 'as many coefficients as can be determined' : text('{0} coefficients', name)}</option>`)}</select></label>
      <div class="row"><button class="primary" disabled=${busy || wrong.length > 0}>Begin</button>
        ${wrong.length === 0 && html`<a class="button" href=${`${base}/board.svg?${query}`} target="_blank" rel="noopener">Print this board</a>`}</div>
    </form>
    <ul class="hints">
      <li>A checkerboard counts inner corners: one less than squares each way. Measure a square of the print: printers scale.</li>
      <li>Print at 100 %, and glue it to something flat and stiff, with a light rim of one square all round. 9 x 6 corners of 20 mm fit on A4, of 25 mm on A3.</li>
      <li>Focus, zoom and picture size of the camera as in operation: the result holds for these only.</li>
      <li>Hold the board near and far, in the middle and in every corner of the picture, tilted by 20 to 45 degrees left, right, up and down. Hold it still for half a second: the view is taken by itself.</li>
      <li>The bay goes on working meanwhile, and what you hold before its camera counts: where the PLC might begin to load, begin a function check on the technician's page first.</li>
    </ul>
  </section>`;
}
