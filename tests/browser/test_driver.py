"""The driver's display: what the gateway says, and STOP by itself as soon as that is not known to be true."""

import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from playwright.sync_api import Page, expect

from tests.browser.chromium import SERVER_GONE, Watch, until
from tests.browser.conftest import Visit
from tests.browser.plant import Plant, plant

MOVING = {"FORWARD", "BACK", "SLOW", "LEFT", "RIGHT"}
# Data older than half a second is not shown; tests/pages/freshness.test.js has that on a clock of its own. Here a busy
# machine may add to a timer what it likes. A page that waits for its connection to end would take a minute when the
# other side only hangs.
LATEST_MS = 500 + 20_000
# When the newest message came, and when the display last went from showing it to STOP; both by the page's own clock.
RECORDER = """
window.__seen = { message_ms: null, stopped_ms: null };
const Real = WebSocket;
window.WebSocket = class extends Real {
  constructor(...args) {
    super(...args);
    this.addEventListener('message', () => { window.__seen.message_ms = performance.now(); });
  }
};
addEventListener('DOMContentLoaded', () => {
  new MutationObserver(() => {
    if (document.body.dataset.fresh === 'false') window.__seen.stopped_ms = performance.now();
  }).observe(document.body, { attributeFilter: ['data-fresh'] });
});
"""


@pytest.fixture(scope="module")
def bay(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant")) as running:
        yield running


def shows(page: Page) -> str:
    """The word that a driver reads: under the STOP that lies over everything, nothing else counts."""
    expected: str = page.evaluate("""() => {
      const over = document.querySelector('#deadman');
      const box = over.getBoundingClientRect();
      const covers = box.left <= 0 && box.top <= 0 && box.right >= innerWidth && box.bottom >= innerHeight;
      const opacity = Number(getComputedStyle(over).opacity);
      if (opacity === 1 && covers) return over.querySelector('.word').textContent;
      return opacity === 0 ? document.body.dataset.code : `between: ${opacity}`;
    }""")
    return expected


def driving(page: Page) -> None:
    until(page, lambda: shows(page) in MOVING)


@pytest.fixture
def page(bay: Plant, visit: Visit) -> Page:
    opened = visit(f"{bay.url}/driver", before=RECORDER)
    driving(opened)
    return opened


def stop_in_time(page: Page) -> None:
    until(page, lambda: shows(page) == "STOP")
    seen = page.evaluate("() => window.__seen")
    assert seen["stopped_ms"] - seen["message_ms"] < LATEST_MS
    expect(page).to_have_title("STOP")
    assert not page.locator("#show").is_visible() or page.locator("#show").get_attribute("aria-hidden") == "true"


def stays_stopped(page: Page, for_ms: int = 1500) -> None:
    """Nothing flickers up again, whatever the page tries to get connected."""
    page.evaluate("() => { window.__seen.stopped_ms = null; window.__seen.message_ms = null; }")
    others = page.evaluate(
        """async (ms) => {
          const others = [], end = performance.now() + ms;
          while (performance.now() < end) {
            if (document.body.dataset.fresh !== 'false') others.push(document.body.dataset.code);
            await new Promise((next) => setTimeout(next, 20));
          }
          return others;
        }""",
        for_ms,
    )
    assert others == []


@contextlib.contextmanager
def stopped(process: psutil.Process) -> Iterator[None]:
    process.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        process.send_signal(signal.SIGCONT)


def test_a_gateway_that_hangs_is_stop_until_it_goes_on(bay: Plant, page: Page) -> None:
    """The web process is alive and answers; but what it has to tell grows old."""
    with stopped(psutil.Process(bay.gateway.process.pid)):
        stop_in_time(page)
        stays_stopped(page)
    driving(page)


def test_a_web_process_that_hangs_is_stop_until_it_goes_on(bay: Plant, page: Page) -> None:
    """The connection stays open and says nothing."""
    with stopped(bay.process("gw-hmi")):
        stop_in_time(page)
        stays_stopped(page)
    driving(page)


@pytest.mark.long
def test_a_web_process_that_dies_is_stop_until_there_is_a_new_one(bay: Plant, page: Page, watches: list[Watch]) -> None:
    watches[0].excused = SERVER_GONE
    first = bay.process("gw-hmi")
    first.kill()
    stop_in_time(page)
    driving(page)
    assert bay.process("gw-hmi").pid != first.pid


@pytest.mark.long
def test_a_gateway_that_dies_is_stop(visit: Visit, watches: list[Watch], tmp_path: Path) -> None:
    with plant(tmp_path) as bay:
        page = visit(f"{bay.url}/driver", before=RECORDER)
        driving(page)
        watches[0].excused = SERVER_GONE
        bay.gateway.process.kill()
        stop_in_time(page)
        stays_stopped(page)
