// The driver's display. STOP stands there by itself; only fresh data, again and again, holds it off.
//
// Three watches, each enough alone: a timer on setInterval, one on requestAnimationFrame, and an animation of the
// browser's compositor that ends in STOP even while no script runs.

import { ownBay } from './lib/address.js';
import { watch } from './lib/ambient.js';
import { driverDistance, driverSpeed } from './lib/format.js';
import { DRIVER_LIMIT_MS as LIMIT_MS, Freshness, moment } from './lib/freshness.js';
import { CODES, WITH_AMOUNT, column, driverView, wordOf } from './lib/guidance.js';
import { beginKiosk, keepAwake, watchIdle } from './lib/kiosk.js';
import { choice, choose, chosen, language, languages, load, t } from './lib/lang.js';
import { open } from './lib/live.js';
import { remember, remembered } from './lib/memory.js';
import { Sound, pattern } from './lib/sound.js';
import { PATHS } from './lib/symbols.js';

// A sign that gave way to STOP for want of fresh data comes back only after data that was fresh for this time without a break:
// a display on the edge does not flash (WCAG 2.3.1). STOP by the decision is no such STOP, and none comes later for it.
const UNBROKEN_MS = 1000;
const FRAME_MS = 20; // the compositor may have shown STOP already
const AGAIN_MS = 5000; // between two requests for a language, while the gateway does not answer

const query = new URLSearchParams(location.search);
const bay = ownBay() || null;
const sound = new Sound();
let units = (query.get('units') ?? remembered('gateway.units')) === 'imperial' ? 'imperial' : 'metric';
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
let broken = false; // a sign has given way
let title = ''; // of the bay, which does not grow old
let shown = ''; // what stands there, so that the page is touched only when that changes
/** @type {import('./lib/guidance.js').DriverView|null} */
let view = null;

function put(id, value) {
  const at = element(id);
  if (at.textContent !== value) at.textContent = value;
}

function stopNow(reason) {
  if (view !== null) broken = true;
  view = null;

  if (hold.playState !== 'finished') hold.finish();
  element('show').setAttribute('aria-hidden', 'true');
  document.body.dataset.code = 'STOP';
  document.body.dataset.fresh = 'false';
  say('STOP', t('driver|STOP'));
  sound.play('STOP', pattern('STOP', 'halt', null, false), performance.now());
  if (why.textContent !== reason) why.textContent = reason;
}

function say(code, word) {
  if (shown === code) return;
  shown = code;
  document.title = title ? `${word} · ${title}` : word;
  put('spoken', word);
}

/** Is what stands there still true? Called by every watch. */
function judge() {
  if (!fresh.fresh(moment()) || view === null) stopNow(connected ? t('driver|no data') : t('driver|no connection'));
}

function number(id, label, value, unit) {
  const at = element(id);
  at.classList.toggle('none', value === null);
  if (value === null) return;
  const [name, digits, after] = [at.querySelector('dt'), at.querySelector('b'), at.querySelector('span')];
  if (name.textContent !== label) {
    name.textContent = label;
    if (id === 'amount') element('show').style.setProperty('--label-em', String(Math.max(1, widest([label.toLocaleUpperCase(language())]))));
  }
  if (digits.textContent !== value) digits.textContent = value;
  if (after.textContent !== unit) after.textContent = unit;
}

/** @param {string} name of the bay, for people */
function entitle(name) {
  if (name === title) return;
  title = name;
  put('bay', title);
  document.body.classList.toggle('titled', title !== '');
}

function show(now) {
  const what = CODES[now.code];
  document.body.dataset.kind = what.kind;
  document.body.dataset.code = now.code;
  document.body.dataset.fresh = 'true';
  const path = element('path');
  if (path.getAttribute('d') !== PATHS[what.symbol]) path.setAttribute('d', PATHS[what.symbol]);
  put('word', t(wordOf(now.code)));
  const sideways = now.code === 'LEFT' || now.code === 'RIGHT';
  const amount = WITH_AMOUNT.includes(now.code) ? now.amount_mm ?? (sideways ? null : now.to_go_mm) : null;
  const [digits, unit] = driverDistance(amount, units);
  const driving = now.code === 'FORWARD' || now.code === 'SLOW'; // of BACK, TOO FAR, LEFT and RIGHT the word says what the number is
  if (now.code === 'FAULT') number('amount', '', t('driver|fault'), '');
  else number('amount', driving ? t('driver|to go') : '', amount === null ? null : digits, unit);
  element('show').classList.toggle('plain', amount === null);
  const speed = now.closing_mm_s;
  const moving = speed !== null && now.code !== 'FAULT' && (what.drives || Math.abs(speed) >= 10); // a truck that waits has no speed to be shown
  const [pace, per] = driverSpeed(speed, units);
  number('speed', t(speed !== null && speed <= -10 ? 'driver|backing off' : 'driver|speed'), moving ? pace : null, per);
  const place = column(now.to_go_mm);
  element('column').classList.toggle('none', place.at === null);
  element('line').style.bottom = `${place.line * 100}%`;
  element('past').style.bottom = `${place.line * 100}%`;
  element('bar').style.transform = `scaleY(${place.at ?? 0})`;
  element('show').removeAttribute('aria-hidden');
  say(now.code, t(wordOf(now.code)));
  sound.play(now.code, pattern(now.code, what.kind, now.to_go_mm, speed !== null && speed > 20), performance.now());
  speak(now.language ?? null);
}

