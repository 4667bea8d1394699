// What stands at an address of no page.

import { html, render } from './lib/page.js';
import { titled } from './lib/title.js';
import { Brand } from './lib/top.js';

titled('No such page');
render(html`<header class="top"><${Brand} title="Loading gateway" /></header>
  <main class="page"><h1>There is no such page</h1><p><a href="/">To the operator's page</a></p></main>`, document.body);
