"""Pages behind a link that delays, stalls or is slow, and over a web process that dies: no old word stands as live."""

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.browser.chromium import SERVER_GONE, Watch, until
from tests.browser.conftest import Visit
from tests.browser.plant import TO_AND_FRO, Plant, plant
from tests.e2e.tcp_proxy import NetworkConditions, Proxy
from tests.long import mostly_long

# For how long after its newest answer was asked for a decision stood on the page, at most; and how many answers came.
# A busy machine may add to a timer what it likes: what is to be seen is some seconds.
OLDEST = """
Object.assign(window, { __of: 0, __oldest: 0, __answers: 0 });
const Real = WebSocket;
window.WebSocket = class extends Real {
  asked = performance.now();
  constructor(...args) {
    super(...args);
    this.addEventListener('message', () => { window.__of = this.asked; window.__answers += 1; });
  }
  send(what) {
    this.asked = performance.now();
    super.send(what);
  }
};
setInterval(() => {
  const said = document.querySelector('.decision .word, .bay-now')?.textContent ?? '';
  const known = /^(?!.*NOT KNOWN).*(IN PLACE|STOP|MAY)/.test(said);
  if (known) window.__oldest = Math.max(window.__oldest, performance.now() - window.__of);
}, 20);
"""
LIMIT_MS, SLACK_MS = 1500, 2500
KNOWN, UNKNOWN = re.compile("^(?!.*NOT KNOWN).*(IN PLACE|STOP|MAY)"), re.compile("NOT KNOWN")
DELAYS = NetworkConditions(delay_s=2.25)  # each way: together more than limit and slack
SLOW = NetworkConditions(bytes_per_s=50_000)
STALLS = NetworkConditions(swallow=True)


@pytest.fixture(scope="module")
def bay(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant"), TO_AND_FRO) as running:
        yield running


def decision(page: Page) -> Locator:
    return page.locator(".decision .word, .bay-now")


def in_time(page: Page) -> bool:
    oldest_ms: float = page.evaluate("() => window.__oldest")
    return oldest_ms < LIMIT_MS + SLACK_MS


@pytest.mark.long
@pytest.mark.parametrize("path", mostly_long(["/#bay1", "/tune/bay1"]))
def test_a_decision_that_was_long_on_its_way_is_not_shown(
    bay: Plant, visit: Visit, watches: list[Watch], path: str
) -> None:
    with Proxy(int(bay.url.rpartition(":")[2]), conditions=SLOW) as link:
        page = visit(f"http://127.0.0.1:{link.port}{path}", before=OLDEST)
        expect(decision(page)).to_have_text(KNOWN)  # a slow link is enough
        expect(page.locator(".age").first).to_have_text(re.compile(r"\d\u202fm?s"))
        answers = page.evaluate("() => window.__answers")
        until(page, lambda: page.evaluate("() => window.__answers") >= answers + 10)
        assert in_time(page)
        watches[0].excused = SERVER_GONE  # a request that waits when the link ends
        link.conditions = DELAYS
        expect(decision(page)).to_have_text(UNKNOWN)
        answers = page.evaluate("() => window.__answers")
        until(page, lambda: page.evaluate("() => window.__answers") >= answers + 3)
        assert in_time(page)
        expect(decision(page)).to_have_text(UNKNOWN)
        link.conditions = NetworkConditions()
        expect(decision(page)).to_have_text(KNOWN)
        link.conditions = STALLS  # nothing comes, no close either
        expect(decision(page)).to_have_text(UNKNOWN)
        assert in_time(page)


@pytest.mark.long
def test_the_technicians_page_knows_nothing_when_the_web_process_has_died(
    bay: Plant, visit: Visit, watches: list[Watch]
) -> None:
    page = visit(f"{bay.url}/tune/bay1", before=OLDEST)
    expect(decision(page)).to_have_text(KNOWN)
    watches[0].excused = re.compile(
        f"{SERVER_GONE.pattern}|status of 40[34]"
    )  # the next one has its own tokens and trials
    bay.process("gw-hmi").kill()
    expect(decision(page)).to_have_text(UNKNOWN)
    assert in_time(page)
    expect(decision(page)).to_have_text(KNOWN)
