// Test sets: labelled pictures of this bay that are kept by name. Settings are scored on all of them before they go live.

import { html, useEffect, useRef, useState } from '../lib/page.js';
import { get } from '../lib/api.js';
import { number, px } from '../lib/format.js';
import { text } from '../lib/lang.js';
import { base64 } from './source.js';
import { Labelling } from './labelling.js';
import { SetScore } from './setscore.js';

const POLL_MS = 300;
const UPLOAD_MS = 30_000;
const SCORE_MS = 30_000;
const NOTHING = { kept: true, sets: [], limits: { sets: 0, pictures: 0, file_bytes: 0, set_bytes: 0, name_characters: 40 } };
const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const part = encodeURIComponent;

export class CancelledError extends Error {}

/** The bay's test sets, and their scores. `send(path, body, timeoutMs)` as the page's, `at(path)`: of the bay. */
export function useTestSets(send, at) {
  const [state, setState] = useState(NOTHING);
  const [scores, setScores] = useState({}); // by set: {view, vision}
  const [running, setRunning] = useState('');
  const [trouble, setTrouble] = useState('');
  const cancelled = useRef(false);
  const load = async () => setState(await get(at('test-sets'), { timeoutMs: 15_000 }));
  useEffect(() => {
    load().catch((error) => setTrouble(error.message));
  }, []);
  const change = async (path, body = {}) => {
    const next = await send(`test-sets${path}`, body, UPLOAD_MS);
    setState(next);
    setTrouble('');
    return next;
  };
  /** Throws CancelledError, and what the gateway refuses. */
  const score = async (name, vision) => {
    const note = (view) => setScores((was) => ({ ...was, [name]: { view, vision } }));
    cancelled.current = false;
    setRunning(name);
    try {
      let view = await send(`test-sets/${part(name)}/score`, { vision }, SCORE_MS);
      const mine = view.number;
      note(view);
      while (view.running) {
        await pause(POLL_MS);
        view = await get(at(`test-sets/${part(name)}/score`));
        if (view.number !== mine) throw new Error('Other settings are being scored on this set, from another tab or by somebody else.');
        note(view);
      }
      if (cancelled.current) throw new CancelledError('Scoring was cancelled.');
      if (view.failed) throw new Error(view.failed);
      return view;
    } finally {
      setRunning('');
    }
  };
  return {
    ...state, scores, running, trouble, load, change, score,
    url: (name, file) => at(`test-sets/${part(name)}/pictures/${part(file)}`),
    /** All sets that have labelled pictures, one after the other. */
    async scoreAll(vision) {
      for (const one of state.sets) if (one.pictures.some((picture) => picture.labelled && !picture.missing)) await score(one.name, vision);
    },
    async cancel() {
      cancelled.current = true;
      if (running) await send(`test-sets/${part(running)}/score/cancel`, {});
    },
  };
}

const megabytes = (bytes) => number(bytes / (1 << 20), 1, 'MB');

/** What a picture is labelled as, in words. */
function labelOf(picture) {
  if (picture.missing) return 'its file is gone';
  if (!picture.labelled) return 'no label yet';
  return picture.marker ? `marker, R ${px(picture.marker.radius_px, 0)}` : 'no marker';
}

function NameForm({ id, label, button, most, busy, done }) {
  const [name, setName] = useState('');
  const go = async (event) => {
    event.preventDefault();
    if (await done(name.trim())) setName('');
  };
  return html`<form class="row" onSubmit=${go}><label class="small" for=${id}>${label}</label>
    <input id=${id} size="18" maxlength=${most} value=${name} autocomplete="off" required onInput=${(event) => setName(event.target.value)} />
    <button type="submit" disabled=${busy || name.trim() === ''}>${button}</button></form>`;
}

