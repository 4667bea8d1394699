// What a page reads of its own address, and where the gateway's other addresses are.

// `/bay1` where a proxy serves the pages below that path; else empty. (The scripts' own tests have no document.)
const BASE = typeof document === 'undefined' ? '' : new URL(import.meta.url).pathname.replace(/\/static\/(~\w+\/)?lib\/address\.js$/, '');

/** An address of the gateway, as the browser reaches it. @param {string} path from the gateway's own root */
export const below = (path) => BASE + path;

/** The bay that the page's address names; empty: none. */
export const ownBay = () => decodeURIComponent(location.pathname.slice(BASE.length).split('/')[2] ?? '');

/** A part of an address without its percent signs; empty where one of them is broken, as in `#100%`. @param {string} part */
export function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return '';
  }
}
