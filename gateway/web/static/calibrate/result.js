// What follows from the views: the lens with its uncertainty, warnings; to the file, or as files.

import { html, useState } from '../lib/page.js';
import { ownBay } from '../lib/address.js';
import { get } from '../lib/api.js';
import { number } from '../lib/format.js';
import { Review } from '../setup/review.js';
import { download } from '../lib/download.js';

const PIXELS = ['fx', 'fy', 'cx', 'cy'];

/** As many decimals as the standard deviation has a meaning for. */
const decimals = (sigma) => Math.min(8, Math.max(0, 1 - Math.floor(Math.log10(Math.max(sigma, 1e-9)))));

function Row({ one }) {
  const places = decimals(one.sigma);
  const unit = PIXELS.includes(one.name) ? 'px' : '';
  const share = one.value ? (100 * one.sigma) / Math.abs(one.value) : null;
  return html`<tr data-parameter=${one.name}><th scope="row" translate="no">${one.name}</th><td class="right value">${number(one.value, places, unit)}</td><td class="right">± ${number(one.sigma, places, unit)}</td>
    <td class="right">${share === null ? '–' : number(share, share < 1 ? 2 : 0, '%')}</td></tr>`;
}

export function Result({ session, base, view, result, radius, setRadius, marker }) {
  const [body, setBody] = useState(null);
  const [saved, setSaved] = useState(null);
  const [trouble, setTrouble] = useState('');
  const there = result !== null && result.why === '';
  const late = there && result.revision !== view.revision;
  const query = marker === null ? '' : `?marker_radius_mm=${marker}`;
  const bay = ownBay();
  const review = async () => {
    setTrouble('');
    setSaved(null);
    try {
      const file = await get('/api/setup/settings', { timeoutMs: 20_000 });
      setBody({ digest: file.digest, changes: result.changes });
    } catch (error) {
      setTrouble(error.message);
    }
  };
  const done = (answer) => {
    setBody(null);
    setSaved(answer);
  };
  return html`<section class="panel result" aria-labelledby="result-title" aria-busy=${String(late)}>
    <header><h2 id="result-title">Result</h2><span class="small muted">${late ? 'calculating …' : ''}</span></header>
    ${result === null && html`<p class="muted">Nothing yet.</p>`}
    ${result !== null && !there && html`<p class="small" role="status">${result.why}</p>`}
    ${there && html`
      <p role="status" data-rms>${`Reprojection error: rms ${number(result.rms_px, 3, 'px')} over ${result.views.filter((one) => one.used).length} views`}</p>
      <table><thead><tr><th scope="col"><span class="sr">parameter</span></th><th scope="col" class="right">value</th><th scope="col" class="right">standard deviation</th><th scope="col" class="right">share</th></tr></thead>
        <tbody>${result.parameters.map((one) => html`<${Row} one=${one} />`)}</tbody></table>
      ${result.warnings.length > 0 && html`<div class="notice warn"><p><b>Check this first:</b></p><ul class="bare">${result.warnings.map((text) => html`<li>${text}</li>`)}</ul></div>`}
      <label class="radius">True radius of the marker, mm <input type="number" min="0.1" max="10000" step="any" value=${radius} onInput=${(event) => setRadius(event.target.value)} aria-describedby="radius-hint" />
        <small id="radius-hint" class="muted">With it the distance in the picture is compared with the ranger's ([fusion.cross_check]). Empty: that stays as it is.</small></label>
      <div class="row"><button type="button" class="primary" disabled=${late} onClick=${review}>Look at the change in the file…</button>
        <button type="button" onClick=${() => download(`lens-${bay}.toml`, result.toml)}>TOML</button>
        <a class="button" href=${`${base}/views.zip`} download>Views (ZIP)</a>
        <a class="button" href=${`${base}/report.html${query}`} download>Report</a></div>
      <details><summary class="small">The lines for the file, and the command that gives the same from the views</summary><pre class="mono" translate="no" tabindex="0">${result.toml}</pre><pre class="mono" translate="no" tabindex="0">${result.command}</pre></details>`}
    <div aria-live="assertive">${trouble && html`<p class="notice bad">${trouble}</p>`}
      ${saved && html`<p class="notice" data-saved><b>Saved.</b> The text before is kept in <span class="mono" translate="no">${saved.previous}</span>. ${saved.restart.length > 0 && html`The rest takes effect at the next start: <a href="/setup">restart the gateway</a>.`}</p>`}</div>
    ${body && html`<${Review} body=${body} session=${session} close=${() => setBody(null)} done=${done} />`}
  </section>`;
}
