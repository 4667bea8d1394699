// The bar at the top of the pages for desks: brand, the tasks, the bay, and who is logged in.

import { AlarmBar } from './alarmbar.js';
import { logOut } from './api.js';
import { called, chosenBay } from './bays.js';
import { kiosk } from './kiosk.js';
import { choose as chooseLanguage, language, t, text } from './lang.js';
import { html, offered, translated } from './page.js';
import { setTheme, theme } from './theme.js';
import { setUnits, units } from './units.js';
import { zoneText } from './zone.js';

/** `more`: the instance, where `title` is the site's own name; else `title` is a text. @param {{title?: any, more?: any}} words */
export const Brand = ({ title = 'Loading bays', more = '' }) => html`<a class="brand" href=${kiosk ? undefined : '/'}><svg viewBox="0 0 32 32" aria-hidden="true"><circle cx="16" cy="16" r="10" fill="none" stroke="currentColor" stroke-width="3" /><path d="M16 2v9M16 21v9M2 16h9M21 16h9" stroke="currentColor" stroke-width="2.4" /></svg>
  <span translate=${more === '' ? undefined : 'no'}>${title}<span class="muted small"> ${more}</span></span></a>`;

/** Addresses by task, each for a bay's address part; `/` of no bay: all bays. @type {[string, (bay: string) => string][]} */
const TASKS = [
  ['Live', (bay) => (bay ? `/#${bay}` : '/')],
  ['History', (bay) => `/history#${bay}`],
  ['Report', (bay) => `/manager?bay=${bay}`],
];
/** Under *Set up*, for technicians. @type {[string, (bay: string) => string][]} */
const SET_UP = [
  ['Settings', () => '/setup'],
  ['Set up a bay', () => '/setup/new-bay'],
  ['Tuning', (bay) => `/tune/${bay}`],
  ['Lens', (bay) => `/calibrate/${bay}`],
  ['Release', (bay) => `/setup/release?bay=${bay}`],
  ['Update', () => '/setup/update'],
];
/** @type {[string, (bay: string) => string]} */
const MANUAL = ['Manual', () => '/manual'];

/**
 * The tasks, and the alarm to see first. `bay`: the one that is looked at; null: all of them, undefined: the page is of none.
 * `alarms`: the summary, where the page pulls it already, at the same pace.
 * @param {{session: any, bay?: string|null, current: string, alarms?: any}} at
 */
export function Pages({ session, bay, current, alarms }) {
  const kept = chosenBay(session.bays, bay);
  const inSetUp = SET_UP.some(([name]) => name === current);
  const link = ([name, address], here = name === current) => {
    const all = name === 'Live' && (here || kept === null); // from a bay to all of them
    return html`<a href=${address(all ? '' : encodeURIComponent(kept ?? session.bays[0] ?? ''))} aria-current=${here ? 'page' : undefined}>${name}</a>`;
  };
  if (kiosk) return html`<${AlarmBar} session=${session} given=${alarms} />`;
  return html`<nav aria-label="pages">
    ${TASKS.map((one) => link(one))}
    ${session.role === 'technician' && link(['Set up', SET_UP[0][1]], inSetUp)}
    ${link(MANUAL)}
  </nav>
  ${inSetUp && html`<nav class="sub" aria-label="Set up">${SET_UP.map((one) => link(one))}</nav>`}
  <${AlarmBar} session=${session} given=${alarms} />`;
}

/**
 * The way past the bar, and the bar. `choose`: called with the bay that is chosen in it; undefined: none is to be chosen.
 * `children`: after the tasks; `facts`: before who is logged in; the rest as of `Brand`, `Pages` and `SessionMenu`. @param {any} at
 */
export function Top({ session, title = undefined, more = '', bay, current, alarms = undefined, next = undefined, choose = undefined, facts = null, children = null }) {
  const past = (event) => {
    event.preventDefault();
    document.getElementById('main').focus();
  };
  return html`<a class="skip" href="#main" onClick=${past}>To the content</a>
    <header class="top">
      <${Brand} title=${title} more=${more} />
      <${Pages} session=${session} bay=${bay} current=${current} alarms=${alarms} />
      ${choose && session.bays.length > 1 && html`<label class="small">bay <select aria-label="bay" value=${bay} onChange=${(event) => choose(event.target.value)}>
        ${session.bays.map((name) => html`<option translate="no" value=${name} selected=${name === bay}>${called(name)}</option>`)}</select></label>`}
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
    chooseLanguage(event.target.value);
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
  const zone = html`<span class="muted nowrap" title="the gateway's time zone: of every time on this page">${text('Times: {0}', zoneText(Date.now()))}</span>`;
  if (session.name !== null)
    return html`${zone}<${ViewMenu} /><span translate="no" title=${translated(session.role)}>${session.name}</span><button type="button" class="plain small" onClick=${() => logOut(session.csrf)}>Log out</button>`;
  return session.can_login ? html`${zone}<${ViewMenu} /><a href=${`/login?next=${encodeURIComponent(next)}`}>Log in</a>` : html`${zone}<${ViewMenu} /><span class="muted">${text('no login ({0})', t(session.role))}</span>`;
}
