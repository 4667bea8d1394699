// The bar at the top of the pages for desks: brand, the other pages, and who is logged in.

import { html } from '../vendor/preact-htm.js';
import { post } from './api.js';

/** @param {{title: any, more?: any}} words */
export const Brand = ({ title, more = '' }) => html`<a class="brand" href="/"><svg viewBox="0 0 32 32" aria-hidden="true"><circle cx="16" cy="16" r="10" fill="none" stroke="currentColor" stroke-width="3" /><path d="M16 2v9M16 21v9M2 16h9M21 16h9" stroke="currentColor" stroke-width="2.4" /></svg>
  <span>${title}<span class="muted small"> ${more}</span></span></a>`;

/** `bay`: the one that is looked at; none: the first. @param {{session: any, bay: string|null, current: string}} at */
export function Pages({ session, bay, current }) {
  const path = encodeURIComponent(bay ?? session.bays[0] ?? '');
  const pages = [
    ['Operator', bay === null || current === 'Operator' ? '/' : `/#${path}`],
    ['Driver', `/driver/${path}`],
    ['History', `/history#${path}`],
    ['Manager', `/manager?bay=${path}`],
    ...(session.role === 'technician' ? [['Technician', `/tune/${path}`]] : []),
  ];
  return html`<nav aria-label="pages">
    ${pages.map(([name, href]) => html`<a href=${href} aria-current=${name === current ? 'page' : undefined}>${name}</a>`)}
  </nav>`;
}

/** `next`: where to go after a login. @param {{session: any, next?: string}} at */
export function Who({ session, next = location.pathname + location.search }) {
  const logout = async () => {
    try {
      await post('/api/logout', {}, session.csrf);
    } finally {
      location.assign('/login');
    }
  };
  if (session.name !== null)
    return html`<span>${session.name} <span class="muted">(${session.role})</span></span><button type="button" class="plain small" onClick=${logout}>Log out</button>`;
  return session.can_login ? html`<a href=${`/login?next=${encodeURIComponent(next)}`}>Log in</a>` : html`<span class="muted">no login (${session.role})</span>`;
}
