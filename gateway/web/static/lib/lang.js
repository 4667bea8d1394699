// What the driver's display says, by language. To add a language: copy a block, translate it, give it its code (two
// letters, as in `?lang=de`). Words of the codes stand as large as the display is wide: keep them short. Pure.

/**
 * @typedef {object} Texts
 * @property {Record<import('./guidance.js').Code, string>} codes
 * @property {string} toGo @property {string} past @property {string} sideways
 * @property {string} speed @property {string} away the speed of a truck that backs off
 * @property {string} noData @property {string} noConnection @property {string} fault
 * @property {string} fullScreen
 */

/** @type {Record<string, Texts>} */
export const LANGUAGES = {
  en: {
    codes: {
      WAIT: 'WAIT',
      FORWARD: 'FORWARD',
      BACK: 'BACK',
      LEFT: 'LEFT',
      RIGHT: 'RIGHT',
      SLOW: 'SLOW',
      STOP: 'STOP',
      OK: 'OK',
      TOO_FAR: 'TOO FAR',
      FAULT: 'STOP',
      LEAVE: 'LEAVE',
      DRIVE_UP: 'DRIVE UP',
    },
    toGo: 'to go',
    past: 'too far by',
    speed: 'speed',
    away: 'backing off',
    sideways: 'sideways',
    noData: 'no data',
    noConnection: 'no connection',
    fault: 'fault',
    fullScreen: 'Full screen',
  },
  de: {
    codes: {
      WAIT: 'WARTEN',
      FORWARD: 'VOR',
      BACK: 'ZURÜCK',
      LEFT: 'LINKS',
      RIGHT: 'RECHTS',
      SLOW: 'LANGSAM',
      STOP: 'HALT',
      OK: 'OK',
      TOO_FAR: 'ZU WEIT',
      FAULT: 'HALT',
      LEAVE: 'ABFAHRT',
      DRIVE_UP: 'HERAN',
    },
    toGo: 'noch',
    past: 'zu weit um',
    speed: 'Tempo',
    away: 'rückwärts',
    sideways: 'zur Seite',
    noData: 'keine Daten',
    noConnection: 'keine Verbindung',
    fault: 'Störung',
    fullScreen: 'Vollbild',
  },
};

/**
 * The language to show: the one asked for, else the first of the reader's that is known, else English.
 * @param {string|null} wanted @param {readonly string[]} readers
 */
export function chosen(wanted, readers = []) {
  for (const code of [wanted ?? '', ...readers]) {
    const short = code.toLowerCase().split('-')[0];
    if (Object.hasOwn(LANGUAGES, short)) return short;
  }
  return 'en';
}
