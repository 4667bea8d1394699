// What a page reads of its own address. Pure.

/** A part of an address without its percent signs; empty where one of them is broken, as in `#100%`. @param {string} part */
export function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return '';
  }
}
