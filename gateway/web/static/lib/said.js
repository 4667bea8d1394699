// The gateway's sentences in the viewer's language, from their codes and values. Pure.

import { catalogued, listed } from './lang.js';

const word = (of) => catalogued(of.replaceAll('_', ' ')) ?? of;
/** Values that are words, such as names of sensors and events, are looked up, too. */
const value = (of) => (Array.isArray(of) ? sentences(of) : catalogued(of) ?? of.split(', ').map(word).join(', '));
const sentence = ({ text, values }) => (catalogued(text, parseFloat(values[0])) ?? text).replace(/\{(\d)\}/g, (_, n) => value(values[Number(n)]));
const sentences = (said) => said.map(sentence).join(', ');

/**
 * What stands beside a `detail` as `said`; the detail itself where that is not the gateway's own, such as the error of a device.
 * @param {{said?: {text: string, values: any[]}[], detail?: string}} of
 */
export const saidText = ({ said, detail }) => (detail ? listed([catalogued(detail) === undefined ? detail : said?.length ? sentences(said) : value(detail)]) : '');
