// The bar at the top of the pages for desks: brand, the other pages, and who is logged in.

import { AlarmBar } from './alarmbar.js';
import { logOut } from './api.js';
import { called } from './bays.js';
import { kiosk } from './kiosk.js';
import { choose, language, t, text } from './lang.js';
import { html, offered, translated } from './page.js';
import { setTheme, theme } from './theme.js';
import { setUnits, units } from './units.js';

/** `more`: the instance, where `title` is the site's own name; else `title` is a text. @param {{title: any, more?: any}} words */
export const Brand = ({ title, more = '' }) => html`<a class="brand" href=${kiosk ? undefined : '/'}><svg viewBox="0 0 32 32" aria-hidden="true"><circle cx="16" cy="16" r="10" fill="none" stroke="currentColor" stroke-width="3" /><path d="M16 2v9M16 21v9M2 16h9M21 16h9" stroke="currentColor" stroke-width="2.4" /></svg>
  <span translate=${more === '' ? undefined : 'no'}>${title}<span class="muted small"> ${more}</span></span></a>`;

/**
 * The other pages, and the alarm to see first. `bay`: the one that is looked at; none: the first. `alarms`: the summary, where the
 * page pulls it already, at the same pace. @param {{session: any, bay: string|null, current: string, alarms?: any}} at
 */
export function Pages({ session, bay, current, alarms }) {
  const path = encodeURIComponent(bay ?? session.bays[0] ?? '');
  const pages = [
    ['Operator', bay === null || current === 'Operator' ? '/' : `/#${path}`],
    ['Driver', `/driver/${path}`],
    ['History', `/history#${path}`],
    ['Manager', `/manager?bay=${path}`],
    ...(session.role === 'technician' ? [['Technician', `/tune/${path}`], ['Settings', '/setup'], ['New bay', '/setup/new-bay']] : []),
    ['Manual', '/manual'],
  ];
  if (kiosk) return html`<${AlarmBar} session=${session} given=${alarms} />`;
  return html`<nav aria-label="pages">
    ${pages.map(([name, href]) => html`<a href=${href} aria-current=${name === current ? 'page' : undefined}>${name}</a>`)}
  </nav><${AlarmBar} session=${session} given=${alarms} />`;
}

/** Chooses a bay. @param {{bays: string[], bay: string|null, choose: (name: string) => void}} at */
export const BayChoice = ({ bays, bay, choose }) => html`<label class="small">bay <select aria-label="bay" value=${bay} onChange=${(event) => choose(event.target.value)}>
  ${bays.map((name) => html`<option translate="no" value=${name} selected=${name === bay}>${called(name)}</option>`)}</select></label>`;

/**
 * The way past the bar, and the bar. `children`: after the pages; `facts`: before who is logged in; the rest as of `Brand`,
 * `Pages` and `SessionMenu`. @param {any} at
 */
export function Top({ session, title, more = '', bay, current, alarms = undefined, next = undefined, facts = null, children = null }) {
  const past = (event) => {
    event.preventDefault();
    document.getElementById('main').focus();
  };
  return html`<a class="skip" href="#main" onClick=${past}>To the content</a>
    <header class="top">
      <${Brand} title=${title} more=${more} />
      <${Pages} session=${session} bay=${bay} current=${current} alarms=${alarms} />
      ${children}
      <div class="facts push">${facts}<${SessionMenu} session=${session} next=${next} /></div>
    </header>`;
}

const THEMES = { auto: 'as the system', light: 'light', dark: 'dark' };
const UNITS = { metric: 'metric (mm)', imperial: 'imperial (in)' };

/** The page anew, without what the address said of a choice that has just been made. @param {string} name */
function reloadWithout(name) {
  const url = new URL(location.href);
  url.searchParams.delete(name);
  if (url.href === location.href) location.reload();
  else location.replace(url);
}

/** Under the button that opens it. @param {any} event */
function placed({ target, newState }) {
  if (newState !== 'open') return;
  const { bottom, right } = target.previousElementSibling.getBoundingClientRect();
  Object.assign(target.style, { top: `${bottom + scrollY + 4}px`, right: `${Math.max(4, document.documentElement.clientWidth - right)}px` });
}

/** Language, theme and units, remembered by this browser. In a browser without popovers they stand beside the button. */
export function ViewMenu() {
  const pick = (event) => {
    choose(event.target.value);
    reloadWithout('lang');
  };
  const measure = (event) => {
    setUnits(event.target.value);
    reloadWithout('units');
  };
  return html`<span class="viewing compact"><button type="button" popovertarget="viewing" title="language, theme and units of these pages">View <span class="muted small" translate="no">${language().toUpperCase()}</span></button>
    <span id="viewing" popover="auto" onBeforeToggle=${placed}>
      ${offered.length > 1 && html`<label class="row spread">language <select aria-label="language" onChange=${pick}>${offered.map(({ code, name }) => html`<option translate="no" value=${code} lang=${code} selected=${code === language()}>${name}</option>`)}</select></label>`}
      <label class="row spread">theme <select aria-label="theme" onChange=${(event) => setTheme(event.target.value)}>${Object.entries(THEMES).map(([name, words]) => html`<option value=${name} selected=${name === theme()}>${words}</option>`)}</select></label>
      <label class="row spread">units <select aria-label="units" onChange=${measure}>${Object.entries(UNITS).map(([name, words]) => html`<option value=${name} selected=${name === units()}>${words}</option>`)}</select></label>
    </span></span>`;
}

/** `next`: where to go after a login. @param {{session: any, next?: string}} at */
export function SessionMenu({ session, next = location.pathname + location.search }) {
  if (kiosk) return '';
  if (session.name !== null)
    return html`<${ViewMenu} /><span translate="no" title=${translated(session.role)}>${session.name}</span><button type="button" class="plain small" onClick=${() => logOut(session.csrf)}>Log out</button>`;
  return session.can_login ? html`<${ViewMenu} /><a href=${`/login?next=${encodeURIComponent(next)}`}>Log in</a>` : html`<${ViewMenu} /><span class="muted">${text('no login ({0})', t(session.role))}</span>`;
}
