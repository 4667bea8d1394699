// Why were the outputs as they were at the chosen moment? Asked on demand: it costs a second or more.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { language, listed, t, text } from '../lib/lang.js';
import { stamp, words } from '../lib/format.js';
import { stampOf } from '../lib/days.js';
import { saidText } from '../lib/said.js';
import { useAnswer } from './answers.js';
import { save } from './report.js';

const CHAIN = ['what', 'by', 'why'];
const timed = (rows, caption, shown) =>
  rows.length > 0 && html`<h3>${caption}</h3><table class="stack"><tbody>${rows.map((row) => html`<tr><td class="nowrap mono">${row.time.slice(11, 23)}</td>
    ${CHAIN.map((name) => html`<td translate="no">${shown(row[name])}</td>`)}</tr>`)}</tbody></table>`;

/** `asked`: counts what was asked; 0: nothing yet. */
export function Why({ bay, atMs, asked, ask }) {
  const at = `/api/bays/${encodeURIComponent(bay)}`;
  const [of, setOf] = useState(/** @type {number|null} */ (null));
  const panel = useRef(null);
  useEffect(() => setOf(null), [bay]);
  useEffect(() => {
    if (asked > 0 && atMs !== null) setOf(atMs);
  }, [asked]);
  useEffect(() => {
    if (asked > 0) panel.current.scrollIntoView(); // by the address
  }, []);
  const { answer, wrong, busy } = useAnswer(of === null ? null : `${at}/why?at_ms=${of}`, { timeoutMs: 110_000, key: asked });
  const [report, setReport] = useState({ busy: false, wrong: '' });
  const reportPath = `${at}/why.html?at_ms=${atMs}`;
  const translated = async (/** @type {Event} */ event) => {
    if (language() === 'en') return; // as the gateway makes it
    event.preventDefault();
    setReport({ busy: true, wrong: '' });
    const name = `why-${bay}-${new Date(atMs).toISOString().slice(0, 19).replace(/[-:]/g, '')}Z.html`;
    setReport({ busy: false, wrong: await save(reportPath, name).then(() => '', (error) => error.message) });
  };
  const outputs = answer?.outputs;
  const shown = (/** @type {string} */ text) => saidText({ said: answer.said[text], detail: text });
  return html`<section class="panel why-panel" ref=${panel} aria-labelledby="why-title">
    <header>
      <h2 id="why-title">Why?</h2>
      <div class="row compact">
        <span class="small value">${atMs === null ? 'choose a moment in the timeline' : stamp(atMs, { ms: true })}</span>
        <button type="button" class="primary" disabled=${atMs === null || busy} onClick=${ask}>Why?</button>
        ${atMs !== null && html`<a class="button" href=${reportPath} download onClick=${translated}>Report</a>`}
      </div>
    </header>
    <div aria-live="polite">
      ${(busy || report.busy) && html`<p class="muted">The decision is being taken again from the recording; that takes some seconds.</p>`}
      ${(wrong || report.wrong) && html`<p class="notice warn">${wrong || report.wrong}</p>`}
    </div>
    ${answer && !busy && html`<div class="answer" tabindex="0" role="region" aria-label="the answer">
      <p class="small muted" translate="no">${stampOf(answer.time, { ms: true })}</p>
      <p class="headline" translate="no">${shown(answer.headline)}</p>
      ${answer.warnings.filter((text) => text !== answer.headline).map((text) => html`<p class="notice warn small" translate="no">${shown(text)}</p>`)}
      ${outputs && html`<p class="small">${listed([`stop ${outputs.stop}`, `may_move ${outputs.may_move}`, `in_place ${outputs.in_place}`, text('reason: {0}', t(words(outputs.reason))), answer.since && text('so since {0}', stampOf(answer.since, { ms: true }))])}</p>`}
      ${answer.causes.length > 1 && html`<h3>Besides</h3><ul class="notes">${answer.causes.slice(1).map((cause) => html`<li translate="no">${shown(cause.text)}</li>`)}</ul>`}
      ${timed(answer.chain, 'How it came about', shown)}
      ${timed(answer.after, 'And then', shown)}
      ${timed(answer.done, 'Who did what', shown)}
      <p class="small muted">${answer.pictures.length === 1 ? '1 picture is kept round it.' : `${answer.pictures.length} pictures are kept round it.`} ${'The report has them, with plots, the state vector and the settings.'}</p>
    </div>`}
  </section>`;
}
