// The settings' controls, drawn from the gateway's own description of its keys.

import { html, translated, useEffect, useState } from '../lib/page.js';
import { listed, t, text } from '../lib/lang.js';
import { css, groups, isColour, painted, partLimits, placeOf, plain, range, same, stepOf, title, typed, valueAt, widely } from './settings.js';

const AXES = ['H', 'S', 'V'];
const AXIS_WORDS = ['hue', 'saturation', 'value'];

/** A number field that takes what is being typed, and gives back the last good value when it is left with nonsense. */
function Field({ id, value, take, accept, label, describedby }) {
  const [text, setText] = useState(null);
  const bad = text !== null && accept(text) === null;
  return html`<input id=${id} class="field" inputmode="decimal" autocomplete="off" aria-label=${label} aria-describedby=${describedby}
    aria-invalid=${bad ? 'true' : undefined} value=${text ?? plain(value)}
    onInput=${(event) => {
      setText(event.target.value);
      const good = accept(event.target.value);
      if (good !== null) take(good);
    }}
    onKeyDown=${(event) => event.key === 'Enter' && event.target.blur()}
    onBlur=${() => setText(null)} />`;
}

function Said({ remarks, name }) {
  const mine = remarks.filter((remark) => remark.key === name);
  return mine.map((remark) => html`<p class=${`said ${remark.warning ? 'warning' : ''}`}><span aria-hidden="true">${remark.warning ? '▲' : '•'}</span> ${remark.text}</p>`);
}

function Reset({ show, what, reset }) {
  return html`<button type="button" class="plain reset" hidden=${!show} onClick=${reset}
    title="back to what is in force">changed, take back<span class="sr" translate="no"> ${what}</span></button>`;
}

function Numeric({ key_, settings, inForce, set, remarks, hint }) {
  const value = settings[key_.name];
  const wide = widely(key_);
  const id = `k-${key_.name}`;
  const changed = !same(value, inForce[key_.name]);
  const move = (event) => {
    const at = Number(event.target.value);
    set(key_.name, wide ? valueAt(key_, at) : at);
  };
  return html`<div class=${`control ${changed ? 'changed' : ''}`}>
    <div class="head"><label for=${`${id}-n`} translate="no">${title(key_)}</label>
      <${Reset} show=${changed} what=${title(key_)} reset=${() => set(key_.name, inForce[key_.name])} /></div>
    <div class="pair">
      <input type="range" name=${key_.name} id=${id} aria-label=${text('{0}, slider', title(key_))}
        aria-valuetext=${listed([plain(value), translated(key_.unit)], ' ')}
        min=${wide ? 0 : key_.low} max=${wide ? 1000 : key_.high} step=${wide ? 1 : stepOf(key_)}
        value=${wide ? placeOf(key_, value) : value} onInput=${move} />
      <${Field} id=${`${id}-n`} value=${value} describedby=${`${id}-d`} accept=${(given) => typed(key_, given)} take=${(good) => set(key_.name, good)} />
      <span class="unit">${key_.unit}</span>
    </div>
    <p class="hint" id=${`${id}-d`}>${key_.meaning} <span class="nowrap">(${range(key_)})</span>${hint ? html` <b class="nowrap">${hint}</b>` : ''}</p>
    <${Said} remarks=${remarks} name=${key_.name} />
  </div>`;
}

function Choice({ key_, settings, inForce, set }) {
  const changed = settings[key_.name] !== inForce[key_.name];
  return html`<fieldset class=${`control ${changed ? 'changed' : ''}`} aria-describedby=${`k-${key_.name}-d`}>
    <div class="head"><legend translate="no">${title(key_)}</legend>
      <${Reset} show=${changed} what=${title(key_)} reset=${() => set(key_.name, inForce[key_.name])} /></div>
    <div class="row">${key_.choices.map((choice) => html`<label class="choice"><input type="radio" name=${key_.name} value=${choice}
      checked=${settings[key_.name] === choice} onChange=${() => set(key_.name, choice)} /> <span translate="no">${choice}</span></label>`)}</div>
    <p class="hint" id=${`k-${key_.name}-d`}>${key_.meaning}</p>
  </fieldset>`;
}

