// How a page for desks begins: with the session, asked for until the gateway answers; and what stands there instead of a
// page whose script has failed.

import { get, toLogin } from './api.js';
import { learnTitles } from './bays.js';
import { html, render, useErrorBoundary } from './page.js';
import { learnZone } from './zone.js';

/** Who is logged in; from then on bays have their titles, and times the gateway's zone. */
export async function renewed() {
  const session = await get('/api/session');
  learnTitles(session.titles);
  learnZone(session.time_zone);
  return session;
}

/** The page, or that it has failed. @param {(props: {session: any}) => any} Page */
export const guarded = (Page) => function Guarded({ session }) {
  const [error] = useErrorBoundary((thrown) => console.error(thrown));
  if (error) return html`<main class="page"><p class="notice bad" role="alert"><b>This page has failed.</b> Load it again.</p></main>`;
  return html`<${Page} session=${session} />`;
};

/** Draws the page. @param {(props: {session: any}) => any} Page with its own guard against failing */
export async function start(Page) {
  try {
    const session = await renewed();
    render(html`<${Page} session=${session} />`, document.body);
  } catch (error) {
    if (error.status === 401) return toLogin();
    render(html`<main class="page"><p class="notice bad" role="alert"><b>The gateway does not answer.</b> Trying again. <span class="muted">${error.name === 'TypeError' ? 'no connection' : error.message}</span></p></main>`, document.body);
    setTimeout(() => start(Page), 2000);
  }
}
