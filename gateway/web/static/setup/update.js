// Another version of the gateway: package and signature uploaded, then checked or installed by the machine's root part, which
// believes the signature alone; or back to the version before. `/setup/update`.

import { html, useState } from '../lib/page.js';
import { post, toLogin } from '../lib/api.js';
import { Dialog } from '../lib/dialog.js';
import { number, words } from '../lib/format.js';
import { t, text } from '../lib/lang.js';
import { titled } from '../lib/title.js';
import { guarded, start } from '../lib/start.js';
import { Top } from '../lib/top.js';
import { usePolled } from '../operator/hooks.js';

const LOOK_MS = 1000;
const PIECE_MS = 60_000;
const PIECE_BYTES = 1 << 20;
const STEPS = [
  ['verifying', 'The signature of the copied package is verified.'],
  ['installing', 'The new version is installed beside the one that runs.'],
  ['checking', 'The new version examines the configuration.'],
  ['replaying', 'The new version decides the last day again, from its recordings.'],
  ['waiting', 'Until no truck is in any bay, for an hour at most.'],
  ['switching', 'Configuration and version are switched.'],
  ['proving', 'Restart: the new version must prove itself for 45 s, or the one before returns.'],
  ['returning', 'Back to the version before.'],
  ['cleaning', 'Older versions are deleted.'],
];
const RESTARTS = ['switching', 'proving', 'returning'];

const base64 = (blob) => new Promise((done, failed) => {
  const reader = new FileReader();
  reader.onload = () => done(String(reader.result).split(',')[1]);
  reader.onerror = () => failed(reader.error);
  reader.readAsDataURL(blob);
});

/** In pieces, one after the other: nothing holds the whole file. @param {File} file @param {string} kind @param {(share: number) => void} progress */
async function upload(file, kind, csrf, progress) {
  for (let offset = 0; offset < file.size; offset += PIECE_BYTES) {
    const data = await base64(file.slice(offset, offset + PIECE_BYTES));
    await post('/api/setup/update/piece', { file: kind, offset, size: file.size, data }, csrf, { timeoutMs: PIECE_MS });
    progress(Math.min(1, (offset + PIECE_BYTES) / file.size));
  }
}

/** What the last try did not accept, by name. */
const asked = (shown) => ({
  bays: shown.outcome === 'abandoned' && shown.why.includes('differences') ? shown.differing : [],
  alarms: [...new Set([...shown.why.matchAll(/new alarm ([A-Za-z0-9_.-]+)/g)].map((found) => found[1]))],
});

const Accept = ({ names, chosen, choose, what }) => names.map((name) => html`<label class="row"><input type="checkbox" checked=${chosen.includes(name)} onChange=${(event) => choose(event.target.checked ? [...chosen, name] : chosen.filter((one) => one !== name))} /><span translate="no">${text(what, name)}</span></label>`);

const Steps = ({ shown }) => html`<ol class="items">${STEPS.map(([name, what]) => html`<li aria-current=${shown.stage === name ? 'step' : undefined}><span class=${`tag ${shown.stage === name ? 'warn' : ''}`}>${name}</span><p>${what}</p></li>`)}</ol>`;

function Outcome({ shown }) {
  if (!shown.outcome) return null;
  const good = shown.outcome === 'updated' || /dry run/.test(shown.why);
  return html`<p class=${`notice ${good ? '' : 'warn'}`} role="status" data-outcome=${shown.outcome}><b>${text('The last update, from {0} to {1}: {2}.', shown.old, shown.new || '?', t(words(shown.outcome)))}</b> <span translate="no">${shown.why}</span></p>`;
}

