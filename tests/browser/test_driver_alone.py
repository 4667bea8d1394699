"""The driver's display without a gateway: its socket sends what the test wants, the worst included."""

import base64
import json
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from gateway.core.state import GuidanceCode
from tests.browser.alone import HOST, SOCKET, from_disk, say
from tests.browser.chromium import Watch, until

GOOD: dict[str, Any] = {
    "bay": "bay1", "code": "FORWARD", "text": "", "stop": False,
    "amount_mm": 1250.0, "closing_mm_s": 120.0, "to_go_mm": 1250.0, "age_ms": 20.0,
}  # fmt: skip
SHOWN = """() => {
  const opacity = getComputedStyle(document.querySelector('#deadman')).opacity;
  return opacity === '0' ? document.body.dataset.code : opacity === '1' ? 'STOP over all' : `between: ${opacity}`;
}"""
Display = Callable[..., Page]


@pytest.fixture
def display(browser: Browser) -> Iterator[Display]:
    contexts = []
    watch = Watch(HOST)

    def opened(query: str = "?lang=en&theme=sun", width_px: int = 1366, height_px: int = 768, before: str = "") -> Page:
        context = browser.new_context(viewport={"width": width_px, "height": height_px})
        contexts.append(context)
        watch.over(context)
        context.add_init_script(SOCKET + before)
        context.route("**/*", from_disk)
        page = context.new_page()
        page.goto(f"http://{HOST}/driver/bay1{query}")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert watch.complaints == []


def shows(page: Page) -> str:
    shown: str = page.evaluate(SHOWN)
    return shown


def until_shown(page: Page, wanted: str) -> None:
    until(page, lambda: shows(page) == wanted)


def says(page: Page, what: object, shown: str) -> None:
    """The socket answers so, and the display shows it."""
    say(page, what)
    until_shown(page, shown)


def test_it_begins_with_stop_and_asks_for_its_bay(display: Display) -> None:
    page = display()
    assert shows(page) == "STOP over all"
    expect(page).to_have_title("STOP")
    until(page, lambda: page.evaluate("() => window.__asked").endswith("/api/driver?bay=bay1"))
    says(page, GOOD, "FORWARD")
    expect(page).to_have_title("FORWARD")
    expect(page.locator("#amount")).to_have_text("to go1.25m")
    expect(page.locator("#speed")).to_have_text("speed12cm/s")
    say(page, {**GOOD, "closing_mm_s": -300.0})
    expect(page.locator("#speed")).to_have_text("backing off30cm/s")


def test_a_truck_in_place_may_read_so_under_stop_and_leaves_when_it_is_released(display: Display) -> None:
    page = display()
    says(page, {**GOOD, "code": "OK", "stop": True, "closing_mm_s": 0.0, "to_go_mm": None}, "OK")
    expect(page.locator("#word")).to_have_text("OK")
    expect(page.locator("#column")).to_be_hidden()
    says(page, {**GOOD, "code": "LEAVE", "closing_mm_s": -200.0, "amount_mm": None}, "LEAVE")
    expect(page.locator("#word")).to_have_text("LEAVE")
    expect(page.locator("#amount")).to_be_hidden()
    says(page, {**GOOD, "code": "DRIVE_UP", "amount_mm": None, "closing_mm_s": None, "to_go_mm": None}, "DRIVE_UP")
    expect(page.locator("#word")).to_have_text("DRIVE UP")


def test_without_scripts_it_is_stop(browser: Browser) -> None:
    context = browser.new_context(java_script_enabled=False)
    context.route("**/*", from_disk)
    page = context.new_page()
    page.goto(f"http://{HOST}/driver/bay1")
    over = page.locator("#deadman")
    expect(over).to_be_visible()
    expect(over).to_have_text("STOP")
    expect(over).to_have_css("opacity", "1")
    context.close()


@pytest.mark.parametrize(
    "bad",
    [
        "",
        "{",
        "null",
        {**GOOD, "age_ms": 501},
        {**GOOD, "age_ms": None},
        {**GOOD, "age_ms": -1},
        {**GOOD, "bay": "bay2"},
        {**GOOD, "code": "GO"},
        {**GOOD, "stop": True},
        {**GOOD, "code": "LEAVE", "stop": True},
        {**GOOD, "code": "DRIVE_UP", "stop": True},
        {**GOOD, "stop": None},
        {**GOOD, "to_go_mm": "near"},
        {key: value for key, value in GOOD.items() if key != "stop"},
    ],
    ids=lambda bad: json.dumps(bad) if isinstance(bad, str) else str({k: v for k, v in bad.items() if GOOD[k] != v}),
)
def test_what_makes_no_sense_is_stop(display: Display, bad: object) -> None:
    page = display()
    says(page, GOOD, "FORWARD")
    says(page, bad, "STOP over all")
    page.evaluate("() => { window.__shown = []; }")
    page.wait_for_timeout(400)
    assert page.evaluate("() => window.__shown.filter((shown) => shown.endsWith('true'))") == []
    says(page, GOOD, "FORWARD")


@pytest.mark.failure_mode("W5")
def test_silence_is_stop(display: Display) -> None:
    page = display()
    says(page, GOOD, "FORWARD")
    says(page, None, "STOP over all")
    says(page, GOOD, "FORWARD")


