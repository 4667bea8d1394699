// What the page that sets up a bay knows and proposes. Pure.

/** The name after the others: bay2 after bay1, B after A. @param {string[]} names */
export function nextName(names) {
  const taken = new Set(names.map((name) => name.toLowerCase()));
  const last = names.at(-1) ?? 'bay0';
  const counted = /^(.*?)(\d+)$/.exec(last);
  if (/^[A-Ya-y]$/.test(last)) {
    const next = String.fromCharCode(last.charCodeAt(0) + 1);
    if (!taken.has(next.toLowerCase())) return next;
  }
  const stem = counted ? counted[1] : `${last}-`;
  let at = counted ? Number(counted[2]) + 1 : 2;
  while (taken.has(`${stem}${at}`.toLowerCase())) at += 1;
  return `${stem}${at}`;
}

/** The smallest free Modbus unit id above the others, or any free one; null: none. @param {number[]} ids */
export function nextUnit(ids) {
  const highest = Math.max(0, ...ids);
  if (highest < 247) return highest + 1;
  for (let id = 1; id <= 247; id += 1) if (!ids.includes(id)) return id;
  return null;
}

/** Sizes that a camera offers, each once, with their fastest rate. */
export function sizesOf(modes) {
  const sizes = new Map();
  for (const { width_px, height_px, rates_hz } of modes) {
    const key = `${width_px}x${height_px}`;
    const fastest = Math.max(0, sizes.get(key)?.rate_hz ?? 0, ...rates_hz);
    sizes.set(key, { key, width_px, height_px, rate_hz: fastest });
  }
  return [...sizes.values()].sort((a, b) => a.width_px * a.height_px - b.width_px * b.height_px);
}

/** The size that a new bay begins with: the paper's, for R_th is in its pixels; else the nearest. */
export function usualSize(sizes) {
  const off = ({ width_px, height_px }) => Math.abs(Math.log((width_px * height_px) / (640 * 480)));
  return sizes.reduce((best, size) => (best === null || off(size) < off(best) ? size : best), null);
}

const MOST_HZ = 30; // of a camera, unless somebody wants more

/** `[camera]` of a camera that was chosen. `size`: of `sizesOf`; null: as it gives. */
export function cameraKeys(url, size) {
  if (size === null) return { url };
  const rate = size.rate_hz > 0 ? { fps: Math.min(size.rate_hz, MOST_HZ) } : {};
  return { url, width_px: size.width_px, height_px: size.height_px, ...rate };
}

const DEAD = ['LINK_DOWN', 'PROCESS_FAULT', 'WAITING'];
const dead = (sensor) => DEAD.includes(sensor.quality.name);

/**
 * The bay that is to be set up first: one whose function check nobody has ended, or whose camera or ranger is not there.
 * @param {any[]} bays of /api/state @returns {string} its name; empty: none, so a new one
 */
export function unfinished(bays) {
  const found = bays.find((bay) => bay.function_check !== 'OFF' || (bay.state !== null && (dead(bay.state.vision) || dead(bay.state.range))));
  return found?.bay ?? '';
}

export const KEPT = 'kept'; // in place of an address: what the file says stays

/** Of a bay: neither camera nor ranger is chosen yet. `cameraOwn`, `portOwn`: it is the one that the bay has. */
export const NOTHING_CHOSEN = { camera: null, cameraPassword: '', size: null, cameraFrom: '', cameraOwn: false, port: '', portFrom: '', portOwn: false, profile: null, rangerKeys: {} };

export const NO_PROFILE = 'none';

/** The profile that a bay's ranger has without another choice. */
export const profileBefore = (draft, settings) => (draft.bay === '' ? settings.written.ranger?.profile : settings.values.bays[draft.bay].ranger.profile) ?? NO_PROFILE;

/** Another sensor is picked: what was typed for the one before is not its. `before`: of `profileBefore`. */
export const profilePicked = (profile, before) => ({ profile: profile === before ? null : profile, rangerKeys: {} });

