// The controls of the settings page, one for each key, drawn from the schema.

import { html, useEffect, useState } from '../lib/page.js';
import { post } from '../lib/api.js';
import { listed, t, text } from '../lib/lang.js';
import { isColour, painted } from '../tune/settings.js';
import { allowed, at, fallback, isArray, isNumber, numbersOf, read, same, shown } from './keys.js';

const idOf = (path) => `k-${path.join('-').replace(/[^A-Za-z0-9_-]/g, '_')}`;

/** Does the command line set this key, or the list that it is in, whatever the file says? */
export const isFixed = (edit, path) => edit.fixed.some((place) => same(path.slice(0, place.length), place));

/** `edit`: what the page knows and does: schema, current, written, values, faults, fixed, csrf, set(path, value). */
export function KeyRow({ one, edit, full = false }) {
  const { path, node, required } = one;
  const [typed, setTyped] = useState(null);
  useEffect(() => () => edit.typing(path, undefined), []); // of another section, nobody sees what is wrong
  const id = idOf(path);
  const own = at(edit.current, path);
  const { value: other, from } = fallback(edit.schema, edit.current, path);
  const fixed = isFixed(edit, path);
  const value = fixed ? at(edit.values, path) : own ?? other;
  const changed = !same(own, at(edit.written, path));
  const said = typed === null ? '' : read(node, typed).wrong ?? '';
  const fault = said || edit.faults.filter((each) => same(each.path, path) || (each.path.length > path.length && same(each.path.slice(0, path.length), path))).map((each) => each.message).join('; ');
  const set = (next) => edit.set(path, next);
  const type = (given) => {
    const found = read(node, given);
    setTyped(given);
    if (found.wrong === undefined) set(found.value);
    edit.typing(path, found.wrong);
  };
  const leave = () => {
    if (!said) setTyped(null);
  };
  const reset = () => {
    setTyped(null);
    edit.typing(path, undefined);
    set(null);
  };
  const common = { id, disabled: fixed, 'aria-describedby': `${id}-d`, 'aria-invalid': fault ? 'true' : undefined };
  const unit = node['x-unit'];
  const range = allowed(node);
  const standard = node.default === undefined || node.default === null ? t(required ? 'required' : 'absent') : shown(node, node.default).replaceAll('\n', ', ') || t('empty');
  return html`<div class=${`key ${changed ? 'changed' : ''} ${fault ? 'wrong' : ''}`} data-key=${path.join('.')}>
    <div class="head"><label for=${id} translate="no">${full ? path.join('.') : path.at(-1)}</label>
      ${changed ? html`<span class="tag">changed</span>` : own !== undefined ? html`<span class="small muted">set in the file</span>` : html`<span class="small muted">${from === 'default' ? 'default' : 'as for every bay'}</span>`}
      ${own !== undefined && !fixed && !required && html`<button type="button" class="plain small" onClick=${reset} title="remove the key from the file">${from === 'default' ? 'to the default' : 'as for every bay'}<span class="sr" translate="no"> ${path.at(-1)}</span></button>`}
    </div>
    ${path.at(-1) === 'password_hash' ? html`<${NewPassword} user=${path.at(-2)} common=${common} changed=${changed} edit=${edit} set=${set} unset=${(wrong) => edit.typing(path, wrong)} />` : html`<div class="pair"><${Control} node=${node} value=${value} typed=${typed} common=${common} set=${set} type=${type} leave=${leave} />
      ${unit && html`<span class="unit">${unit}</span>`}</div>`}
    <div id=${`${id}-d`}>
      ${fixed && (edit.fixed.some((place) => same(place, path)) ? html`<p class="hint"><b>Set on the command line, whatever the file says.</b></p>` : html`<p class="hint">Other bays are set on the command line.</p>`)}
      ${fault && html`<p class="fault" role="alert"><span aria-hidden="true">▲</span> <span translate=${said ? undefined : 'no'}>${fault}</span></p>`}
      <p class="hint">${node.description ?? ''}</p>
      <p class="hint small">${range && html`<span>${text('allowed: {0}', unit ? `${range} ${unit}` : range)}; </span>`}<span>default: <span class="mono" translate="no">${standard}</span></span></p>
    </div>
  </div>`;
}

/** A user's new password. The gateway makes the hash, and answers what stands for it until the save. */
function NewPassword({ user, common, changed, edit, set, unset }) {
  const [[first, second], setTyped] = useState(['', '']);
  const [wrong, setWrong] = useState('');
  const type = (...next) => {
    setTyped(next);
    setWrong('');
    unset(next.join('') || undefined); // a password that was typed only once is not forgotten at the save
  };
  const take = async (event) => {
    event.preventDefault();
    if (first !== second) return setWrong(t('The two passwords differ.'));
    try {
      set((await post('/api/setup/password', { name: user, password: first }, edit.csrf)).password_hash);
      type('', '');
    } catch (error) {
      setWrong(error.message);
    }
  };
  return html`<form class="pair" onSubmit=${take}>
      <input ...${common} type="password" autocomplete="new-password" placeholder="new password" value=${first} onInput=${(event) => type(event.target.value, second)} />
      <input ...${common} id=${`${common.id}-again`} type="password" autocomplete="new-password" placeholder="the same again" aria-label="the same again" value=${second} onInput=${(event) => type(first, event.target.value)} />
      <button disabled=${common.disabled || !first || !second}>Set password</button></form>
    ${changed && html`<p class="hint" role="status">The new password holds from the save on.</p>`}
    ${wrong && html`<p class="fault" role="alert" translate="no"><span aria-hidden="true">▲</span> ${wrong}</p>`}`;
}

