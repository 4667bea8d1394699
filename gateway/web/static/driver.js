// The driver's display. STOP stands there by itself; only fresh data, again and again, holds it off.
//
// Three watches, each enough alone: a timer on setInterval, one on requestAnimationFrame, and an animation of the
// browser's compositor that ends in STOP even while no script runs.

import { driverDistance } from './lib/format.js';
import { Freshness } from './lib/freshness.js';
import { CODES, WITH_AMOUNT, column, driverView } from './lib/guidance.js';
import { LANGUAGES, chosen } from './lib/lang.js';
import { open } from './lib/live.js';
import { PATHS } from './lib/symbols.js';

const LIMIT_MS = 500;

const query = new URLSearchParams(location.search);
const bay = decodeURIComponent(location.pathname.split('/')[2] ?? '') || null;
const language = chosen(query.get('lang'), navigator.languages);
const texts = LANGUAGES[language];
const element = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

const deadman = element('deadman');
const why = /** @type {HTMLElement} */ (deadman.querySelector('.why'));
const fresh = new Freshness(LIMIT_MS);
const hold = deadman.animate(
  [{ opacity: 0 }, { opacity: 0, offset: 0.999 }, { opacity: 1 }],
  { duration: LIMIT_MS, fill: 'forwards' },
);
hold.finish();

let connected = false;
let shown = ''; // what stands there, so that the page is touched only when that changes
/** @type {import('./lib/guidance.js').DriverView|null} */
let view = null;

function put(id, value) {
  const at = element(id);
  if (at.textContent !== value) at.textContent = value;
}

function stopNow(reason) {
  view = null;
  if (hold.playState !== 'finished') hold.finish();
  element('show').setAttribute('aria-hidden', 'true');
  document.body.dataset.code = 'STOP';
  document.body.dataset.fresh = 'false';
  say('STOP', texts.codes.STOP);
  if (why.textContent !== reason) why.textContent = reason;
}

function say(code, word) {
  if (shown === code) return;
  shown = code;
  document.title = word;
  put('spoken', word);
}

/** Is what stands there still true? Called by every watch. */
function judge() {
  const ageMs = fresh.ageMs(performance.now(), Date.now());
  if (view === null || ageMs > LIMIT_MS) stopNow(connected ? texts.noData : texts.noConnection);
}

function number(id, label, value, unit) {
  const at = element(id);
  at.classList.toggle('none', value === null);
  if (value === null) return;
  const [name, digits, after] = [at.querySelector('dt'), at.querySelector('b'), at.querySelector('span')];
  if (name.textContent !== label) name.textContent = label;
  if (digits.textContent !== value) digits.textContent = value;
  if (after.textContent !== unit) after.textContent = unit;
}

function show(now) {
  const what = CODES[now.code];
  document.body.dataset.kind = what.kind;
  document.body.dataset.code = now.code;
  document.body.dataset.fresh = 'true';
  const path = element('path');
  if (path.getAttribute('d') !== PATHS[what.symbol]) path.setAttribute('d', PATHS[what.symbol]);
  put('word', texts.codes[now.code]);
  const sideways = now.code === 'LEFT' || now.code === 'RIGHT';
  const amount = WITH_AMOUNT.includes(now.code) ? now.amount_mm ?? (sideways ? null : now.to_go_mm) : null;
  const [digits, unit] = driverDistance(amount);
  const past = now.code === 'BACK' || now.code === 'TOO_FAR';
  const label = sideways ? texts.sideways : past ? texts.past : texts.toGo;
  if (now.code === 'FAULT') number('amount', '', texts.fault, '');
  else number('amount', label, amount === null ? null : digits, unit);
  const speed = now.closing_mm_s;
  number('speed', speed !== null && speed <= -10 ? texts.away : texts.speed, speed === null ? null : String(Math.round(Math.abs(speed) / 10)), 'cm/s');
  const place = column(now.to_go_mm);
  element('column').classList.toggle('none', place.at === null);
  element('line').style.bottom = `${place.line * 100}%`;
  element('past').style.bottom = `${place.line * 100}%`;
  element('bar').style.transform = `scaleY(${place.at ?? 0})`;
  element('show').removeAttribute('aria-hidden');
  say(now.code, texts.codes[now.code]);
}

function message(text, arrival) {
  const now = driverView(text, bay);
  if (now === null || document.hidden) {
    fresh.forget();
    stopNow(texts.noData);
  } else {
    fresh.received(now.age_ms, arrival.receivedMs, Date.now(), arrival.askedMs, now.held_ms);
    const ageMs = fresh.ageMs(performance.now(), Date.now());
    if (ageMs <= LIMIT_MS) {
      view = now;
      show(now);
      hold.currentTime = ageMs; // ends when the data is too old, whatever this script does
      hold.play();
    } else stopNow(texts.noData);
  }
  // The next one when this one has been drawn. A page in the background draws nothing: it asks slowly.
  let asked = false;
  const ask = () => {
    if (!asked) link.next();
    asked = true;
  };
  requestAnimationFrame(ask);
  setTimeout(ask, document.hidden ? 500 : 100);
}

const link = open(`/api/driver${bay === null ? '' : `?bay=${encodeURIComponent(bay)}`}`, {
  message,
  state(on) {
    connected = on;
    if (!on) {
      fresh.forget();
      stopNow(texts.noConnection);
    }
  },
});

const forget = () => {
  fresh.forget();
  stopNow(texts.noData);
};
document.addEventListener('visibilitychange', forget);
document.addEventListener('freeze', forget);
document.addEventListener('resume', forget);
addEventListener('pageshow', forget);
addEventListener('pagehide', forget);
setInterval(judge, 50);
(function everyFrame() {
  judge();
  requestAnimationFrame(everyFrame);
})();

// The look: theme, language, size of the words.
const dark = matchMedia('(prefers-color-scheme: dark)');
function theme() {
  const wanted = query.get('theme');
  const night = wanted === 'night' || (wanted !== 'sun' && dark.matches);
  document.documentElement.dataset.theme = night ? 'night' : 'sun';
}
theme();
dark.addEventListener('change', theme);
document.documentElement.lang = language;
const letters = Math.max(...Object.values(texts.codes).map((word) => word.length));
document.documentElement.style.setProperty('--letters', String(letters));
document.documentElement.style.setProperty('--stop-letters', String(texts.codes.STOP.length));
/** @type {HTMLElement} */ (deadman.querySelector('.word')).textContent = texts.codes.STOP;
stopNow(texts.noConnection);

// The screen must not fall asleep; browsers grant it to visible pages of this machine or over TLS.
async function keepAwake() {
  if (document.hidden || !('wakeLock' in navigator)) return;
  try {
    await navigator.wakeLock.request('screen');
  } catch {
    // Not granted: the kiosk's own settings must keep the screen on.
  }
}
document.addEventListener('visibilitychange', keepAwake);
keepAwake();

const full = /** @type {HTMLButtonElement} */ (element('full'));
full.textContent = texts.fullScreen;
full.hidden = !document.fullscreenEnabled;
full.addEventListener('click', () => {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.documentElement.requestFullscreen().catch(() => {});
});
let idle = 0;
function busy() {
  document.body.classList.remove('idle');
  clearTimeout(idle);
  idle = setTimeout(() => document.body.classList.add('idle'), 4000);
}
for (const kind of ['pointermove', 'pointerdown', 'keydown']) addEventListener(kind, busy);
busy();
