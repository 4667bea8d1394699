// The registers as a PLC reads them now: address, name, value, raw words.

import { html, useRef, useState } from '../vendor/preact-htm.js';
import { number } from '../lib/format.js';
import { useFetched, useKept } from './hooks.js';

const hex = (words) => (words ?? []).map((word) => Number(word).toString(16).toUpperCase().padStart(4, '0')).join(' ');

function valueOf(row) {
  if (row.text != null && row.text !== '') return row.text;
  if (row.value == null) return 'no value';
  if (typeof row.value !== 'number') return String(row.value);
  const decimals = row.scale && row.scale < 1 ? Math.min(6, Math.ceil(-Math.log10(row.scale))) : Number.isInteger(row.value) ? 0 : 3;
  return number(row.value, decimals);
}

/** Rows with all the words in address, name or meaning. Pure. */
export function found(rows, text) {
  const wanted = text.toLowerCase().split(/\s+/).filter(Boolean);
  return rows.filter((row) => {
    const said = `${row.address} ${row.name} ${row.unit ?? ''} ${row.meaning ?? ''}`.toLowerCase();
    return wanted.every((word) => said.includes(word));
  });
}

export function Registers({ bay, known }) {
  const [open, setOpen] = useKept('operator.registers', false);
  const [text, setText] = useState('');
  const [answer, wrong] = useFetched(`/api/bays/${encodeURIComponent(bay)}/registers`, bay, 500, open);
  const before = useRef(new Map());
  const changed = useRef(new Map());
  const rows = answer === null ? [] : Array.isArray(answer) ? answer : answer.registers ?? [];
  const now = performance.now();
  for (const row of rows) {
    const raw = hex(row.words ?? row.raw);
    if (before.current.has(row.address) && before.current.get(row.address) !== raw) changed.current.set(row.address, now);
    before.current.set(row.address, raw);
  }
  const shown = found(rows, text);
  return html`<section class="panel registers" aria-labelledby="registers-title">
    <details open=${open} onToggle=${(event) => setOpen(event.target.open)}>
      <summary><h2 id="registers-title">Registers as the PLC reads them${answer?.unit_id != null ? ` (unit ${answer.unit_id})` : ''}</h2></summary>
      ${open && html`<div class="row compact">
        <input type="search" placeholder="address, name, meaning" aria-label="search registers" value=${text} onInput=${(event) => setText(event.target.value)} />
        <span class="small muted">${rows.length ? `${shown.length} of ${rows.length} rows; ◆ changed just now` : ''}</span>
      </div>
      ${(wrong || !known) && html`<p class="notice warn small">These may be old: ${wrong || 'no connection to the gateway'}.</p>`}
      <div class="scroll tall" tabindex="0" role="region" aria-label="register table">
        <table class="stack"><thead><tr><th scope="col" class="right">Address</th><th scope="col">Name</th><th scope="col" class="right">Value</th><th scope="col">Unit</th><th scope="col">Raw</th><th scope="col" class="wide">Meaning</th></tr></thead><tbody>
          ${shown.map((row) => {
            const fresh = now - (changed.current.get(row.address) ?? -1e9) < 1200;
            return html`<tr key=${row.address} class=${fresh ? 'changed' : ''}>
              <td class="right mono">${row.address}</td><td>${row.name}</td>
              <td class="right value">${fresh ? html`<span class="diamond" aria-hidden="true">◆ </span>` : ''}${valueOf(row)}</td><td>${row.unit ?? ''}</td>
              <td class="mono nowrap">${hex(row.words ?? row.raw)}</td><td class="wide muted">${row.meaning ?? ''}</td></tr>`;
          })}
        </tbody></table>
      </div>`}
    </details>
  </section>`;
}
