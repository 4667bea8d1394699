// A dialog over the page; the difference of a file, line by line.

import { html, useEffect, useRef } from './page.js';

/** `id`: of its title, unique on the page. @param {{id: string, title: any, close: () => void, kind?: string, children?: any}} what */
export function Dialog({ id, title, close, kind, children }) {
  const dialog = useRef(null);
  useEffect(() => {
    const element = dialog.current;
    element.showModal();
    return () => element.close();
  }, []);
  return html`<dialog ref=${dialog} class=${kind} aria-labelledby=${id} onCancel=${(event) => { event.preventDefault(); close(); }}>
    <h2 id=${id}>${title}</h2>${children}</dialog>`;
}

const kindOf = (line) => (/^(\+\+\+|---|@@)/.test(line) ? 'place' : line.startsWith('+') ? 'added' : line.startsWith('-') ? 'removed' : '');

/** A unified diff. @param {{text: string}} what */
export const Diff = ({ text }) => html`<pre class="diff" tabindex="0" role="region" aria-label="what would change in the file">${text.trimEnd().split('\n').map((line) => html`<span class=${kindOf(line)} translate="no">${line}${'\n'}</span>`)}</pre>`;