function Control({ node, value, typed, common, set, type, leave }) {
  if (node['x-secret'])
    return html`<input ...${common} type="password" autocomplete="new-password" value=${typed ?? ''} placeholder=${value ? 'set; write a new one to replace it' : 'not set'} onInput=${(event) => event.target.value && type(event.target.value)} />`;
  if (node.type === 'boolean')
    return html`<label class="switch"><input ...${common} type="checkbox" role="switch" checked=${Boolean(value)} onChange=${(event) => set(event.target.checked)} /> ${value ? 'on' : 'off'}</label>`;
  if (node.enum)
    return html`<select ...${common} onChange=${(event) => set(event.target.value || null)}>
      ${node.default === null || value === null ? html`<option value="" selected=${value === null}></option>` : null}
      ${node.enum.map((name) => html`<option translate="no" value=${name} selected=${name === value}>${name}</option>`)}</select>`;
  const field = { ...common, autocomplete: 'off', spellcheck: false, value: typed ?? shown(node, value), onInput: (event) => type(event.target.value), onBlur: leave };
  if (isArray(node) && !numbersOf(node)) return html`<textarea ...${field} rows=${Math.max(2, shown(node, value).split('\n').length)} placeholder="one a line"></textarea>`;
  return html`${isColour(field.value) && html`<span class="swatch" aria-hidden="true" ref=${painted(field.value)}></span>`}<input ...${field} inputmode=${isNumber(node) ? 'decimal' : undefined} class=${isNumber(node) ? 'number' : ''} />`;
}

/** A table or a list of tables with its keys. */
export function Group({ group, edit, first }) {
  const { path, node, keys, absent, list } = group;
  const name = path.join('.');
  const own = at(edit.current, path) !== undefined;
  const title = list ? `[[${name}]]` : path.length ? `[${name}]` : 'above all tables';
  const removable = own && (node.optional || node.item) && path.length > 0;
  const faults = edit.faults.filter((each) => same(each.path, path) && keys.length >= 0 && path.length > 0);
  const wrong = faults.map((each) => html`<p class="fault" role="alert" translate="no"><span aria-hidden="true">▲</span> ${each.message}</p>`);
  if (list) return html`<section class="table"><${NewItem} path=${path} node=${node} edit=${edit} title=${title} />${wrong}</section>`;
  return html`<section class="table" aria-label=${name ? listed([name]) : 'gateway'}>
    ${!(first && !absent && !removable) && html`<header class="row spread"><h3 class="mono" translate="no">${title}</h3>
      ${removable && html`<button type="button" onClick=${() => edit.set(path, null)}>Remove<span class="sr" translate="no"> ${name}</span></button>`}
      ${absent && html`<button type="button" onClick=${() => edit.set(path, {})}>Add<span class="sr" translate="no"> ${name}</span></button>`}</header>`}
    ${node.description && !first && html`<p class="hint">${node.description}</p>`}
    ${wrong}
    ${absent && html`<p class="muted">Not in the file.</p>`}
    <div class="keys">${keys.map((one) => html`<${KeyRow} key=${one.path.join('.')} one=${one} edit=${edit} />`)}</div>
  </section>`;
}

/** One more item of a list of tables, by its name. */
export function NewItem({ path, node, edit, title, made = () => ({}) }) {
  const [name, setName] = useState('');
  const taken = Object.keys(at(edit.current, path) ?? {});
  const by = node['x-named-by'];
  const good = (by === 'id' ? /^[0-9]{1,9}$/ : /^[A-Za-z0-9._-]{1,64}$/).test(name) && !taken.includes(name);
  const add = (event) => {
    event.preventDefault();
    if (!good) return;
    edit.set([...path, name], made());
    setName('');
  };
  const id = `new-${path.join('-')}`;
  return html`<header class="row spread"><h3 class="mono" translate="no">${title}</h3></header>
    <p class="hint">${node.description ?? ''}</p>
    <form class="row" onSubmit=${add}><label for=${id}>${by === 'id' ? 'new id' : 'new name'}</label><input id=${id} value=${name} autocomplete="off" aria-invalid=${name && !good ? 'true' : undefined} onInput=${(event) => setName(event.target.value)} />
      <button disabled=${!good}>Add</button>${name !== '' && !good && html`<span class="fault small">${taken.includes(name) ? 'there is one of this name' : 'letters, digits, . _ -'}</span>`}</form>`;
}