/**
 * Beside the port: keys that a profile leaves to the plant. `rangerKeys`: by their name, as typed.
 * @returns {[string[], number][]} path and value of each
 */
const ranged = ({ rangerKeys }) => Object.entries(rangerKeys).filter(([, typed]) => typed !== '').map(([key, typed]) => [key === 'baud' ? [key] : ['number', key], Number(typed)]);

/** `[ranger]` of the port that is chosen. `profile`: null: as before. */
export function rangerTable(draft, profile) {
  const table = { port: draft.port, ...(profile === null ? {} : { profile }) };
  for (const [[name, inner], value] of ranged(draft)) table[name] = inner ? { ...table[name], [inner]: value } : value;
  return table;
}

/**
 * The lasting name of the device that a bay has, where the file names it by the kernel's number; empty: there is none,
 * or the file has a lasting name already.
 * @param {{url: string, node: string}|undefined} own @param {string} inFile
 */
export function lastingName(own, inFile) {
  const byNumber = own !== undefined && (own.node === inFile || /^\d+$/.test(inFile));
  return byNumber && own.url !== own.node ? own.url : '';
}

/** A camera of which a picture was seen, or that the bay has already. */
export const cameraIsRight = (draft) => draft.cameraOwn || draft.size !== null;
export const portIsRight = (draft) => draft.portOwn || draft.port !== '';

/** Do these changes concern a bay, and not only what all bays share? */
export const ofBays = (changes) => changes.some((change) => change.path[0] === 'bays');

/** A broker's URL with user and password in it. */
export function brokerUrl({ address, user, password }) {
  const found = /^([a-z]+:\/\/)?(.*)$/.exec(address.trim());
  const scheme = found[1] ?? 'mqtt://';
  const login = user ? `${encodeURIComponent(user)}${password ? `:${encodeURIComponent(password)}` : ''}@` : '';
  return `${scheme}${login}${found[2]}`;
}

const LOGIN = ['username', 'password_file'];

/** `[camera]` to look at: with the login in its address, which the file never gets. */
export function lookedAt({ username, password_file: _, ...camera }, password) {
  const login = username ? `${encodeURIComponent(username)}:${encodeURIComponent(password)}@` : '';
  return { ...camera, url: camera.url.replace('://', `://${login}`) };
}

/** What is to be changed in the file. `draft.bay` empty: a new bay; else a camera or a port that is kept changes nothing.
 * `former`: the camera that the file has: its login is not the next one's. */
export function changesOf(draft, former = {}) {
  const changes = [];
  const camera = draft.camera && { ...draft.camera, ...(draft.cameraOwn ? {} : draft.size) }; // the size is checked from now on
  const ranger = draft.port ? rangerTable(draft, draft.profile) : null;
  if (draft.bay === '') {
    changes.push({ path: ['bays', draft.name], value: { unit_id: draft.unit, ...(camera ? { camera } : {}), ...(ranger ? { ranger } : {}) } });
  } else {
    const gone = camera && !draft.cameraOwn ? LOGIN.filter((key) => former[key] && !camera[key]).map((key) => [key, null]) : [];
    for (const [key, value] of [...Object.entries(camera ?? {}), ...gone]) changes.push({ path: ['bays', draft.bay, 'camera', key], value });
    const keys = ranger ? [[['port'], draft.port], ...(draft.portOwn ? [] : [...(draft.profile === null ? [] : [[['profile'], draft.profile]]), ...ranged(draft)])] : [];
    for (const [key, value] of keys) changes.push({ path: ['bays', draft.bay, 'ranger', ...key], value });
  }
  if (draft.host && draft.host !== draft.hostBefore) changes.push({ path: ['modbus', 'host'], value: draft.host });
  if (draft.broker.address.trim()) {
    for (const key of draft.brokerKeys) changes.push({ path: ['mqtt', key], value: null });
    changes.push({ path: ['mqtt', 'url'], value: brokerUrl(draft.broker) });
  }
  return changes;
}
