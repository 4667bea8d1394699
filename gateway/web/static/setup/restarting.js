// Waits for another start of the gateway.

import { get } from '../lib/api.js';

const LOOK_MS = 1000;

/** Until another start than `boot` answers. `waiting(ms)`: this long so far; what it throws ends the wait. */
export async function restarted(boot, waiting) {
  const begun = performance.now();
  for (;;) {
    await new Promise((over) => setTimeout(over, LOOK_MS));
    waiting(performance.now() - begun);
    try {
      if ((await get('/api/setup/boot', { timeoutMs: 3000 })).boot !== boot) return;
    } catch (error) {
      if (error.status === 401) return; // it has started, and its sessions are new
    }
  }
}