function message(text, asked) {
  const now = driverView(text, bay);
  if (now === null || document.hidden) {
    fresh.forget();
    stopNow(t('driver|no data'));
  } else {
    const at = moment();
    if (fresh.ageMs(at) > LIMIT_MS - FRAME_MS) forget();
    fresh.received(now.age_ms, asked, at, now.held_ms);
    if (fresh.fresh(at) && (!broken || fresh.freshForMs(at) >= UNBROKEN_MS)) {
      broken = false;
      view = now;
      entitle(now.title ?? '');
      show(now);
      hold.currentTime = fresh.ageMs(at); // ends when the data is too old, whatever this script does
      hold.play();
    } else stopNow(t('driver|no data'));
  }
  // The next one when this one has been drawn. A page in the background draws nothing: it asks slowly.
  let again = false;
  const ask = () => {
    if (!again) link.next();
    again = true;
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
      stopNow(t('driver|no connection'));
    }
  },
});

const forget = () => {
  fresh.forget();
  stopNow(t('driver|no data'));
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
let ambient = /** @type {boolean|null} */ (null);
function theme() {
  const wanted = query.get('theme');
  const night = wanted === 'night' || (wanted !== 'sun' && (ambient ?? dark.matches));
  document.documentElement.dataset.theme = night ? 'night' : 'sun';
}
theme();
dark.addEventListener('change', theme);
watch((isDark) => {
  ambient = isDark;
  theme();
});

const ruler = /** @type {CanvasRenderingContext2D} */ (document.createElement('canvas').getContext('2d'));
/** The width of the widest of these texts in units of its font's size. @param {string[]} texts */
function widest(texts) {
  ruler.font = `700 100px ${getComputedStyle(document.body).fontFamily}`;
  return Math.max(...texts.map((text) => ruler.measureText(text).width)) / 100;
}

/** What the styles can't know: how wide the words are, all of one language in one size. */
function fit() {
  const root = document.documentElement.style;
  root.setProperty('--word-em', String(widest(Object.keys(CODES).map((code) => t(wordOf(/** @type {any} */ (code)))))));
  root.setProperty('--stop-em', String(widest([t('driver|STOP')])));
  root.setProperty('--fault-em', String(widest([t('driver|fault')])));
  const after = (digits, units) => widest([digits]) + 0.5 * (0.18 + widest(units)); // as the style has it
  root.setProperty('--digits-em', String(Math.max(after('8.88', ['m', 'ft']), after('88', ['cm', 'in']))));
}

/** @type {{code: string, name: string}[]} */
let known = [];
let wanted = query.get('lang') ?? choice();
let ofRecipe = /** @type {string|null} */ (null);

let wishes = 0;

const pause = () => new Promise((resolve) => setTimeout(resolve, AGAIN_MS));

/** Requested until it arrives, or another one is wished. Until then it stays as it is: the signs need no words. */
async function inLanguage(code) {
  wishes += 1;
  const mine = wishes;
  while (mine === wishes) {
    try {
      await load(code);
      return words();
    } catch {
      await pause();
    }
  }
}

function words() {
  fit();
  shown = '';
  /** @type {HTMLElement} */ (deadman.querySelector('.word')).textContent = t('driver|STOP');
  if (view === null) stopNow(t('driver|no connection'));
  else show(view);
  tools();
}

/** The newest choice counts: that of the PLC's recipe, or at the display. @param {string|null} recipe */
function speak(recipe) {
  if (recipe === ofRecipe || known.length === 0) return;
  ofRecipe = recipe;
  inLanguage(chosen(known.map(({ code }) => code), recipe ?? wanted, navigator.languages));
}

keepAwake();
beginKiosk();

const button = (id) => /** @type {HTMLButtonElement} */ (element(id));
const list = element('languages');

function tools() {
  const current = known.find(({ code }) => code === language());
  button('language').textContent = `${t('driver|Language')}: ${current?.name ?? 'English'}`;
  button('sound').textContent = t(sound.on ? 'driver|Turn sound off' : 'driver|Turn sound on'); // what it does, not how it is: so it is not "pressed"
  button('full').textContent = t('driver|Full screen');
  list.replaceChildren(
    ...known.map(({ code, name }) => {
      const one = document.createElement('button');
      [one.type, one.textContent, one.lang] = ['button', name, code];
      one.setAttribute('aria-pressed', String(code === language()));
      one.addEventListener('click', () => {
        wanted = code;
        choose(code);
        unfold(false);
        inLanguage(code);
      });
      return one;
    }),
  );
}

// Room for the buttons where they would lie on the word; the list of languages may lie over it while one is chosen.
new ResizeObserver(() => {
  if (list.hidden) document.body.style.setProperty('--tools', `${element('tools').offsetHeight}px`);
}).observe(element('tools'));

function unfold(on) {
  list.hidden = !on;
  button('language').setAttribute('aria-expanded', String(on));
}

button('language').addEventListener('click', () => unfold(list.hidden));
button('units').addEventListener('click', () => {
  units = units === 'metric' ? 'imperial' : 'metric';
  remember('gateway.units', units);
  if (view !== null) show(view);
});
button('sound').addEventListener('click', () => {
  const on = !sound.on;
  if (on) sound.start(tools);
  else sound.stop();
  remember('gateway.sound', on ? 'on' : null);
  tools();
});
if ((query.get('sound') ?? remembered('gateway.sound')) === 'on') sound.start(tools);
const full = button('full');
full.hidden = !document.fullscreenEnabled;
full.addEventListener('click', () => {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.documentElement.requestFullscreen().catch(() => {});
});

words();
stopNow(t('driver|no connection'));
(async function begin() {
  for (;;) {
    try {
      known = await languages();
      break;
    } catch {
      await pause();
    }
  }
  await inLanguage(chosen(known.map(({ code }) => code), ofRecipe ?? wanted, navigator.languages));
  tools();
})();
watchIdle(() => unfold(false));