function Flag({ key_, settings, inForce, set }) {
  const changed = settings[key_.name] !== inForce[key_.name];
  return html`<div class=${`control ${changed ? 'changed' : ''}`}>
    <div class="head"><label class="choice"><input type="checkbox" name=${key_.name} checked=${settings[key_.name]}
        aria-describedby=${`k-${key_.name}-d`} onChange=${(event) => set(key_.name, event.target.checked)} /> <span translate="no">${title(key_)}</span></label>
      <${Reset} show=${changed} what=${title(key_)} reset=${() => set(key_.name, inForce[key_.name])} /></div>
    <p class="hint" id=${`k-${key_.name}-d`}>${key_.meaning}</p>
  </div>`;
}

/** A colour by its hex digits, or none; as with `Field`, what is no colour changes nothing. */
function Rgb({ key_, settings, inForce, set }) {
  const [typed, setTyped] = useState(null);
  const value = settings[key_.name];
  const id = `k-${key_.name}`;
  const changed = value !== inForce[key_.name];
  const bad = typed !== null && typed.trim() !== '' && !isColour(typed.trim());
  const take = (given) => {
    const bare = given.trim().toLowerCase();
    setTyped(given);
    if (bare === '' || isColour(bare)) set(key_.name, bare || null);
  };
  return html`<div class=${`control ${changed ? 'changed' : ''}`}>
    <div class="head"><label for=${id} translate="no">${title(key_)}</label>
      <${Reset} show=${changed} what=${title(key_)} reset=${() => set(key_.name, inForce[key_.name])} /></div>
    <div class="row">${value && html`<span class="swatch" aria-hidden="true" ref=${painted(value)}></span>`}
      <input id=${id} name=${key_.name} class="field colour" translate="no" autocomplete="off" spellcheck=${false} maxlength="7" placeholder="#rrggbb" value=${typed ?? value ?? ''}
        aria-describedby=${`${id}-d`} aria-invalid=${bad ? 'true' : undefined} onInput=${(event) => take(event.target.value)} onKeyDown=${(event) => event.key === 'Enter' && event.target.blur()} onBlur=${() => setTyped(null)} /></div>
    <div id=${`${id}-d`}>${bad && html`<p class="said warning"><span aria-hidden="true">▲</span> # and six hex digits, two each of red, green and blue</p>`}
      <p class="hint">${key_.meaning}</p></div>
  </div>`;
}

/** A patch of a colour; the word for it stands beside it. */
function Swatch({ colour, name }) {
  return html`<span class="swatch" role="img" aria-label=${listed([t(name), `H ${colour[0]}, S ${colour[1]}, V ${colour[2]}`], ': ')}
    ref=${painted(css(colour))}></span>`;
}

/** The hues that a range lets in, on the whole circle. */
function HueBand({ low, high }) {
  const paint = (canvas) => {
    if (!canvas) return;
    const g = canvas.getContext('2d');
    for (let h = 0; h < 180; h += 1) {
      const inside = h >= low[0] && h <= high[0];
      g.fillStyle = css([h, 255, inside ? 230 : 130]);
      g.globalAlpha = inside ? 1 : 0.28;
      g.clearRect(h * 2, 0, 2, 18);
      g.fillRect(h * 2, inside ? 0 : 6, 2, inside ? 18 : 6);
    }
  };
  return html`<canvas class="hues" width="360" height="18" ref=${paint} role="img" aria-label=${`hues ${low[0]} to ${high[0]} of 180`}></canvas>`;
}

function Range({ number, settings, inForce, set, remarks }) {
  const names = [`red_low_${number}`, `red_high_${number}`];
  const [low, high] = names.map((name) => settings[name]);
  const changed = names.some((name) => !same(settings[name], inForce[name]));
  const put = (name, axis, value) => set(name, settings[name].map((old, n) => (n === axis ? value : old)));
  return html`<fieldset class=${`control range ${changed ? 'changed' : ''}`}>
    <div class="head"><legend>${text('red range {0}', number)}</legend>
      <${Reset} show=${changed} what=${text('red range {0}', number)} reset=${() => set(Object.fromEntries(names.map((name) => [name, inForce[name]])))} /></div>
    <div class="band"><${Swatch} colour=${low} name="lower corner" /><${HueBand} low=${low} high=${high} /><${Swatch} colour=${high} name="upper corner" /></div>
    ${AXES.map((letter, axis) => html`<div class="axis">
      <span class="letter" title=${AXIS_WORDS[axis]}>${letter}</span>
      ${names.map((name, side) => {
        const [least, most] = partLimits(name, axis, settings);
        const label = text('range {0}, {1}, {2}', number, t(AXIS_WORDS[axis]), t(side ? 'upper' : 'lower'));
        const accept = (given) => {
          const value = Number(given);
          return given.trim() !== '' && Number.isInteger(value) && value >= least && value <= most ? value : null;
        };
        return html`<span class="half">
          <input type="range" name=${`${name}.${letter}`} min="0" max=${axis ? 255 : 180} step="1" value=${settings[name][axis]} aria-label=${label}
            onInput=${(event) => {
              const value = Math.min(most, Math.max(least, Number(event.target.value)));
              event.target.value = value;
              put(name, axis, value);
            }} />
          <${Field} value=${settings[name][axis]} label=${text('{0}, number', label)} accept=${accept} take=${(good) => put(name, axis, good)} />
        </span>`;
      })}
    </div>`)}
    ${names.map((name) => html`<${Said} remarks=${remarks} name=${name} />`)}
  </fieldset>`;
}

/**
 * All controls. `set(name, value)` or `set({name: value, ...})`.
 * @param {{schema: import('./settings.js').Key[], settings: any, inForce: any, set: Function, remarks: any[], picture: any}} props
 */
export function Form({ schema, settings, inForce, set, remarks, picture }) {
  const parts = groups(schema);
  const paper = settings.method === 'paper';
  const diagonal = picture ? Math.hypot(picture.width_px, picture.height_px) : null;
  const [opened, setOpened] = useState({ paper, robust: !paper });
  useEffect(() => setOpened({ paper, robust: !paper }), [paper]);
  const one = (key) => {
    const props = { key_: key, settings, inForce, set, remarks };
    if (key.kind === 'choice') return html`<${Choice} ...${props} />`;
    if (key.kind === 'flag') return html`<${Flag} ...${props} />`;
    if (key.kind === 'rgb') return html`<${Rgb} ...${props} />`;
    const hint = key.unit === 'of the diagonal' && diagonal ? `here ${Math.round(settings[key.name] * diagonal)} px` : '';
    return html`<${Numeric} ...${props} hint=${hint} />`;
  };
  const toggled = (name) => (event) => event.target.open !== opened[name] && setOpened({ ...opened, [name]: event.target.open });
  const idle = html` <span class="muted">(no effect now)</span>`;
  return html`<form class="settings" onSubmit=${(event) => event.preventDefault()} aria-label="settings">
    ${parts.method.map(one)}
    <details open=${opened.paper} onToggle=${toggled('paper')}>
      <summary><h2>The paper's method${paper ? '' : idle}</h2></summary>
      <p class="hint">A pixel is red if it lies in either range, corners included. Hue 0 to 180 is a full turn: red lies at both ends.</p>
      ${[1, 2].map((number) => html`<${Range} number=${number} settings=${settings} inForce=${inForce} set=${set} remarks=${remarks} />`)}
      <h3>Blur and cleaning</h3>${parts.clean.map(one)}
      <h3>Gates</h3>${parts.gates.map(one)}
    </details>
    <details open=${opened.robust} onToggle=${toggled('robust')}>
      <summary><h2>The robust method${paper ? idle : ''}</h2></summary>
      ${parts.robust.map(one)}
    </details>
  </form>`;
}
