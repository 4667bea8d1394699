// What this browser remembers of its viewer's choices. Where it may not remember, each page begins anew.

/** @param {string} key @returns {string|null} */
export function remembered(key) {
  try {
    return localStorage.getItem(key);
  } catch {
    return null;
  }
}

/** @param {string} key @param {string|null} value null: forget it */
export function remember(key, value) {
  try {
    if (value === null) localStorage.removeItem(key);
    else localStorage.setItem(key, value);
  } catch {
    // Private windows and kiosks without storage.
  }
}
