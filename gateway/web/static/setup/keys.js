// The sections and keys of the configuration's file, read from the gateway's JSON Schema; and changes of it. Pure.

import { listed, t, text as said } from '../lib/lang.js';

export const SHARED = ['camera', 'vision', 'ranger', 'fusion', 'guidance', 'visit'];
const FIRST_BAY = 'bay1'; // of a file without bays

/** The schema of a key without its reference. `optional`: it may be absent. */
export function resolved(schema, node) {
  let found = node;
  let optional = false;
  if (found.anyOf) {
    optional = found.anyOf.some((one) => one.type === 'null');
    const others = found.anyOf.filter((one) => one.type !== 'null');
    found = others.length === 1 ? { ...others[0], ...found, anyOf: undefined } : { ...found, types: others.map((one) => one.type) };
  }
  if (found.$ref) found = { ...schema.$defs[found.$ref.split('/').at(-1)], ...found, $ref: undefined };
  return { ...found, optional: optional || node.optional === true };
}

export const isTable = (node) => node.type === 'object' && node.properties !== undefined;
export const isList = (node) => node['x-named-by'] !== undefined;

/** The schema at a path; undefined: no such key. */
export function nodeAt(schema, path) {
  let node = resolved(schema, schema);
  let named = false;
  for (const part of path) {
    if (named) {
      node = resolved(schema, node.items);
      named = false;
      continue;
    }
    if (!node.properties?.[part]) return undefined;
    node = resolved(schema, node.properties[part]);
    named = isList(node);
  }
  return node;
}

/** The value at a path; undefined: none. */
export function at(tree, path) {
  let found = tree;
  for (const part of path) found = found !== null && typeof found === 'object' && !Array.isArray(found) ? found[part] : undefined;
  return found;
}

/** The document after the changes, in which lists of tables are tables by name. @param {{path: string[], value: any}[]} changes */
export function applied(written, changes) {
  const made = structuredClone(written);
  for (const { path, value } of changes) {
    let tree = made;
    for (const part of path.slice(0, -1)) {
      if (tree[part] === null || typeof tree[part] !== 'object') tree[part] = {};
      tree = tree[part];
    }
    if (value === null) delete tree[path.at(-1)];
    else tree[path.at(-1)] = structuredClone(value);
  }
  return made;
}

export const same = (a, b) => JSON.stringify(a ?? null) === JSON.stringify(b ?? null);

/** The changes with one more: an earlier one of the same key is replaced, one that changes nothing is left out. */
export function withChange(changes, written, path, value) {
  const id = path.join('\n');
  const inside = (change) => change.path.join('\n').startsWith(`${id}\n`);
  const others = changes.filter((change) => change.path.join('\n') !== id && !(value === null && inside(change)));
  const before = at(applied(written, others), path);
  if (same(before, value)) return others;
  return [...others, { path, value }];
}

/** What is in force where the file does not set the key: what is set for every bay, or the default. */
export function fallback(schema, current, path) {
  if (path[0] === 'bays' && SHARED.includes(path[2])) {
    const shared = at(current, path.slice(2));
    if (shared !== undefined) return { value: shared, from: 'every bay' };
  }
  return { value: nodeAt(schema, path)?.default ?? null, from: 'default' };
}

/** Names of the bays, in the file's order. */
export const bayNames = (current) => Object.keys(current.bays ?? { [FIRST_BAY]: {} });

/** The sections at the left: path, title, and those below. */
export function sections(schema, current) {
  const of = (path, title = path.at(-1)) => ({ path, title, below: [] });
  const root = Object.keys(schema.properties);
  const bays = bayNames(current).map((name) => ({ ...of(['bays', name], name), below: SHARED.map((part) => of(['bays', name, part])) }));
  const others = root.filter((name) => {
    const node = nodeAt(schema, [name]);
    return (isTable(node) || isList(node)) && ![...SHARED, 'bays', 'sinks'].includes(name);
  });
  const sinks = Object.keys(nodeAt(schema, ['sinks'])?.properties ?? {});
  return [
    of([], t('gateway')),
    { ...of(['bays'], t('every bay')), below: SHARED.map((part) => of([part])) },
    ...bays,
    ...others.map((name) => of([name])),
    ...sinks.map((name) => of(['sinks', name], name)),
  ];
}

