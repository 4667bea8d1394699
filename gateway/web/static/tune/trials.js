// Trials one after the other: while one runs, only the newest request waits, so that a slider is never followed by a queue.
// A long measurement is not waited for: a newer request takes its place, and the gateway then gives it up.

/**
 * @param {(request: any) => Promise<any>} ask one trial
 * @param {{done: (result: any, request: any) => void, failed: (error: Error, request: any) => void, busy: (on: boolean) => void}} tell
 */
export function trials(ask, tell, wait = { quickMs: 40, restMs: 600 }) {
  let request = null; // the newest that has not begun
  let running = null;
  let timer = 0;
  let rest = 0;
  let ended = false;

  const run = async () => {
    if (request === null || ended || (running !== null && !running.timed)) return;
    const mine = request;
    request = null;
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
    if (request === null) tell.busy(false);
    else run();
  };
  return {
    /**
     * Try `what` in a moment; when nothing more is requested for a while, once more with times.
     * Not `timed`: only the same settings on a newer picture, which takes no measurement's place, under way or waiting.
     */
    want(what, { timed = true } = {}) {
      if (!timed && (running?.timed || request?.timed)) return;
      clearTimeout(timer);
      timer = setTimeout(() => {
        if (!timed && (running?.timed || request?.timed)) return;
        request = { ...what, timed: false };
        run();
      }, wait.quickMs);
      if (!timed) return;
      clearTimeout(rest);
      rest = setTimeout(() => {
        request = { ...what, timed: true };
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
