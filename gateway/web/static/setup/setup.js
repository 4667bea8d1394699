// The settings page: every key of the configuration's file. `/setup#bays/A/camera` shows one section.

import { html, translated, useEffect, useMemo, useRef, useState } from '../lib/page.js';
import { decoded } from '../lib/address.js';
import { get, post, toLogin } from '../lib/api.js';
import { t, text } from '../lib/lang.js';
import { titled } from '../lib/title.js';
import { guarded, start } from '../lib/start.js';
import { Top } from '../lib/top.js';
import { useHash } from '../operator/hooks.js';
import { Doctor } from './doctor.js';
import { Group, KeyRow, NewItem, isFixed } from './form.js';
import { SHARED, allKeys, applied, at, bayNames, keysOf, matches, nodeAt, same, sections, withChange } from './keys.js';
import { Restart, Review } from './review.js';

const CHECK_MS = 500; // after the last change
const RELOADED_MS = 2000; // after a save: what is live is in effect
const AGAIN_MS = 2000;
const MOST_FOUND = 60;
const DOCTOR = ['doctor'];

const pathOf = (hash) => hash.replace(/^#/, '').split('/').filter(Boolean).map(decoded);
const hashOf = (path) => `#${path.map(encodeURIComponent).join('/')}`;

function usePath() {
  const hash = useHash();
  return useMemo(() => pathOf(hash), [hash]);
}

/** `touched`: how many of its keys are changed, and whether one is wrong. */
function SectionLink({ one, path, touched: [count, bad] }) {
  return html`<a href=${hashOf(one.path)} aria-current=${same(one.path, path) ? 'page' : undefined}><span translate="no">${one.title}</span>${bad ? html` <span class="tag bad">fault</span>` : count > 0 ? html` <span class="tag">${count}</span>` : ''}</a>`;
}

function Tree({ list, path, changes, faults }) {
  const touched = (one) => {
    if (same(one.path, ['bays'])) one = { ...one, path: null };
    const inside = (place) => one.path === null ? SHARED.includes(place[0]) : same(place.slice(0, one.path.length), one.path) && (one.path.length > 0 || place.length === 1);
    return [changes.filter((change) => inside(change.path)).length, faults.some((fault) => inside(fault.path))];
  };
  const item = (one) => html`<${SectionLink} one=${one} path=${path} touched=${touched(one)} />`;
  return html`<ul>${list.map((one) => html`<li>${item(one)}${one.below.length > 0 && html`<ul>${one.below.map((each) => html`<li>${item(each)}</li>`)}</ul>`}</li>`)}
    <li><a href=${hashOf(DOCTOR)} aria-current=${same(path, DOCTOR) ? 'page' : undefined}>Doctor</a></li></ul>`;
}

/**
 * The faults of the changes as the gateway finds them, a moment after the last one. With a dialog `open` it is not
 * asked: a save makes the changes out of date.
 */
function useFaults(file, changes, session, open) {
  const [faults, setFaults] = useState(file.faults);
  const newest = useRef(0);
  useEffect(() => {
    newest.current += 1;
    const mine = newest.current;
    if (changes.length === 0) {
      setFaults(file.faults);
      return undefined;
    }
    if (open) return undefined;
    const timer = setTimeout(async () => {
      try {
        const plan = await post('/api/setup/preview', { digest: file.digest, changes }, session.csrf);
        if (mine === newest.current) setFaults(plan.faults);
      } catch {
        // The dialog reports it.
      }
    }, CHECK_MS);
    return () => clearTimeout(timer);
  }, [file, changes, open]);
  return faults;
}

function Section({ path, edit }) {
  const groups = keysOf(edit.schema, path, edit.current);
  const node = nodeAt(edit.schema, path);
  const otherBays = isFixed(edit, ['bays']) && path[0] === 'bays' && html`<p class="notice warn" role="status">This gateway was started with other bays than the file's (--bays). The file's own can't be changed here until it is started without that; everything else can.</p>`;
  if (otherBays && path.length === 1) return html`<h2>Bays</h2>${otherBays}`;
  if (same(path, ['bays']))
    return html`<h2>Bays</h2><p class="hint">${text('The sections below “{0}” hold for every bay that does not set its own. A bay needs a camera, a ranger and a Modbus unit id of its own. Camera and board are found and tried here:', t('every bay'))} <a href="/setup/new-bay">a new bay, step by step</a></p>
      <section class="table"><${NewItem} path=${path} node=${node} edit=${edit} title="[[bays]]" made=${() => ({ unit_id: freeUnit(edit) })} /></section>`;
  if (!node) return html`<p class="notice">There is no such section (any more).</p>`;
  const isBay = path.length === 2 && path[0] === 'bays';
  return html`<header class="row spread"><h2 class="mono" translate="no">${path.length ? path.join('.') : 'gateway'}</h2>
      ${isBay && !otherBays && html`<button type="button" disabled=${bayNames(edit.current).length < 2} onClick=${() => edit.set(path, null)}>Remove this bay</button>`}</header>
    ${otherBays}
    ${node.description && path.length > 0 && html`<p class="hint">${node.description}</p>`}
    ${groups.map((group, n) => html`<${Group} key=${group.path.join('.')} group=${group} edit=${edit} first=${n === 0 && !group.node.item && !(node.optional)} />`)}`;
}

/** The lowest unit id that no bay has. */
function freeUnit(edit) {
  const taken = bayNames(edit.current).map((name) => at(edit.current, ['bays', name, 'unit_id']) ?? 1);
  return Array.from({ length: 247 }, (_, n) => n + 1).find((n) => !taken.includes(n)) ?? 1;
}

function Found({ words, edit }) {
  const all = allKeys(edit.schema, edit.current).filter((one) => matches(one, words, translated));
  return html`<h2 translate="no">${all.length === 0 ? text('No key with “{0}”', words) : text(all.length === 1 ? '1 key with “{1}”' : '{0} keys with “{1}”', all.length, words)}</h2>
    <div class="keys">${all.slice(0, MOST_FOUND).map((one) => html`<${KeyRow} key=${one.path.join('.')} one=${one} edit=${edit} full />`)}</div>
    ${all.length > MOST_FOUND && html`<p class="muted">The first ${MOST_FOUND} are shown.</p>`}`;
}

function Editor({ session, file, load }) {
  const path = usePath();
  const [changes, setChanges] = useState([]);
  const [typing, setTyping] = useState({});
  const [words, setWords] = useState('');
  const [dialog, setDialog] = useState(null);
  const [saved, setSaved] = useState(null);
  const [takenBack, setTakenBack] = useState(0); // how often: the fields are made anew, without what was typed into them
  const schema = file.json_schema;
  const current = useMemo(() => applied(file.written, changes), [file, changes]);
  const faults = useFaults(file, changes, session, dialog !== null);
  useEffect(() => {
    const warn = (event) => changes.length > 0 && event.preventDefault();
    addEventListener('beforeunload', warn);
    return () => removeEventListener('beforeunload', warn);
  }, [changes]);
  useEffect(() => setWords(''), [path.join('/')]);
  const set = (place, value) => {
    setSaved(null);
    setChanges((was) => withChange(was, file.written, place, value));
  };
  const typed = (place, wrong) => setTyping((was) => ({ ...was, [place.join('.')]: wrong }));
  const wrong = Object.values(typing).filter(Boolean).length;
  const edit = { schema, current, written: file.written, values: file.values, faults, fixed: file.command_line, csrf: session.csrf, set, typing: typed };
  const list = sections(schema, current);
  const flat = list.flatMap((one) => [one, ...one.below.map((each) => ({ ...each, title: `${one.title}: ${each.title}` }))]); // names of the file
  const go = (place) => { location.hash = hashOf(place); };
  const takeBack = () => {
    setChanges([]);
    setTyping({});
    setTakenBack(takenBack + 1);
    load();
    document.getElementById('main').focus({ preventScroll: true }); // the button goes away
  };
  const done = async (answer) => {
    await load(); // before the dialog closes: what is done next is about the new text
    setDialog(null);
    setChanges([]);
    setTyping({});
    setSaved(answer);
    if (answer.live.length > 0) setTimeout(load, RELOADED_MS);
  };
  return html`<div class="setup-page">
    <nav class="panel tree" aria-label="sections">
      <label class="search">Search <input type="search" value=${words} placeholder="key or meaning" onInput=${(event) => setWords(event.target.value)} /></label>
      <label class="narrow">Section <select onChange=${(event) => go(pathOf(event.target.value))}>${[...flat, { path: DOCTOR, title: t('Doctor') }].map((one) => html`<option translate="no" value=${hashOf(one.path)} selected=${same(one.path, path)}>${one.title}</option>`)}</select></label>
      <div class="wide"><${Tree} list=${list} path=${path} changes=${changes} faults=${faults} /></div>
    </nav>
    <div class="panel content">
      <p class="small muted">File: <span class="mono" translate="no">${file.file}</span></p>
      ${file.why_not && html`<p class="notice bad" role="alert"><b>Nothing can be saved:</b> ${file.why_not}</p>`}
      ${file.faults.length > 0 && changes.length === 0 && html`<div class="notice bad" role="alert"><b>The file has faults; the gateway would not start with it:</b><ul class="bare">${file.faults.map((fault) => html`<li><span translate="no"><span class="mono">${fault.path.join('.')}</span>${fault.line ? ` ${text('(line {0})', fault.line)}` : ''}: ${fault.message}</span></li>`)}</ul></div>`}
      ${saved && html`<div class="notice" role="status" data-saved><p><b>Saved.</b> ${saved.live.length > 0 ? `${saved.live.length} in effect. ` : ''}The text before is kept in <span class="mono" translate="no">${saved.previous}</span>.</p></div>`}
      ${file.waiting.length > 0 && html`<div class="notice warn row spread"><details><summary>${file.waiting.length === 1 ? 'One key of the file waits for a restart' : text('{0} keys of the file wait for a restart', file.waiting.length)}</summary><ul class="bare">${file.waiting.map((one) => html`<li class="mono small" translate="no">${one}</li>`)}</ul></details>
        <button type="button" onClick=${() => setDialog('restart')}>Restart…</button></div>`}
      ${words.trim() ? html`<${Found} key=${takenBack} words=${words.trim()} edit=${edit} />` : same(path, DOCTOR) ? html`<${Doctor} />` : html`<${Section} key=${`${takenBack} ${path.join('.')}`} path=${path} edit=${edit} />`}
    </div>
    <div class="bar row spread" aria-label="changes" role="region">
      <span role="status">${changes.length === 0 ? 'No changes' : changes.length === 1 ? '1 change' : text('{0} changes', changes.length)}${wrong + (changes.length ? faults.length : 0) > 0 ? html` <span class="tag bad">${text('{0} wrong', wrong + (changes.length ? faults.length : 0))}</span>` : ''}</span>
      <span class="row">
        ${changes.length === 0 && file.undo && html`<button type="button" onClick=${() => setDialog('undo')}>Undo the last save…</button>`}
        ${changes.length + wrong > 0 && html`<button type="button" onClick=${takeBack}>Take back</button>`}
        <button type="button" class="primary" disabled=${changes.length === 0 || wrong > 0} onClick=${() => setDialog('save')}>Look at the changes</button>
      </span>
    </div>
    ${(dialog === 'save' || dialog === 'undo') && html`<${Review} session=${session} close=${() => setDialog(null)} done=${done}
      body=${dialog === 'undo' ? { digest: file.digest, undo: true } : { digest: file.digest, changes }} />`}
    ${dialog === 'restart' && html`<${Restart} session=${session} seconds=${file.restart_s} close=${() => setDialog(null)} />`}
  </div>`;
}

function App({ session }) {
  const [{ file, wrong }, setGot] = useState({ file: null, wrong: '' });
  const load = async () => {
    try {
      const answer = await get('/api/setup/settings');
      setGot({ file: answer, wrong: '' });
    } catch (error) {
      if (error.status === 401) toLogin();
      if (error.status === undefined) {
        setTimeout(load, AGAIN_MS); // the web process is replaced where the pages' own settings have changed
        return;
      }
      setGot({ file: null, wrong: error.message });
    }
  };
  useEffect(() => void load(), []);
  titled('Settings');
  return html`
    <${Top} session=${session} current="Settings" />
    <main id="main" tabindex="-1" class="page">
      <h1 class="sr">Settings</h1>
      ${wrong && html`<p class="notice bad" role="alert"><b>The settings can't be shown</b>: ${wrong}</p><${Doctor} />`}
      ${file === null && !wrong && html`<p class="muted" role="status">Reading the file …</p>`}
      ${file !== null && html`<${Editor} session=${session} file=${file} load=${load} />`}
    </main>`;
}

start(guarded(App));
