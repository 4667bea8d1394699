// What people call a bay: its title, with its name beside it; the name alone where it has no title.

/** @type {Record<string, string>} */
let titles = {};

/** @param {Record<string, string>} [found] by the bays' names, as the session has them */
export function learnTitles(found = {}) {
  titles = found;
}

/** @param {string} name @returns {string} empty: it has none */
export const titleOf = (name) => (Object.hasOwn(titles, name) ? titles[name] : '');

/** @param {string} name */
export const called = (name) => (titleOf(name) ? `${titleOf(name)} (${name})` : name);
