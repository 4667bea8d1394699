// Lengths in the viewer's units: metric or imperial, chosen at the top of a page or by `?units=`, and remembered by this
// browser. What the gateway itself sends and keeps (API, registers, files) is in millimetres.

import { known, number, signed } from './format.js';
import { remember, remembered } from './memory.js';

const KEY = 'gateway.units';
const MM_PER_INCH = 25.4;

/** What was chosen. @param {string} query of the address @param {string|null} kept by the browser @returns {'metric'|'imperial'} */
export const chosenUnits = (query, kept) => ((new URLSearchParams(query).get('units') ?? kept) === 'imperial' ? 'imperial' : 'metric');

let imperial = chosenUnits(globalThis.location?.search ?? '', remembered(KEY)) === 'imperial';

export const units = () => (imperial ? 'imperial' : 'metric');

/** @param {string} name metric or imperial */
export function setUnits(name) {
  imperial = name === 'imperial';
  remember(KEY, name);
}

/** What lengths are shown in. */
export const lengthUnit = () => (imperial ? 'in' : 'mm');

/** Millimetres in that unit. @param {number|null|undefined} mm @returns {number|null} null: not known */
export const inUnit = (mm) => (known(mm) ? (imperial ? mm / MM_PER_INCH : mm) : null);

/** Decimals in that unit for so many of a millimetre: a tenth of an inch is nearest to one. */
export const places = (decimals) => decimals + (imperial ? 1 : 0);

/** @param {number|null|undefined} mm @param {number} decimals of the millimetres */
export const distance = (mm, decimals = 0) => number(inUnit(mm), places(decimals), lengthUnit());

/** The same, always with its sign. */
export const signedDistance = (mm, decimals = 0) => signed(inUnit(mm), places(decimals), lengthUnit());

/** With its sign. @param {number|null|undefined} mmPerS */
export const signedSpeed = (mmPerS) => signed(inUnit(mmPerS), places(0), `${lengthUnit()}/s`);

/** One that has no direction. @param {number|null|undefined} mmPerS */
export const speed = (mmPerS) => number(inUnit(mmPerS), places(0), `${lengthUnit()}/s`);
