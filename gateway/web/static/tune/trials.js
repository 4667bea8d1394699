// Trials one after the other: while one runs, only the newest wish waits, so that a slider is never followed by a queue.
// A long measurement is not waited for: a newer wish takes its place, and the gateway then gives it up.

/**
 * @param {(wish: any) => Promise<any>} ask one trial
 * @param {{done: (result: any, wish: any) => void, failed: (error: Error, wish: any) => void, busy: (on: boolean) => void}} tell
 */
export function trials(ask, tell, wait = { quickMs: 40, restMs: 600 }) {
  let wish = null; // the newest that has not begun
  let running = null;
  let timer = 0;
  let rest = 0;
  let ended = false;

  const run = async () => {
    if (wish === null || ended || (running !== null && !running.timed)) return;
    const mine = wish;
    wish = null;
    running = mine;
    tell.busy(true);
    let tells = () => {};
    try {
      const result = await ask(mine);
      tells = () => tell.done(result, mine);
    } catch (error) {
      tells = () => tell.failed(error, mine);
    }
    if (ended || running !== mine) return;
    running = null;
    tells();
    if (wish === null) tell.busy(false);
    else run();
  };
  return {
    /**
     * Try `what` in a moment; when nothing more is wished for a while, once more with times.
     * Not `timed`: only the same settings on a newer picture, which takes no measurement's place, under way or waiting.
     */
    want(what, { timed = true } = {}) {
      if (!timed && (running?.timed || wish?.timed)) return;
      clearTimeout(timer);
      timer = setTimeout(() => {
        if (!timed && (running?.timed || wish?.timed)) return;
        wish = { ...what, timed: false };
        run();
      }, wait.quickMs);
      if (!timed) return;
      clearTimeout(rest);
      rest = setTimeout(() => {
        wish = { ...what, timed: true };
        run();
      }, wait.restMs);
    },
    close() {
      ended = true;
      clearTimeout(timer);
      clearTimeout(rest);
    },
  };
}
