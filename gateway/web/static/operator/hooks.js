// What the components share: the live link, the time, and things fetched again and again while they are looked at.

import { html, useEffect, useMemo, useRef, useState } from '../lib/page.js';
import { get, toLogin } from '../lib/api.js';
import { age } from '../lib/format.js';
import { Freshness, LIMIT_MS, moment } from '../lib/freshness.js';
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

/** What may have passed unnoticed before these: the page was hidden, frozen, or kept by the browser. */
/** @type {[EventTarget, string][]} */
const WAKING = [[document, 'visibilitychange'], [document, 'freeze'], [document, 'resume'], [window, 'pageshow']];

/**
 * The newest answer and whether it is still true. It ends to be so by this page's own timer, whatever arrives or not.
 * `last`: the answer, for what does not grow old (names, thresholds); `fresh(partMs)`: is a part of it that was so old when
 * it was sent to be shown? `ages`: of its parts, so that the page is drawn anew when one of them has become too old.
 * `take(answer, asked, heldMs)`: see `Freshness`. @param {number} limitMs @param {(answer: any) => (number|null)[]} ages
 */
export function useFresh(limitMs = LIMIT_MS, ages = (answer) => [answer.age_ms]) {
  const freshness = useMemo(() => new Freshness(limitMs), [limitMs]);
  const { current: kept } = useRef({ last: null, judged: '' });
  const [, draw] = useState(0);
  const drawn = () => draw((n) => n + 1);
  const fresh = (partMs) => freshness.fresh(moment(), partMs ?? null);
  useEffect(() => {
    const judge = () => {
      const judged = kept.last == null ? '' : ages(kept.last).map(fresh).join();
      if (judged !== kept.judged) drawn();
      kept.judged = judged;
    };
    const timer = setInterval(judge, 100);
    for (const [at, event] of WAKING) at.addEventListener(event, judge);
    return () => {
      clearInterval(timer);
      for (const [at, event] of WAKING) at.removeEventListener(event, judge);
    };
  }, [freshness]);
  const take = (answer, asked, heldMs = 0) => {
    freshness.received(0, asked, moment(), heldMs);
    kept.last = answer;
    drawn();
  };
  const forget = (whole = false) => {
    freshness.forget();
    if (whole) kept.last = null;
    drawn();
  };
  return { last: kept.last, fresh, ageMs: (partMs) => freshness.ageMs(moment()) + (partMs ?? Infinity), take, forget };
}

/** What stands behind the address's #, as it changes. */
export function useHash() {
  const [hash, setHash] = useState(location.hash);
  useEffect(() => {
    const changed = () => setHash(location.hash);
    addEventListener('hashchange', changed);
    return () => removeEventListener('hashchange', changed);
  }, []);
  return hash;
}

/** How old that is which stands beside it. `of`: as from `useFresh`; `partMs`: of the part, when it was sent. */
export function Age({ of, partMs }) {
  useNow(250);
  return html`<span class="small value age" title="age of the data">${age(of.ageMs(partMs))}</span>`;
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
 * The newest message of `/api/live` for these bays (none: all), at most every `paceMs`: as `useFresh`, and the link.
 * `stateOf(bay)`: its state in that message, null: not known (any more). @param {string[]} bays @param {number} paceMs
 */
export function useLive(bays, paceMs, limitMs = LIMIT_MS) {
  const live = useFresh(limitMs, (view) => [view.alarms, ...view.bays].map((part) => part.age_ms));
  const [link, setLink] = useState({ connected: false, refusal: '' });
  const path = `/api/live${bays.length ? '?' : ''}${bays.map((bay) => `bay=${encodeURIComponent(bay)}`).join('&')}`;
  useEffect(() => {
    let timer = 0;
    let frame = 0;
    live.forget(true);
    const link = open(path, {
      message(text, asked) {
        let view = null;
        try {
          view = JSON.parse(text);
        } catch {
          view = null;
        }
        if (view && Array.isArray(view.bays) && view.alarms && view.links) {
          for (const { state, vision_said, range_said } of view.bays.filter((bay) => bay.state)) {
            state.vision.said = vision_said;
            state.range.said = range_said;
          }
          live.take(view, asked, view.held_ms);
          setLink({ connected: true, refusal: '' });
        } else live.forget();
        // Drawn, and not sooner than the pace: then the next. In the background no frame is drawn and nothing asked.
        frame = requestAnimationFrame(() => {
          timer = setTimeout(link.next, Math.max(0, paceMs - (performance.now() - asked.steadyMs)));
        });
      },
      state(on) {
        if (!on) live.forget();
        setLink((was) => ({ ...was, connected: on }));
      },
      refused: (why) => setLink((was) => ({ ...was, refusal: text('The gateway refuses this page: {0}.', why) })),
    }, { restsHidden: true });
    return () => {
      clearTimeout(timer);
      cancelAnimationFrame(frame);
      link.close();
    };
  }, [path, paceMs, limitMs]);
  const stateOf = (name) => {
    const one = live.last?.bays.find(({ bay }) => bay === name);
    return one?.state && live.fresh(one.age_ms) ? one.state : null;
  };
  return { ...live, ...link, stateOf };
}

/**
 * `path` asked when `key` changes, and every `everyMs` (0: never again) while `on` and the page is in front.
 * @param {(answer: any, asked: import('../lib/freshness.js').Moment) => void} take @param {() => void} [begin] before the first
 * @returns {string} what went wrong
 */
function useAsked(path, key, everyMs, on, take, begin = () => {}) {
  const [wrong, setWrong] = useState('');
  useEffect(() => {
    begin();
    if (!on) return undefined;
    const end = new AbortController();
    let timer = 0;
    const once = async () => {
      if (!document.hidden) {
        const asked = moment();
        try {
          take(await get(path, { signal: end.signal }), asked);
          setWrong('');
        } catch (error) {
          if (end.signal.aborted) return;
          if (error.status === 401) toLogin();
          setWrong(error.name === 'TypeError' ? 'no connection to the gateway' : error.message);
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
  return wrong;
}

/** What `path` answers, again and again: as `useFresh`, and what went wrong. */
export function usePolled(path, everyMs, on = true) {
  const live = useFresh();
  const wrong = useAsked(path, '', everyMs, on, live.take, () => live.forget(true));
  return { ...live, wrong };
}

/**
 * What `path` answered, for what does not grow old.
 * @returns {[any, string]} newest answer or null, and what went wrong
 */
export function useFetched(path, key, everyMs, on = true) {
  const [got, setGot] = useState(null);
  return [got, useAsked(path, key, everyMs, on, setGot)];
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
