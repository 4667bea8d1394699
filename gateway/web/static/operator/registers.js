// The registers as a PLC reads them now: address, name, value, raw words. Names and meanings are those of docs/registers.md
// and of the exported PLC programs, in English.

import { html, useRef, useState } from '../lib/page.js';
import { NONE, number } from '../lib/format.js';
import { t, text } from '../lib/lang.js';
import { useKept, usePolled } from './hooks.js';
import { Notice } from './notice.js';

const hex = (words) => words.map((word) => word.toString(16).toUpperCase().padStart(4, '0')).join(' ');

/** An integer register shows what its count can tell; a float up to three places. */
const decimalsOf = (row) =>
  row.type.startsWith('float') ? (Math.abs(row.value) >= 1e5 ? 1 : 3) : Math.max(0, Math.min(6, Math.ceil(-Math.log10(row.scale))));

function shownOf(row) {
  if (row.value === null) return 'no value';
  const shown = number(row.value, decimalsOf(row));
  const bits = row.bits.filter((bit) => bit.on).map((bit) => bit.name);
  if (row.bits.length) return html`${shown}<span class="names" translate=${bits.length ? 'no' : undefined}> ${bits.join(', ') || 'none set'}</span>`;
  return row.text === null ? shown : html`${shown}<span class="names" translate="no"> ${row.text}</span>`;
}

/** Rows with all the words in address, name or meaning. Pure. */
export function found(rows, words) {
  const wanted = words.toLowerCase().split(/\s+/).filter(Boolean);
  return rows.filter((row) => {
    const searched = `${row.address} ${row.name} ${row.unit} ${row.meaning} ${row.text ?? ''}`.toLowerCase();
    return wanted.every((word) => searched.includes(word));
  });
}

export function Registers({ bay }) {
  const [open, setOpen] = useKept('operator.registers', false);
  const [filter, setFilter] = useState('');
  const read = usePolled(`/api/bays/${encodeURIComponent(bay)}/registers`, 500, open);
  const answer = read.last;
  const known = read.fresh(answer?.age_ms);
  const before = useRef(new Map());
  const changed = useRef(new Map());
  const rows = answer === null ? [] : answer.registers;
  const now = performance.now();
  for (const row of rows) {
    const raw = hex(row.words);
    if (before.current.has(row.address) && before.current.get(row.address) !== raw) changed.current.set(row.address, now);
    before.current.set(row.address, raw);
  }
  const shown = found(rows, filter);
  return html`<section class="panel registers" aria-labelledby="registers-title">
    <details open=${open} onToggle=${(event) => setOpen(event.target.open)}>
      <summary><h2 id="registers-title">${answer === null ? 'Registers as the PLC reads them' : `Registers as the PLC reads them (unit ${answer.unit_id})`}</h2></summary>
      ${open && html`<div class="row compact">
        <input type="search" placeholder="address, name, meaning" aria-label="search registers" value=${filter} onInput=${(event) => setFilter(event.target.value)} />
        <span class="small muted">${rows.length ? `${shown.length} of ${rows.length} rows; ◆ changed just now` : ''}</span>
      </div>
      <${Notice} kind="warn" say=${answer !== null && !known ? text('Not known now: {0}.', t(read.wrong || 'no new data')) : read.wrong} />
      <div class="scroll tall" tabindex="0" role="region" aria-label="register table">
        <table class="stack"><thead><tr><th scope="col" class="right">Address</th><th scope="col">Name</th><th scope="col" class="right">Value</th><th scope="col">Unit</th><th scope="col">Raw</th><th scope="col" class="wide">Meaning</th></tr></thead><tbody>
          ${shown.map((row) => {
            const fresh = known && now - (changed.current.get(row.address) ?? -1e9) < 1200;
            return html`<tr key=${row.address} class=${fresh ? 'changed' : ''}>
              <td class="right mono">${row.address}</td><td><span translate="no">${row.name}</span>${row.writable ? html` <span class="tag">PLC writes</span>` : ''}</td>
              <td class="right value">${fresh ? html`<span class="diamond" aria-hidden="true">◆ </span>` : ''}${known ? shownOf(row) : NONE}</td><td translate="no">${row.unit}</td>
              <td class="mono nowrap" translate="no">${known ? hex(row.words) : NONE}</td><td class="wide muted" translate="no">${row.meaning}</td></tr>`;
          })}
        </tbody></table>
      </div>`}
    </details>
  </section>`;
}