function Thumb({ url, picture, current, open }) {
  const bad = picture.missing || !picture.labelled;
  return html`<li><button type="button" class="thumb" data-file=${picture.file} aria-pressed=${current} onClick=${open}>
    ${picture.missing ? html`<span class="shot empty">gone</span>` : html`<img class="shot" loading="lazy" alt="" src=${`${url}?width=160`} />`}
    <span class="small mono" translate="no">${picture.file}</span>
    <span class="small">${bad && html`<span class="tag warn" aria-hidden="true">!</span>`} ${labelOf(picture)}</span></button></li>`;
}

/**
 * `sets`: of useTestSets; `settings`: on the page; `shown()`: keeps the frame that is on the page, and says where;
 * `taken`: what is kept; `tell(text, bad)`: says it at the bottom of the page.
 */
export function TestSets({ sets, settings, shown, taken, tell }) {
  const [name, setName] = useState('');
  const [file, setFile] = useState('');
  const [busy, setBusy] = useState('');
  const [failed, setFailed] = useState('');
  const [sure, setSure] = useState(false);
  const [open, setOpen] = useState(location.hash === '#test-sets');
  const field = useRef(null);
  const begun = useRef(false);
  const list = useRef(null);
  const set = sets.sets.find((one) => one.name === name) ?? sets.sets[0] ?? null;
  const picture = set?.pictures.find((one) => one.file === file) ?? null;
  const path = set ? `/${part(set.name)}` : '';
  const not = (what) => busy !== what && (busy !== '' || sets.running !== ''); // what else goes on
  const doing = async (what, work) => {
    if (begun.current) return false; // the button itself stays enabled: it keeps the focus
    begun.current = true;
    setBusy(what);
    setFailed('');
    try {
      await work();
      return true;
    } catch (error) {
      if (!(error instanceof CancelledError)) setFailed(error.message);
      return false;
    } finally {
      begun.current = false;
      setBusy('');
    }
  };
  const choose = (next) => {
    setName(next);
    setFile('');
    setSure(false);
  };
  const make = (next) => doing('make', async () => {
    await sets.change('', { name: next });
    choose(next);
  });
  const rename = (next) => doing('rename', async () => {
    await sets.change(`${path}/rename`, { name: next });
    choose(next);
  });
  const remove = () => doing('delete', async () => {
    await sets.change(`${path}/delete`);
    choose('');
  });
  const add = (bodies) => doing('add', async () => {
    let first = '';
    for (const body of bodies) {
      const next = await sets.change(`${path}/pictures`, await body());
      first = first || next.added;
    }
    setFile(first);
    tell(bodies.length === 1 ? 'One picture was added: say what is in it.' : `${bodies.length} pictures were added: say what is in them.`);
  });
  const addShown = () => add([async () => {
    const on = await shown();
    if (!on) throw new Error('There is no picture to add.');
    return { [on.kind]: on.name, frame: on.frame ?? 0 };
  }]);
  const stills = taken.filter((one) => one.kind === 'snapshot');
  const addKept = () => add(stills.map((one) => () => ({ snapshot: one.name })));
  const addFiles = (event) => {
    const files = [...event.target.files];
    event.target.value = '';
    const large = files.find((one) => one.size > sets.limits.file_bytes);
    if (large) setFailed(text('{0} is larger than {1}.', large.name, megabytes(sets.limits.file_bytes)));
    else if (files.length) add(files.map((one) => async () => ({ title: one.name.slice(0, 100), data: await base64(one) })));
  };
  const label = (marker) => doing('label', async () => {
    const next = await sets.change(`${path}/pictures/${part(picture.file)}/label`, { marker });
    const pictures = next.sets.find((one) => one.name === set.name)?.pictures ?? [];
    const at = pictures.findIndex((one) => one.file === picture.file);
    const rest = [...pictures.slice(at + 1), ...pictures.slice(0, at)];
    setFile(rest.find((one) => !one.labelled)?.file ?? picture.file); // the next that has none
    tell('The label was saved.');
  });
  /** Back to the pictures, with the focus on one of them. */
  const close = () => {
    setFile('');
    const thumbs = [...list.current.querySelectorAll('.thumb')];
    (thumbs.find((each) => each.dataset.file === file) ?? thumbs[0])?.focus();
  };
  const drop = () => doing('remove', async () => {
    await sets.change(`${path}/pictures/${part(picture.file)}/remove`);
    close();
  });
  const score = () => doing('score', () => sets.score(set.name, settings));
  const labelled = set?.pictures.filter((one) => one.labelled && !one.missing).length ?? 0;
  const trouble = failed || sets.trouble;

  return html`<details class="panel test-sets" id="test-sets" open=${open} onToggle=${(event) => event.target.id === 'test-sets' && setOpen(event.target.open)}>
    <summary><h2>Test set: pictures that settings are scored on before they go live</h2></summary>
    ${trouble && html`<p class="notice bad" role="alert">${trouble}</p>`}
    ${!sets.kept
      ? html`<p class="notice">Nothing can be kept here: the gateway has no folder for its state. Set state_dir in the configuration.</p>`
      : html`<div class="row">
        ${set && html`<label class="small">test set <select value=${set.name} onChange=${(event) => choose(event.target.value)}>
          ${sets.sets.map((one) => html`<option value=${one.name} selected=${one === set} translate="no">${one.name}</option>`)}</select></label>`}
        <${NameForm} id="new-set" label="new set" button="Make" most=${sets.limits.name_characters} busy=${not('make')} done=${make} />
        ${set && html`<${NameForm} id="set-name" label="another name" button="Rename" most=${sets.limits.name_characters} busy=${not('rename')} done=${rename} />
          ${sure
            ? html`<span class="row" role="group" aria-label="delete this set?"><button type="button" class="primary" disabled=${not('delete')} onClick=${remove}>${`Delete ${set.pictures.length} pictures`}</button>
                <button type="button" onClick=${() => setSure(false)}>Keep them</button></span>`
            : html`<button type="button" disabled=${not('delete')} onClick=${() => (set.pictures.length ? setSure(true) : remove())}>Delete set</button>`}`}
      </div>
      ${!set && html`<p class="hint">Make a set, then add a picture in each light there is, some of them without a marker. Say of each where the marker is. From then on nothing goes live without a score on all of them, or a warning.</p>`}
      ${set && html`
        ${set.faults.map((fault) => html`<p class="notice warn">${fault}</p>`)}
        <div class="row">
          <button type="button" disabled=${not('add')} onClick=${addShown}>Add the frame shown</button>
          <button type="button" disabled=${not('add') || !stills.length} onClick=${addKept}>${`Add kept frames (${stills.length})`}</button>
          <button type="button" disabled=${not('add')} onClick=${() => field.current.click()}>${busy === 'add' ? 'Adding…' : 'Add files…'}</button>
          <input ref=${field} type="file" multiple class="sr" tabindex="-1" aria-label="pictures for the test set" accept="image/jpeg,image/png" onChange=${addFiles} />
          <span class="small muted">${`${set.pictures.length} of at most ${sets.limits.pictures} pictures, ${labelled} of them labelled, ${megabytes(set.bytes)}`}</span>
        </div>
        <ul class="thumbs" ref=${list} aria-label="pictures of the set">${set.pictures.map((one) => html`<${Thumb} key=${`${set.name}/${one.file}`} url=${sets.url(set.name, one.file)} picture=${one} current=${one.file === file} open=${() => setFile(one.file === file ? '' : one.file)} />`)}</ul>
        ${picture && html`<${Labelling} key=${`${set.name}/${picture.file}`} url=${sets.url(set.name, picture.file)} picture=${picture} label=${label} drop=${drop} close=${close} busy=${not('label')} />`}
        <${SetScore} labelled=${labelled} score=${sets.scores[set.name] ?? null} settings=${settings} run=${score} running=${sets.running === set.name} cancel=${() => sets.cancel()} busy=${not('score')} url=${(one) => sets.url(set.name, one)} />`}`}
  </details>`;
}
