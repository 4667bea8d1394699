// The login, in the viewer's language. Where it leads to is in the gateway's answer: a path of this server, whatever was asked for.

import { html, render, useEffect, useRef, useState } from './lib/page.js';
import { get, post } from './lib/api.js';
import { text } from './lib/lang.js';
import { titled } from './lib/title.js';
import { ViewMenu } from './lib/top.js';

const asked = new URLSearchParams(location.search);
const next = asked.get('next');
const lacking = asked.has('need'); // the role of the page that was asked for

/** The session when the first password, which was just made, is in force. */
async function inForce() {
  for (let n = 0; n < 100; n += 1) {
    await new Promise((done) => setTimeout(done, 300));
    const answer = await get('/api/session').catch(() => null);
    if (answer && !answer.first_password) return answer;
  }
  throw new DOMException('', 'TimeoutError');
}

/** @param {any} error of a login */
function words(error) {
  if (error.name === 'TypeError' || error.name === 'TimeoutError') return 'The gateway does not answer.';
  if (error.status === 401) return 'Wrong name or password.';
  const waitS = /in (\d+) s$/.exec(error.message)?.[1];
  return error.status === 429 && waitS ? text('Too many failed logins: try again in {0} s.', waitS) : error.message;
}

function Login() {
  const [session, setSession] = useState(/** @type {any} */ (null));
  const [trouble, setTrouble] = useState('');
  const [busy, setBusy] = useState(false);
  const [shown, setShown] = useState(false);
  const name = useRef(/** @type {any} */ (null));
  const password = useRef(/** @type {any} */ (null));
  const again = useRef(/** @type {any} */ (null));
  const first = session?.first_password; // nobody has one yet
  const renewed = async () => {
    const answer = await get('/api/session');
    setSession(answer);
    return answer;
  };
  useEffect(() => {
    renewed().catch(() => setTrouble('The gateway does not answer.'));
    name.current.focus();
  }, []);
  const submit = async (event) => {
    event.preventDefault();
    if (!name.current.value || !password.current.value) {
      setTrouble('Name and password, please.');
      (name.current.value ? password : name).current.focus();
      return;
    }
    if (first && password.current.value !== again.current.value) {
      setTrouble('The two passwords differ.');
      again.current.focus();
      return;
    }
    setBusy(true);
    setTrouble('');
    const typed = { name: name.current.value, password: password.current.value };
    try {
      let { csrf } = await renewed();
      if (first) {
        await post('/api/setup/first-password', typed, csrf);
        ({ csrf } = await inForce());
      }
      const answer = await post('/api/login', { ...typed, next: first ? '/setup/new-bay' : next }, csrf);
      location.replace(answer.next);
    } catch (error) {
      password.current.value = '';
      password.current.focus();
      setTrouble(words(error));
      setBusy(false);
      if (first) await renewed().catch(() => null); // somebody else may have made it
    }
  };
  const show = () => {
    setShown(!shown);
    password.current.focus();
  };
  return html`<main class="login">
    <form class="panel" method="post" action="/api/login" novalidate onSubmit=${submit}>
      <div class="row spread"><img src="/static/icon.svg" alt="" width="48" height="48" /><${ViewMenu} /></div>
      <h1>${first ? 'Make the first password' : 'Log in to the loading gateway'}</h1>
      <p class="notice bad" role="alert" hidden=${!trouble}>${trouble}</p>
      <p class="notice" hidden=${!(session?.name && lacking)}>The page that you asked for needs a login with more rights.</p>
      <p class="notice" hidden=${!first}>Nobody can log in yet. Who makes a password now is the technician of this gateway, and makes the other users. It has at least 10 characters.</p>
      <p class="notice" hidden=${session?.can_login !== false || first}>No users are configured. The command “gateway password” makes one for [[hmi.users]].</p>
      <label for="name">Name</label>
      <input id="name" ref=${name} name="name" autocomplete="username" autocapitalize="none" spellcheck=${false} required maxlength="64" />
      <label for="password">Password</label>
      <div class="with-eye">
        <input id="password" ref=${password} name="password" type=${shown ? 'text' : 'password'} autocomplete=${first ? 'new-password' : 'current-password'} required />
        <button type="button" aria-pressed=${String(shown)} aria-controls="password" onClick=${show}>${shown ? 'Hide' : 'Show'}</button>
      </div>
      ${first && html`<input ref=${again} type=${shown ? 'text' : 'password'} autocomplete="new-password" aria-label="the same again" placeholder="the same again" required />`}
      <button class="primary" type="submit" disabled=${busy}>${first ? 'Make it and go on' : 'Log in'}</button>
      <p class="small muted" hidden=${first}><a href="/driver">Driver's display</a></p>
    </form>
  </main>`;
}

titled('Log in');
render(html`<${Login} />`, document.body);
