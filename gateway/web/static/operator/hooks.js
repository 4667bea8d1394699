// What the components share: the live link, the time, and things fetched again and again while they are looked at.

import { useEffect, useRef, useState } from '../lib/page.js';
import { get, toLogin } from '../lib/api.js';
import { Freshness } from '../lib/freshness.js';
import { open } from '../lib/live.js';
import { text } from '../lib/lang.js';
import { remember, remembered } from '../lib/memory.js';

/** Steady time now, ms, renewed every `everyMs`; not in the background. */
export function useNow(everyMs) {
  const [now, setNow] = useState(performance.now());
  useEffect(() => {
    const timer = setInterval(() => !document.hidden && setNow(performance.now()), everyMs);
    return () => clearInterval(timer);
  }, [everyMs]);
  return now;
}

/** Does the screen fit this media query now? @param {string} query */
export function useMedia(query) {
  const [fits, setFits] = useState(() => matchMedia(query).matches);
  useEffect(() => {
    const media = matchMedia(query);
    const changed = () => setFits(media.matches);
    media.addEventListener('change', changed);
    return () => media.removeEventListener('change', changed);
  }, [query]);
  return fits;
}

/**
 * The newest message of `/api/live` for these bays (none: all), at most every `paceMs`.
 * @param {string[]} bays @param {number} paceMs
 * @returns {{view: any, connected: boolean, refusal: string, freshness: Freshness}}
 */
export function useLive(bays, paceMs, limitMs) {
  const [got, setGot] = useState({ view: null, connected: false, refusal: '' });
  const freshness = useRef(new Freshness(limitMs));
  const path = `/api/live${bays.length ? '?' : ''}${bays.map((bay) => `bay=${encodeURIComponent(bay)}`).join('&')}`;
  useEffect(() => {
    let timer = 0;
    let frame = 0;
    freshness.current = new Freshness(limitMs);
    setGot((was) => ({ ...was, view: null }));
    const link = open(path, {
      message(text, arrival) {
        let view = null;
        try {
          view = JSON.parse(text);
        } catch {
          view = null;
        }
        if (view && Array.isArray(view.bays) && view.alarms && view.links) {
          freshness.current.received(0, arrival.receivedMs, Date.now());
          setGot({ view, connected: true, refusal: '' });
        } else freshness.current.forget();
        // Drawn, and not sooner than the pace: then the next. In the background no frame is drawn and nothing asked.
        frame = requestAnimationFrame(() => {
          timer = setTimeout(link.next, Math.max(0, paceMs - (performance.now() - arrival.askedMs)));
        });
      },
      state: (on) => setGot((was) => ({ ...was, connected: on })),
      refused: (why) => setGot((was) => ({ ...was, refusal: text('The gateway refuses this page: {0}.', why) })),
    }, { restsHidden: true });
    return () => {
      clearTimeout(timer);
      cancelAnimationFrame(frame);
      link.close();
    };
  }, [path, paceMs, limitMs]);
  return { ...got, freshness: freshness.current };
}

/**
 * `path` fetched when `key` changes, and every `everyMs` (0: never again) while `on` and the page is in front.
 * @returns {[any, string]} newest answer or null, and what went wrong
 */
export function useFetched(path, key, everyMs, on = true) {
  const [got, setGot] = useState([null, '']);
  useEffect(() => {
    if (!on) return undefined;
    const end = new AbortController();
    let timer = 0;
    const once = async () => {
      if (!document.hidden) {
        try {
          const answer = await get(path, { signal: end.signal });
          setGot([answer, '']);
        } catch (error) {
          if (end.signal.aborted) return;
          if (error.status === 401) toLogin();
          setGot((was) => [was[0], error.name === 'TypeError' ? 'no connection to the gateway' : error.message]);
        }
      }
      if (everyMs && !end.signal.aborted) timer = setTimeout(once, everyMs);
    };
    once();
    return () => {
      clearTimeout(timer);
      end.abort();
    };
  }, [path, key, everyMs, on]);
  return got;
}

/** `value`, of which a change is passed on at most every `everyMs`: the first at once, then the newest. */
export function useAtMost(value, everyMs) {
  const [passed, setPassed] = useState(value);
  const atMs = useRef(-Infinity);
  useEffect(() => {
    const timer = setTimeout(() => {
      atMs.current = performance.now();
      setPassed(value);
    }, Math.max(0, atMs.current + everyMs - performance.now()));
    return () => clearTimeout(timer);
  }, [value, everyMs]);
  return passed;
}

/** A piece of state that outlives a reload of the page, where the browser keeps such things. */
export function useKept(name, initial) {
  const [value, setValue] = useState(() => {
    try {
      const kept = remembered(name);
      return kept === null ? initial : JSON.parse(kept);
    } catch {
      return initial; // somebody else's
    }
  });
  const keep = (next) => {
    setValue(next);
    remember(name, JSON.stringify(next));
  };
  return [value, keep];
}