/** The keys of a section: those of its tables too, but not those with a place of their own at the left. */
export function keysOf(schema, path, current) {
  const groups = [];
  const add = (at_, node) => {
    const keys = [];
    const tables = [];
    for (const name of Object.keys(node.properties ?? {})) {
      const inner = resolved(schema, node.properties[name]);
      const place = [...at_, name];
      const apart = (at_.length === 0 && (isTable(inner) || isList(inner))) || (at_.length === 2 && at_[0] === 'bays' && SHARED.includes(name));
      if (apart) continue;
      if (isTable(inner) || isList(inner)) tables.push([place, inner]);
      else keys.push({ path: place, node: inner, required: (node.required ?? []).includes(name) });
    }
    groups.push({ path: at_, node, keys });
    for (const [place, inner] of tables) {
      if (isTable(inner)) {
        if (inner.optional && at(current, place) === undefined) groups.push({ path: place, node: inner, keys: [], absent: true });
        else add(place, inner);
      } else list(place, inner);
    }
  };
  const list = (place, node) => {
    groups.push({ path: place, node, keys: [], list: true });
    for (const name of Object.keys(at(current, place) ?? {})) add([...place, name], { ...resolved(schema, node.items), item: true });
  };
  const node = nodeAt(schema, path);
  if (!node || same(path, ['bays'])) return [];
  if (isList(node)) list(path, node);
  else if (node.optional && at(current, path) === undefined) groups.push({ path, node, keys: [], absent: true });
  else add(path, node);
  return groups;
}

/** Every key of the file, for the search. */
export function allKeys(schema, current) {
  const found = sections(schema, current).flatMap((one) => [one, ...one.below]);
  return found.flatMap((one) => keysOf(schema, one.path, current).flatMap((group) => group.keys));
}

/** Do all words occur in name or meaning? `shown`: a meaning in the viewer's language, too. */
export function matches({ path, node }, words, shown = (meaning) => meaning) {
  const meaning = node.description ?? '';
  const text = `${path.join('.')} ${meaning} ${shown(meaning)}`.toLowerCase();
  return words.toLowerCase().split(/\s+/).every((word) => text.includes(word));
}

const kindOf = (node) => node.type ?? (node.types ?? []).filter(Boolean)[0] ?? 'string';
export const isNumber = (node) => ['integer', 'number'].includes(kindOf(node)) && !node.enum;
const lines = (text) => text.split(/[\n]/).map((line) => line.trim()).filter(Boolean);

/** A value as it is typed. */
export function shown(node, value) {
  if (value === null || value === undefined) return '';
  if (Array.isArray(value)) return numbersOf(node) ? value.join(', ') : value.map((one) => (typeof one === 'string' ? one : JSON.stringify(one))).join('\n');
  return typeof value === 'object' ? JSON.stringify(value) : String(value);
}

export const isArray = (node) => kindOf(node) === 'array';
export const numbersOf = (node) => isArray(node) && ['integer', 'number'].includes((node.items ?? node.prefixItems?.[0])?.type);

/** What is allowed, in the viewer's words; empty: nothing to say. */
export function allowed(node) {
  const parts = [];
  const low = node.minimum ?? node.exclusiveMinimum;
  const high = node.maximum ?? node.exclusiveMaximum;
  if (low !== undefined && high !== undefined) parts.push(said('{0} to {1}', low, high));
  else if (low !== undefined) parts.push(said(node.minimum === undefined ? 'above {0}' : 'at least {0}', low));
  else if (high !== undefined) parts.push(said(node.maximum === undefined ? 'below {0}' : 'at most {0}', high));
  if (node['x-form']) parts.push(t(node['x-form']));
  if (isArray(node) && node.minItems !== undefined && node.minItems === node.maxItems) parts.push(said('{0} values', node.minItems));
  return listed(parts, ', ');
}

/** The value of what was typed, or what is wrong with it. @returns {{value?: any, wrong?: string}} */
export function read(node, text) {
  const bare = text.trim();
  if (isNumber(node)) {
    const value = Number(bare.replace(',', '.'));
    if (bare === '' || !Number.isFinite(value)) return { wrong: 'a number is expected' };
    if (kindOf(node) === 'integer' && !Number.isInteger(value)) return { wrong: 'a whole number is expected' };
    const low = value < (node.minimum ?? -Infinity) || value <= (node.exclusiveMinimum ?? -Infinity);
    const high = value > (node.maximum ?? Infinity) || value >= (node.exclusiveMaximum ?? Infinity);
    return low || high ? { wrong: said('allowed: {0}', allowed(node)) } : { value };
  }
  if (isArray(node)) {
    const numbers = numbersOf(node);
    const parts = numbers ? bare.split(/[\s,;]+/).filter(Boolean) : lines(text);
    const values = numbers ? parts.map(Number) : parts;
    if (numbers && values.some((one) => !Number.isFinite(one))) return { wrong: 'numbers are expected, with commas between them' };
    const count = values.length < (node.minItems ?? 0) || values.length > (node.maxItems ?? Infinity);
    return count ? { wrong: node.minItems === node.maxItems ? said('{0} values are expected', node.minItems) : said('{0} to {1} values are expected', node.minItems ?? 0, node.maxItems) } : { value: values };
  }
  if (kindOf(node) === 'object') {
    try {
      return { value: JSON.parse(bare) };
    } catch {
      return { wrong: 'a JSON object is expected' };
    }
  }
  if (node.minLength && bare.length < node.minLength) return { wrong: 'must not be empty' };
  if (node.pattern && !new RegExp(node.pattern, 'u').test(bare)) return { wrong: said('allowed: {0}', allowed(node)) };
  return { value: text };
}
