// The bar above a page of the manual, whose text the gateway has rendered.

import { html, render } from './lib/page.js';
import { renewed } from './lib/start.js';
import { Brand, Pages, SessionMenu } from './lib/top.js';

const session = await renewed();
render(html`<${Brand} /><${Pages} session=${session} current="Manual" />
  <div class="facts push"><${SessionMenu} session=${session} /></div>`, document.querySelector('header'));
