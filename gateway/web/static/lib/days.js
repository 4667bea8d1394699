// Days of the plant's calendar as the gateway names them, "2026-11-23". Pure: no clock, and not this computer's zone.

import { stamp } from './format.js';

const DAY_MS = 86_400_000;

const ms = (day) => Date.UTC(Number(day.slice(0, 4)), Number(day.slice(5, 7)) - 1, Number(day.slice(8, 10)));

/** @param {string} day @param {number} count */
export const plus = (day, count) => new Date(ms(day) + count * DAY_MS).toISOString().slice(0, 10);

/** How many days from the first to the last, both included. */
export const between = (first, last) => Math.round((ms(last) - ms(first)) / DAY_MS) + 1;

/** @param {string} day @param {string} [language] its code */
export const weekday = (day, language = 'en') => new Intl.DateTimeFormat(language, { weekday: 'short', timeZone: 'UTC' }).format(ms(day));

/** Is it one that a page may ask for? */
export const isDay = (text) => /^20\d\d-\d\d-\d\d$/.test(text ?? '') && plus(text, 0) === text;

/** Spans that people ask for. @param {string} today @returns {[string, string, string][]} name, first, last */
export function spans(today) {
  const month = `${today.slice(0, 8)}01`;
  const before = plus(month, -1);
  return [
    ['Today', today, today],
    ['Yesterday', plus(today, -1), plus(today, -1)],
    ['7 days', plus(today, -6), today],
    ['28 days', plus(today, -27), today],
    ['This month', month, today],
    ['Last month', `${before.slice(0, 8)}01`, before],
  ];
}

/** The gateway's "2026-11-23T03:14:00+01:00" as people read it. @param {string|null} text @param {object} [how] as of `stamp` */
export const stampOf = (text, how) => stamp(text ? Date.parse(text.replace(' ', 'T')) : null, how);

/** Which of `count` labels are drawn where only `room` have room: the last one always. @returns {(at: number) => boolean} */
export function every(count, room) {
  const step = Math.max(1, Math.ceil(count / Math.max(1, room)));
  return (at) => (count - 1 - at) % step === 0;
}
