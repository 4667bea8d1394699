// Network cameras: found by WS-Discovery, asked for their streams by ONVIF. A password goes into a file of the gateway.

import { html, useState } from '../lib/page.js';
import { get, post } from '../lib/api.js';
import { number } from '../lib/format.js';
import { listed, text } from '../lib/lang.js';

const TIMEOUT_MS = 50_000;

const describe = ({ name, width_px, height_px, codec, rate_hz }) => listed([name, width_px > 0 && `${width_px} x ${height_px} px`, codec, rate_hz > 0 && number(rate_hz, 0, '/s')].filter(Boolean), ', ');

/** @param {{session: any, chosen: string, pick: (camera: any, password: string) => void}} given chosen: a stream's address; pick gets `[camera]` */
export function NetworkCameras({ session, chosen, pick }) {
  const [found, setFound] = useState(null); // null: nobody has searched
  const [searching, setSearching] = useState(false);
  const [wrong, setWrong] = useState('');
  const [service, setService] = useState('');
  const [login, setLogin] = useState({ username: '', password: '' });
  const [offer, setOffer] = useState(null); // of the camera; null: none, or it is asked
  const tried = async (work) => {
    setWrong('');
    try {
      await work();
    } catch (error) {
      setWrong(error.message);
    }
  };
  const search = () => tried(async () => {
    setSearching(true);
    try {
      setFound((await get('/api/setup/network-cameras', { timeoutMs: TIMEOUT_MS })).cameras);
    } finally {
      setSearching(false);
    }
  });
  const ask = (of, given) => tried(async () => {
    setService(of);
    setLogin(given);
    setOffer(null);
    setOffer(await post('/api/setup/streams', { service: of, ...given }, session.csrf, { timeoutMs: TIMEOUT_MS }));
  });
  const take = (url) => tried(async () => {
    const { username, password } = login;
    const kept = username && password ? await post('/api/setup/camera-password', { url, password }, session.csrf) : {};
    pick({ url, ...(username ? { username } : {}), ...kept }, password);
  });
  const send = (event) => {
    event.preventDefault();
    const [username, password] = [...event.target.querySelectorAll('input')].map((input) => input.value);
    ask(service, { username, password });
  };
  return html`<fieldset class="step"><legend>Cameras of the network</legend>
    <p><button type="button" disabled=${searching} onClick=${search}>Search the network</button></p>
    <div role="status">${searching ? html`<p>Looking for network cameras …</p>` : found?.length === 0 && html`<p>No camera has answered (ONVIF). Is it switched on, and ONVIF with it, and in the same network?</p>`}</div>
    ${found?.length > 0 && html`<div class="choices">${found.map((camera) => html`<label><input type="radio" name=${found[0].address} checked=${service === camera.service} onChange=${() => ask(camera.service, { username: '', password: '' })} /><span translate="no">${camera.name || camera.address}</span>
      <small translate="no">${listed([camera.model, camera.address].filter(Boolean), ', ')}</small></label>`)}</div>`}
    ${service && offer === null && !wrong && html`<p role="status">Asking the camera …</p>`}
    ${offer?.login && html`<form class="field" onSubmit=${send}>
      <label for="network-user">User of the camera</label><input id="network-user" required autocomplete="off" />
      <label for="network-password">Password</label><input id="network-password" type="password" autocomplete="off" />
      <span class="row"><button>Log in to the camera</button></span></form>`}
    ${(wrong || offer?.why) && html`<p class="notice bad" role="alert">${wrong || offer.why}</p>`}
    ${offer?.streams.length > 0 && html`<div class="choices" role="group" aria-label="streams of the camera">${offer.streams.map((stream) => html`<label><input type="radio" name=${service} checked=${chosen === stream.url} onChange=${() => take(stream.url)} /><span translate="no">${describe(stream)}</span>
      <small translate="no">${stream.url}</small></label>`)}</div>
      <p class="hint">${text('Choose a stream near {0}, as H264 or JPEG: a larger one costs computing time.', '640 x 480 px')}</p>`}
  </fieldset>`;
}