function Update({ session }) {
  const live = usePolled('/api/setup/update', LOOK_MS);
  const [files, setFiles] = useState({ package: null, signature: null });
  const [{ busy, wrong, share }, setWork] = useState({ busy: false, wrong: '', share: null });
  const [accepted, setAccepted] = useState({ bays: [], alarms: [] });
  const [question, setQuestion] = useState('');
  const during = async (work) => {
    setWork({ busy: true, wrong: '', share: null });
    try {
      await work();
      setWork({ busy: false, wrong: '', share: null });
    } catch (error) {
      if (error.status === 401) toLogin();
      setWork({ busy: false, wrong: error.message, share: null });
    }
  };
  const view = live.last;
  if (!view) return html`<section class="panel">${live.wrong ? html`<p class="notice warn" role="alert"><b>No update from this page:</b> <span>${live.wrong}</span></p>` : html`<p role="status">Loading …</p>`}</section>`;
  const { shown } = view;
  const underWay = view.pending || (shown.stage !== '' && shown.stage !== 'ended');
  const silent = !live.fresh(0);
  const request = (action) => {
    setQuestion('');
    return during(() => post('/api/setup/update', { action, ...(action === 'back' ? {} : accepted) }, session.csrf));
  };
  const choose = (event) => {
    const chosen = [...event.target.files];
    setFiles({ package: chosen.find((one) => one.name.endsWith('.deb')) ?? files.package, signature: chosen.find((one) => /\.(asc|sig)$/.test(one.name)) ?? files.signature });
  };
  const send = () => during(async () => {
    await upload(files.signature, 'signature', session.csrf, () => {});
    await upload(files.package, 'package', session.csrf, (part) => setWork({ busy: true, wrong: '', share: part }));
  });
  const ready = view.package_bytes > 0 && view.signature_bytes > 0 && !busy;
  const open = asked(shown);
  return html`<section class="panel">
      <p>${text('In use: version {0}.', shown.version|| '?')}</p>
      ${silent && (RESTARTS.includes(shown.stage) ? html`<p class="notice warn" role="status">The gateway restarts: stop is shown on all bays. This page comes back by itself.</p>` : html`<p class="notice bad" role="alert">The gateway does not answer.</p>`)}
      ${wrong && html`<p class="notice bad" role="alert">${wrong}</p>`}
      ${!underWay && html`<${Outcome} shown=${shown} />`}
      ${view.pending && html`<p class="notice" role="status">The request waits for its start …</p>`}
      ${!underWay && html`
        <div class="field"><label for="files">Package (.deb) and its signature (.deb.asc), both at once or one after the other</label>
          <input id="files" type="file" multiple accept=".deb,.asc,.sig" disabled=${busy} onChange=${choose} />
          <small class="muted" translate="no">${[files.package, files.signature].filter(Boolean).map((one) => `${one.name} (${number(one.size / 1e6, 1, 'MB')})`).join(', ')}</small></div>
        <p class="row"><button type="button" disabled=${busy || !files.package || !files.signature} onClick=${send}>Upload</button>
          ${share !== null && html`<progress max="1" value=${share} aria-label="uploaded"></progress><span class="value">${number(100 * share, 0, '%')}</span>`}
          ${share === null && view.package_bytes > 0 && html`<span class="muted">${text('{0} on the machine', number(view.package_bytes / 1e6, 1, 'MB'))}</span>`}</p>
        <div>${Accept({ names: open.bays, chosen: accepted.bays, choose: (bays) => setAccepted({ ...accepted, bays }), what: 'Accept that the new version decides otherwise in {0}' })}
          ${Accept({ names: open.alarms, chosen: accepted.alarms, choose: (alarms) => setAccepted({ ...accepted, alarms }), what: 'Accept the new alarm {0}' })}</div>
        <p class="row"><button type="button" disabled=${!ready} onClick=${() => request('check')}>Check without switching</button>
          <button type="button" class="primary" disabled=${!ready} onClick=${() => setQuestion('install')}>Install…</button></p>`}
      ${shown.previous && html`<p class="row"><button type="button" disabled=${busy || view.pending} onClick=${() => setQuestion('back')}>${text('Return to version {0}…', shown.previous)}</button></p>`}
    </section>
    <section class="panel" aria-labelledby="steps-title"><h2 id="steps-title">Steps</h2><${Steps} shown=${shown} /></section>
    ${shown.log.length > 0 && html`<section class="panel" aria-labelledby="log-title"><h2 id="log-title">Log</h2><pre class="log" tabindex="0" role="region" aria-label="log of the update" translate="no">${shown.log.join('\n')}</pre></section>`}
    ${question && html`<${Dialog} id="dialog-title" title=${question === 'back' ? 'Return to the version before?' : 'Install the new version?'} close=${() => setQuestion('')}>
      <p>The switch waits until no truck is in any bay. Then the gateway restarts: the registers can't be read for some seconds, the PLC stops, and who is logged in logs in again.</p>
      <div class="row"><button type="button" class="primary" onClick=${() => request(question)}>${question === 'back' ? 'Return' : 'Install'}</button><button type="button" onClick=${() => setQuestion('')}>Cancel</button></div>
    </${Dialog}>`}`;
}

function App({ session }) {
  titled('Update');
  return html`
    <${Top} session=${session} current="Update" />
    <main id="main" tabindex="-1" class="page release"><h1>Update</h1><${Update} session=${session} /></main>`;
}

start(guarded(App));
