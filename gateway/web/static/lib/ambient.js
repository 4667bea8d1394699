// Is it dark round the screen? From the light sensor, where the browser gives one.

const DARK_LUX = 20;
const BRIGHT_LUX = 60; // apart, or a screen that lights its own sensor would flicker

/** The next state. Pure. @param {boolean|null} dark @param {number} lux @returns {boolean|null} null: not known yet */
export function darkNow(dark, lux) {
  if (!Number.isFinite(lux)) return dark;
  if (lux <= DARK_LUX) return true;
  if (lux >= BRIGHT_LUX) return false;
  return dark ?? false;
}

/** Calls `tell` at each change. @param {(dark: boolean) => void} tell @returns {boolean} is there a sensor? */
export function watch(tell) {
  const Sensor = /** @type {any} */ (globalThis).AmbientLightSensor;
  if (Sensor === undefined) return false;
  try {
    let dark = /** @type {boolean|null} */ (null);
    const sensor = new Sensor({ frequency: 1 });
    sensor.addEventListener('reading', () => {
      const next = darkNow(dark, sensor.illuminance);
      if (next !== null && next !== dark) tell(next);
      dark = next;
    });
    sensor.addEventListener('error', () => sensor.stop());
    sensor.start();
    return true;
  } catch {
    return false; // not permitted
  }
}