@pytest.mark.parametrize("broken", ["requestAnimationFrame", "setInterval"])
def test_each_watch_is_enough_alone(display: Display, broken: str) -> None:
    page = display(before=f"window.{broken} = () => 0;")
    says(page, GOOD, "FORWARD")
    say(page, None)
    until(page, lambda: page.evaluate("() => document.body.dataset.fresh") == "false")
    # Not only when the silent link is given up, seconds later.
    assert page.locator("#deadman .why").text_content() == "no data"
    expect(page).to_have_title("STOP")


def test_a_message_that_was_long_on_its_way_is_not_taken_for_a_new_one(display: Display) -> None:
    """It says that it is 20 ms old; but it was asked for long before it came."""
    page = display()
    page.evaluate("() => { window.__delay_ms = 900; }")
    page.wait_for_timeout(700)  # the first question has been open for longer than data may be old
    say(page, GOOD)
    page.wait_for_timeout(4000)
    assert page.evaluate("() => window.__shown.filter((shown) => shown.endsWith('true'))") == []
    assert shows(page) == "STOP over all"


@pytest.mark.parametrize("hours", [-1, 1])
def test_a_clock_that_is_set_is_stop_until_the_next_message(display: Display, hours: int) -> None:
    page = display()
    says(page, GOOD, "FORWARD")
    say(page, None)
    # The other clock stands still, so that no time passes that would make the data old.
    page.evaluate(
        """(ms) => {
          const [steady, wall] = [performance.now.bind(performance), Date.now];
          const still = steady();
          performance.now = () => still;
          Date.now = () => wall() + ms;
          window.__go_on = () => { performance.now = steady; };
        }""",
        hours * 3_600_000,
    )
    until(page, lambda: page.evaluate("() => document.body.dataset.fresh") == "false")
    page.evaluate("() => window.__go_on()")
    says(page, GOOD, "FORWARD")


def test_a_tab_in_front_again_is_stop_until_the_next_message(display: Display) -> None:
    page = display()
    says(page, GOOD, "FORWARD")
    page.evaluate("""() => {
      window.__says = null;
      window.__shown = [];
      document.dispatchEvent(new Event('visibilitychange'));
      window.__after = document.body.dataset.code;
    }""")
    assert page.evaluate("() => window.__after") == "STOP"
    says(page, GOOD, "FORWARD")


@pytest.mark.failure_mode("W5")
def test_a_script_that_hangs_is_stop(display: Display) -> None:
    """Nothing of the page runs; the browser's compositor alone brings the STOP. Seen in pictures taken meanwhile."""
    page = display(width_px=400, height_px=300)
    says(page, GOOD, "FORWARD")
    tool = page.context.new_cdp_session(page)
    seen: list[tuple[float, tuple[int, int, int]]] = []

    def taken(frame: dict[str, Any]) -> None:
        data = np.frombuffer(base64.b64decode(frame["data"]), np.uint8)
        picture = cv2.imdecode(data, cv2.IMREAD_COLOR)
        assert picture is not None
        blue, green, red = (int(value) for value in picture[5, 5])
        seen.append((frame["metadata"]["timestamp"], (red, green, blue)))
        tool.send("Page.screencastFrameAck", {"sessionId": frame["sessionId"]})

    def is_red() -> bool:
        red, green, blue = seen[-1][1]
        return red > 100 and green < 40 and blue < 40

    tool.on("Page.screencastFrame", taken)
    tool.send("Page.startScreencast", {"format": "png", "everyNthFrame": 1})
    until(page, lambda: bool(seen) and not is_red())
    page.evaluate("""() => setTimeout(() => {
      const end = performance.now() + 8000;
      while (performance.now() < end);
      window.__hung_until_s = Date.now() / 1000;
    }, 0)""")
    until(page, is_red)
    red_since_s = seen[-1][0]
    until(page, lambda: page.evaluate("() => window.__hung_until_s ?? null") is not None)
    assert red_since_s < page.evaluate("() => window.__hung_until_s")


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize(("width_px", "height_px"), [(360, 640), (768, 1024), (1366, 768), (3840, 2160)])
def test_every_word_fits_and_is_large(display: Display, language: str, width_px: int, height_px: int) -> None:
    page = display(f"?lang={language}&theme=night", width_px, height_px)
    expect(page.locator("html")).to_have_attribute("lang", language)
    for code in GuidanceCode:
        drives = code.name in ("FORWARD", "SLOW", "LEFT", "RIGHT", "LEAVE", "DRIVE_UP")
        say(
            page, {**GOOD, "code": code.name, "stop": not drives, "to_go_mm": -1234.0 if code.name == "BACK" else 987.0}
        )
        until_shown(page, code.name)
        out = page.evaluate("""() => ['#word', '#symbol', '#amount', '#speed', '#column'].filter((name) => {
          const at = document.querySelector(name);
          if (at.classList.contains('none')) return false;
          const box = at.getBoundingClientRect();
          const column = document.querySelector('#column').getBoundingClientRect().left;
          const right = name === '#column' ? innerWidth : column;
          return box.left < 0 || box.top < 0 || box.right > right + 1 || box.bottom > innerHeight + 1;
        })""")
        assert out == [], f"{code.name} in {language} at {width_px} x {height_px}"
    size = page.locator("#word").evaluate("(word) => parseFloat(getComputedStyle(word).fontSize)")
    assert size > 0.09 * min(width_px, height_px)
    assert page.locator("#word").evaluate("(word) => word.scrollWidth <= word.clientWidth + 1")
