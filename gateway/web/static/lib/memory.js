// What this browser remembers of its viewer's choices. Where it may not remember, each page begins anew.

/** `ofTab`: by this tab alone. @param {string} key @returns {string|null} */
export function remembered(key, ofTab = false) {
  try {
    return (ofTab ? sessionStorage : localStorage).getItem(key);
  } catch {
    return null;
  }
}

/** @param {string} key @param {string|null} value null: forget it @param {boolean} [ofTab] */
export function remember(key, value, ofTab = false) {
  try {
    const storage = ofTab ? sessionStorage : localStorage;
    if (value === null) storage.removeItem(key);
    else storage.setItem(key, value);
  } catch {
    // Private windows and kiosks without storage.
  }
}
