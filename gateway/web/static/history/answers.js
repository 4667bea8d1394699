// One answer at a time for an address; a newer address gives up what the older one waited for.

import { useEffect, useState } from '../lib/page.js';
import { get, toLogin } from '../lib/api.js';

/**
 * @param {string|null} path null: nothing is asked
 * @param {{timeoutMs?: number, waitMs?: number, key?: unknown}} [how] `waitMs`: before it is asked, for what changes while somebody scrolls
 * @returns {{answer: any, path: string|null, wrong: string, busy: boolean}} the newest answer, of which address, and what went wrong since
 */
export function useAnswer(path, { timeoutMs = 20_000, waitMs = 0, key = 0 } = {}) {
  const [got, setGot] = useState({ answer: null, path: null, wrong: '', busy: false });
  useEffect(() => {
    if (path === null) {
      setGot({ answer: null, path: null, wrong: '', busy: false });
      return undefined;
    }
    const end = new AbortController();
    setGot((was) => ({ ...was, busy: true }));
    const timer = setTimeout(async () => {
      try {
        const answer = await get(path, { signal: end.signal, timeoutMs });
        setGot({ answer, path, wrong: '', busy: false });
      } catch (error) {
        if (end.signal.aborted) return;
        if (error.status === 401) toLogin();
        setGot({ answer: null, path, wrong: error.name === 'TypeError' ? 'no connection to the gateway' : error.message, busy: false });
      }
    }, waitMs);
    return () => {
      clearTimeout(timer);
      end.abort();
    };
  }, [path, key]);
  return got;
}
