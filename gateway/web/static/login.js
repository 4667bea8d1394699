// The login. Where one wanted to go is only ever a path of this server.

import { get, post, safePath } from './lib/api.js';

const element = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
const form = /** @type {HTMLFormElement} */ (document.querySelector('form'));
const name = /** @type {HTMLInputElement} */ (element('name'));
const password = /** @type {HTMLInputElement} */ (element('password'));
const eye = element('eye');
const submit = /** @type {HTMLButtonElement} */ (form.querySelector('[type=submit]'));
const next = safePath(new URLSearchParams(location.search).get('next') ?? '/', location.origin);

function trouble(text) {
  const at = element('trouble');
  at.textContent = text;
  at.hidden = text === '';
}

async function session() {
  const answer = await get('/api/session');
  element('none').hidden = answer.can_login;
  return answer;
}

form.addEventListener('submit', async (event) => {
  event.preventDefault();
  if (!name.value || !password.value) {
    trouble('Name and password, please.');
    (name.value ? password : name).focus();
    return;
  }
  submit.disabled = true;
  trouble('');
  try {
    const { csrf } = await session();
    const answer = await post('/api/login', { name: name.value, password: password.value, next }, csrf);
    location.replace(safePath(answer.next ?? next, location.origin));
  } catch (error) {
    password.value = '';
    trouble(error.name === 'TypeError' ? 'The gateway does not answer.' : error.message);
    password.focus();
    submit.disabled = false;
  }
});

eye.addEventListener('click', () => {
  const shown = password.type === 'text';
  password.type = shown ? 'password' : 'text';
  eye.setAttribute('aria-pressed', String(!shown));
  eye.textContent = shown ? 'Show' : 'Hide';
  password.focus();
});

session().catch(() => trouble('The gateway does not answer.'));
name.focus();
