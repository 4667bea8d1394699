import assert from 'node:assert/strict';
import { readFileSync, readdirSync } from 'node:fs';
import test from 'node:test';
import { CODES, wordOf } from '../static/lib/guidance.js';
import { chosen, direction, language, listed, t, text, use } from '../static/lib/lang.js';
import { saidText } from '../static/lib/said.js';
import { translated } from '../static/lib/page.js';

const FOLDER = new URL('../static/languages/', import.meta.url);
const catalogues = Object.fromEntries(readdirSync(FOLDER).map((name) => [name.slice(0, -5), JSON.parse(readFileSync(new URL(name, FOLDER), 'utf8'))]));

test('the driver’s display speaks ten languages, each with every word', () => {
  assert.deepEqual(Object.keys(catalogues).sort(), ['ar', 'de', 'en', 'es', 'fr', 'pl', 'pt', 'ru', 'tr', 'zh']);
  const source = readFileSync(new URL('../static/driver.js', import.meta.url), 'utf8');
  const keys = new Set([...source.matchAll(/'(driver\|[^']+)'/g)].map((found) => found[1]));
  for (const code of Object.keys(CODES)) keys.add(wordOf(code));
  assert.ok(keys.size > 20);
  for (const [code, { texts }] of Object.entries(catalogues)) {
    assert.deepEqual(Object.keys(texts).filter((key) => key.startsWith('driver|')).sort(), [...keys].sort(), code);
    for (const one of Object.keys(CODES)) {
      const word = texts[wordOf(one)];
      assert.ok(word.length > 0 && word.length <= 10, `${code}: ${word}`);
    }
  }
  assert.equal(catalogues.ar.direction, 'rtl');
});

test('no two instructions of a language have the same word', () => {
  for (const [code, { texts }] of Object.entries(catalogues)) {
    const words = Object.keys(CODES).filter((one) => one !== 'FAULT').map((one) => texts[wordOf(one)]);
    assert.equal(new Set(words).size, words.length, code);
  }
});

test('a text, its English without a catalogue, its places', () => {
  use('en', { name: 'English', direction: 'ltr', texts: {} });
  assert.equal(t('driver|STOP'), 'STOP');
  assert.equal(t('{a} of {b}', { a: 1 }), '1 of {b}');
  assert.equal(t('constructor'), 'constructor');
  assert.equal(translated('1 fault'), '1 fault');
  assert.equal(translated('0 faults'), '0 faults');
  use('pl', { name: 'Polski', direction: 'ltr', texts: { 'driver|STOP': 'STÓJ', '{0} faults': { one: '{0} usterka', few: '{0} usterki', many: '{0} usterek', other: '{0} usterki' } } });
  assert.deepEqual([language(), direction(), t('driver|STOP')], ['pl', 'ltr', 'STÓJ']);
  assert.deepEqual([1, 2, 5, 22].map((n) => translated(`${n} faults`)), ['1 usterka', '2 usterki', '5 usterek', '22 usterki']);
  use('en', { name: 'English', direction: 'ltr', texts: {} });
});

test('a text of several parts, names in it, and what is missing', () => {
  const texts = { camera: 'Kamera', 'no marker': 'keine Marke', 'no R or Z for {0} s': 'seit {0} s kein R oder Z', '{0}: too large': '{0}: zu groß', 'no camera fits': 'keine Kamera passt' };
  const missing = () => [...globalThis.missingTexts].sort();
  use('de', { name: 'Deutsch', direction: 'ltr', texts });
  globalThis.missingTexts.clear();
  assert.equal(translated('no R or Z for 5 s: camera: no marker'), 'seit 5 s kein R oder Z: Kamera: keine Marke');
  assert.equal(translated('camera; no marker'), 'Kamera; keine Marke');
  assert.equal(translated('no camera fits: view-3.png'), 'keine Kamera passt: view-3.png');
  assert.equal(translated('no camera fits: k1'), 'keine Kamera passt: k1');
  assert.equal(text('{0}: too large', 'my profile.toml'), 'my profile.toml: zu groß');
  for (const value of ['12 px', '1.5\u202fmm', '3 x 4 px', 'R', '–', '10 %']) assert.equal(translated(value), value);
  assert.deepEqual(missing(), []);
  assert.equal(translated('no camera fits: bad allocation'), 'keine Kamera passt: bad allocation');
  assert.equal(translated('camera; something else'), 'camera; something else');
  assert.equal(translated('2 of 3'), '2 of 3');
  assert.equal(translated('no'), 'no');
  assert.equal(t('unheard of'), 'unheard of');
  assert.equal(text('{0} unheard of', 7), '7 unheard of');
  assert.equal(translated(listed(['somebody’s own', 'words'])), 'somebody’s own · words'); // as it was made
  assert.deepEqual(missing(), ['bad allocation', 'camera; something else', 'no', 'unheard of', '{0} of {1}', '{0} unheard of']);
  globalThis.missingTexts.clear();
  use('en', { name: 'English', direction: 'ltr', texts: {} });
});

test('the language: asked for, else the reader’s, else English', () => {
  const codes = ['de', 'en', 'tr'];
  assert.equal(chosen(codes, 'de', ['en']), 'de');
  assert.equal(chosen(codes, 'DE-at', []), 'de');
  assert.equal(chosen(codes, 'xx', ['fr', 'de-CH']), 'de');
  assert.equal(chosen(codes, null, ['fr']), 'en');
  assert.equal(chosen(codes, 'constructor', []), 'en');
});

test('a sentence of the gateway is made from its code and values, also where one stands in another', () => {
  const where = [{ code: 'where', text: 'Z {0} mm, marker not seen', values: ['300'] }];
  const event = { detail: 'by range: Z 300 mm, marker not seen -> gone', said: [{ code: 'rolling', text: 'by {0}: {1} -> {2}', values: ['range', where, 'gone'] }] };
  use('en', { name: 'English', direction: 'ltr', texts: {} });
  assert.equal(saidText(event), event.detail);
  use('de', { name: 'Deutsch', direction: 'ltr', texts: { 'by {0}: {1} -> {2}': 'nach {0}: {1} -> {2}', range: 'Abstand', 'Z {0} mm, marker not seen': 'Z {0} mm, Marke nicht gesehen' } });
  assert.equal(saidText(event), 'nach Abstand: Z 300 mm, Marke nicht gesehen -> gone');
  assert.equal(saidText({ detail: 'connection refused', said: [] }), 'connection refused');
  use('de', { name: 'Deutsch', direction: 'ltr', texts: { 'of {0}': 'zu {0}', departure: 'Abfahrt', 'in place ended': 'Position beendet' } });
  assert.equal(saidText({ detail: 'of departure, in_place_ended', said: [{ code: 'of', text: 'of {0}', values: ['departure, in_place_ended'] }] }), 'zu Abfahrt, Position beendet');
  assert.equal(saidText({ detail: '' }), '');
});
