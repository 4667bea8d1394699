// What stands at an address of no page.

import { html, render } from './lib/page.js';
import { renewed } from './lib/start.js';
import { titled } from './lib/title.js';
import { Brand, Pages, SessionMenu } from './lib/top.js';

const session = await renewed().catch(() => null); // the page itself stands without it
titled('No such page');
render(html`<header class="top"><${Brand} title="Loading gateway" />
    ${['viewer', 'technician'].includes(session?.role) && html`<${Pages} session=${session} current="" /><div class="facts push"><${SessionMenu} session=${session} /></div>`}</header>
  <main class="page"><h1>There is no such page</h1><p><a href="/">To the operator's page</a></p></main>`, document.body);
