// Small signs. Each has a shape of its own; those that mean something abnormal have a colour, too.

import { t, text } from '../lib/lang.js';
import { html } from '../lib/page.js';
import { PATHS } from '../lib/symbols.js';
import { words } from '../lib/format.js';

/** NAMUR NE 107: circle F, triangle on its tip C, triangle S, diamond M; a plain ring with a tick where all is good. */
const NE107 = {
  FAILURE: { letter: 'F', shape: 'M12 1A11 11 0 1 1 11.99 1Z', fill: 'var(--red)', ink: '#fff', y: 12.5 },
  FUNCTION_CHECK: { letter: 'C', shape: 'M0.5 2H23.5L12 23Z', fill: 'var(--orange)', ink: '#fff', y: 9 },
  OUT_OF_SPECIFICATION: { letter: 'S', shape: 'M12 1L23.5 22H0.5Z', fill: 'var(--yellow)', ink: 'var(--yellow-ink)', y: 15 },
  MAINTENANCE_REQUIRED: { letter: 'M', shape: 'M12 0.5L23.5 12L12 23.5L0.5 12Z', fill: 'var(--blue)', ink: '#fff', y: 12.5 },
};
const NE107_WORDS = {
  GOOD: 'good',
  FAILURE: 'failure',
  FUNCTION_CHECK: 'function check',
  OUT_OF_SPECIFICATION: 'out of specification',
  MAINTENANCE_REQUIRED: 'maintenance required',
};

/** `name`: as in the state; null: not known. `alarm`: one is active, beside which nothing is called good. */
export function Ne107({ name, label = true, alarm = false }) {
  if (name === 'GOOD' && alarm) return html`<${Health} state="warn" text=${label ? 'alarm active' : html`<span class="sr">alarm active</span>`} />`;
  const sign = NE107[name];
  const said = name === null ? 'not known' : NE107_WORDS[name] ?? words(name);
  return html`<span class=${`sign ${sign ? 'warn' : ''}`} title=${text('NE 107: {0}', t(said))}>
    <svg viewBox="0 0 24 24" aria-hidden="true">
      ${sign
        ? html`<path d=${sign.shape} fill=${sign.fill} stroke="var(--text)" stroke-width="0.8" />
            <text x="12" y=${sign.y} fill=${sign.ink} font-size="11" font-weight="700" text-anchor="middle" dominant-baseline="central">
              ${sign.letter}
            </text>`
        : name === null
          ? html`<circle cx="12" cy="12" r="9.5" fill="none" stroke="var(--muted)" stroke-width="2" stroke-dasharray="3 3" />`
          : html`<circle cx="12" cy="12" r="9.5" fill="none" stroke="var(--muted)" stroke-width="2" />
              <path d="M7.5 12.5L10.7 15.7L16.8 9" fill="none" stroke="var(--muted)" stroke-width="2" />`}
    </svg>
    <span class=${label ? '' : 'sr'}>${label ? said : text('NE 107: {0}', t(said))}</span>
  </span>`;
}

const STATES = {
  ok: html`<circle cx="12" cy="12" r="9" fill="none" stroke="var(--muted)" stroke-width="2" /><path d="M7.5 12.5L10.7 15.7L16.8 9" fill="none" stroke="var(--muted)" stroke-width="2" />`,
  off: html`<circle cx="12" cy="12" r="9" fill="none" stroke="var(--muted)" stroke-width="2" stroke-dasharray="3 3" />`,
  warn: html`<path d="M12 1.5L23 21.5H1Z" fill="var(--yellow)" stroke="var(--text)" /><path d="M12 8.5V15M12 17V19.5" stroke="var(--yellow-ink)" stroke-width="2.2" />`,
  bad: html`<path d="M12 0.8L23.2 12L12 23.2L0.8 12Z" fill="var(--red)" /><path d="M12 6V13.5M12 15.8V18.4" stroke="#fff" stroke-width="2.4" />`,
};

/** Of a part or a link: ok, off (not there, or not yet), warn, bad. */
export const Health = ({ state, text }) => html`<span class=${`sign ${state}`}>
  <svg viewBox="0 0 24 24" aria-hidden="true">${STATES[state]}</svg><span>${text}</span>
</span>`;

/** Of an alarm's priority: 3 high, 2 medium, 1 low; hollow once it has been acknowledged. */
export function Priority({ level, acknowledged }) {
  const [shape, colour, name, ink] = {
    3: ['M1 1H23V23H1Z', 'var(--red)', 'high', '#fff'],
    2: ['M12 1.5L23 21.5H1Z', 'var(--yellow)', 'medium', 'var(--yellow-ink)'],
    1: ['M1 2H23L12 22Z', 'var(--blue)', 'low', '#fff'],
  }[level] ?? ['M1 1H23V23H1Z', 'var(--muted)', 'unknown', '#fff'];
  return html`<span class="sign" title=${text('priority {0}', t(name))}>
    <svg viewBox="-1 -1 26 26" aria-hidden="true">
      <path d=${shape} fill=${acknowledged ? 'var(--panel)' : colour} stroke=${acknowledged ? colour : 'var(--text)'} stroke-width=${acknowledged ? 3 : 1} />
      <text x="12" y=${level === 2 ? 15 : level === 1 ? 9 : 12.5} font-size="11" font-weight="700" fill=${acknowledged ? 'var(--text)' : ink} text-anchor="middle" dominant-baseline="central">${level}</text>
    </svg><span class="sr">${text('priority {0}', t(name))}</span>
  </span>`;
}

/** Of the driver's guidance. */
export const Arrow = ({ name }) => html`<svg viewBox="0 0 100 100" aria-hidden="true" class="arrow"><path d=${PATHS[name]} fill="currentColor" fill-rule="evenodd" /></svg>`;

/** In place: the spout over the truck. Stop: an octagon, red only where something is broken. May move: a ring with a tick. Neither: an
 * empty square. */
export function Decision({ stop, mayMove, inPlace = false, fault }) {
  if (stop === null)
    return html`<svg viewBox="0 0 100 100" aria-hidden="true"><path d=${PATHS.octagon} fill="none" stroke="var(--text)" stroke-width="5" stroke-dasharray="9 7" /><text x="50" y="53" font-size="52" font-weight="700" fill="var(--text)" text-anchor="middle" dominant-baseline="central">?</text></svg>`;
  if (stop && inPlace)
    return html`<svg viewBox="0 0 100 100" aria-hidden="true"><path d="M8 8H92V92H8Z" fill="var(--field)" stroke="var(--text)" stroke-width="6" /><path d="M50 20V46M38 36L50 50L62 36" fill="none" stroke="var(--text)" stroke-width="8" /><path d="M22 60H78V78H22Z" fill="var(--text)" /></svg>`;
  if (stop)
    return html`<svg viewBox="0 0 100 100" aria-hidden="true"><path d=${PATHS.octagon} fill=${fault ? 'var(--red)' : 'var(--text)'} /><path d="M19 41H81V59H19Z" fill=${fault ? '#fff' : 'var(--inverse)'} /></svg>`;
  if (mayMove)
    return html`<svg viewBox="0 0 100 100" aria-hidden="true"><circle cx="50" cy="50" r="45" fill="var(--field)" stroke="var(--text)" stroke-width="6" /><path d="M25 52L43 70L76 31" fill="none" stroke="var(--text)" stroke-width="10" /></svg>`;
  return html`<svg viewBox="0 0 100 100" aria-hidden="true"><rect x="8" y="8" width="84" height="84" fill="none" stroke="var(--text)" stroke-width="6" /><path d="M28 50H72" stroke="var(--text)" stroke-width="8" /></svg>`;
}
