"""The driver's display without a gateway: its socket sends what the test wants, the worst included."""

import base64
import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from gateway.core.state import GuidanceCode
from gateway.web.languages import languages
from tests.browser import judgements
from tests.browser.alone import HOST, SOCKET, STATIC, from_disk, say
from tests.browser.chromium import Watch, until
from tests.long import mostly_long

GOOD: dict[str, Any] = {
    "bay": "bay1", "code": "FORWARD", "text": "", "stop": False,
    "amount_mm": 1250.0, "closing_mm_s": 120.0, "to_go_mm": 1250.0, "age_ms": 20.0,
}  # fmt: skip
LANGUAGES = mostly_long(sorted(languages({}).catalogues, key=lambda language: (language != "de", language)))
STYLE = STATIC / "driver.css"
FONTS = {"installed": None, "widest": "'DejaVu Sans'"}
SHOWN = """() => {
  const opacity = getComputedStyle(document.querySelector('#deadman')).opacity;
  return opacity === '0' ? document.body.dataset.code : opacity === '1' ? 'STOP over all' : `between: ${opacity}`;
}"""
Display = Callable[..., Page]


@pytest.fixture
def display(browser: Browser) -> Iterator[Display]:
    contexts = []
    watch = Watch(HOST)

    def opened(
        query: str = "?lang=en&theme=sun",
        width_px: int = 1366,
        height_px: int = 768,
        before: str = "",
        font: str | None = None,
    ) -> Page:
        """`font`: instead of the first of those named in the style that is installed."""
        context = browser.new_context(viewport={"width": width_px, "height": height_px})
        contexts.append(context)
        watch.over(context)
        context.add_init_script(SOCKET + before)
        context.route("**/*", from_disk)
        if font is not None:
            style = re.sub(r"font-family: [^;]+;", f"font-family: {font};", STYLE.read_text(encoding="utf-8"), count=1)
            context.route("**/driver.css", lambda route: route.fulfill(body=style, content_type="text/css"))
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
    waits = {**GOOD, "code": "WAIT", "stop": True, "closing_mm_s": 4.0}
    says(page, waits, "WAIT")
    expect(page.locator("#speed")).to_be_hidden()  # no "0 cm/s" of a truck that stands
    say(page, {**waits, "closing_mm_s": 120.0})
    expect(page.locator("#speed")).to_have_text("speed12cm/s")


def test_the_title_of_the_bay_stands_above_the_sign(display: Display) -> None:
    page = display()
    says(page, {**GOOD, "title": "Verladung 3 Süd"}, "FORWARD")
    expect(page.locator("#bay")).to_have_text("Verladung 3 Süd")
    expect(page).to_have_title("FORWARD · Verladung 3 Süd")
    name, sign = page.locator("#bay").bounding_box(), page.locator("#show").bounding_box()
    assert name is not None
    assert sign is not None
    assert 0 < name["height"] <= sign["y"]
    judgements.accessible(page)


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


@pytest.mark.mostly_long(short=3)
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


# Every eighth answer comes late. How long each STOP stood that came of it, ms.
UNSTEADY = """
let asked = 0;
window.__unsteady = false;
Object.defineProperty(window, '__delay_ms', { get: () => ((asked += 1) % 8 || !window.__unsteady ? 20 : 560) });
window.__stops = [];
let begun = null;
addEventListener('DOMContentLoaded', () => {
  new MutationObserver(() => {
    const stop = document.body.dataset.fresh === 'false';
    if (stop && begun === null) begun = performance.now();
    if (!stop && begun !== null) window.__stops.push(performance.now() - begun);
    if (!stop) begun = null;
  }).observe(document.body, { attributeFilter: ['data-fresh'] });
});
"""


def test_a_display_on_the_edge_of_stale_data_does_not_flash(display: Display) -> None:
    """STOP for want of data is held until data has come without a break for a second."""
    page = display(before=UNSTEADY)
    says(page, GOOD, "FORWARD")
    page.evaluate("() => { window.__stops = []; window.__unsteady = true; }")
    until_shown(page, "STOP over all")
    page.wait_for_timeout(3000)
    page.evaluate("() => { window.__unsteady = false; }")
    until_shown(page, "FORWARD")
    stops_ms = page.evaluate("() => window.__stops")
    assert min(stops_ms) >= 1000
    says(page, {**GOOD, "code": "STOP", "stop": True}, "STOP")
    says(page, GOOD, "FORWARD")  # a STOP by the decision is not held


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


# Of the words and numbers what is drawn outside its room, and which of them are drawn one over the other.
MISPLACED = """() => {
  const shown = (at) => at.checkVisibility() && at.textContent !== '';
  const aside = document.querySelector('#column').getBoundingClientRect();
  const rtl = document.documentElement.dir === 'rtl';
  const [left, right] = rtl ? [aside.right, innerWidth] : [0, aside.left];
  const texts = [...document.querySelectorAll('#word, #show dd, #show dt')].filter(shown).map((at) => {
    const drawn = document.createRange();
    drawn.selectNodeContents(at);
    const { left, right } = drawn.getBoundingClientRect();
    const { top, bottom, height } = at.getBoundingClientRect();
    return { name: at.textContent, left, right, top: top + height / 6, bottom: bottom - height / 6 };
  });
  const symbol = { ...document.querySelector('#symbol').getBoundingClientRect().toJSON(), name: 'symbol' };
  const out = [...texts, symbol, { ...aside.toJSON(), name: 'column', left, right }]
    .filter((at) => at.left < left - 1 || at.right > right + 1 || at.top < -1 || at.bottom > innerHeight + 1);
  const over = texts.filter((one, n) => texts.slice(n + 1).some((other) =>
    one.left < other.right && other.left < one.right && one.top < other.bottom && other.top < one.bottom));
  return [...out, ...over].map((at) => at.name);
}"""


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_word_fits_and_is_large(display: Display, language: str) -> None:
    page = display(f"?lang={language}&theme=night", font=FONTS["widest"])
    expect(page.locator("html")).to_have_attribute("lang", language)
    for width_px, height_px in ((360, 640), (768, 1024), (1024, 768), (1366, 768), (3840, 2160)):
        page.set_viewport_size({"width": width_px, "height": height_px})
        for code in GuidanceCode:
            drives = code.name in ("FORWARD", "SLOW", "LEFT", "RIGHT", "LEAVE", "DRIVE_UP")
            to_go_mm = -1234.0 if code.name == "BACK" else 987.0
            speed = -120.0 if code.name == "FAULT" else 120.0
            say(page, {**GOOD, "code": code.name, "stop": not drives, "to_go_mm": to_go_mm, "closing_mm_s": speed})
            until_shown(page, code.name)
            assert page.evaluate(MISPLACED) == [], f"{code.name} in {language} at {width_px} x {height_px}"
            assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
        size = page.locator("#word").evaluate("(word) => parseFloat(getComputedStyle(word).fontSize)")
        assert size > 0.09 * min(width_px, height_px)
        assert page.locator("#word").evaluate("(word) => word.scrollWidth <= word.clientWidth + 1")


SCREENS = {
    "15 inch, 16:9": (1366, 768, 332.1),
    "15 inch, 4:3": (1024, 768, 304.8),
    "24 inch, 16:9": (1920, 1080, 531.3),
}
DIGITS_MM = 46.5  # 16 minutes of arc at 10 m: the smallest character height of ISO 9241-303
LABEL_MM = 29.1  # 10 minutes of arc at 10 m: twice what an eye with a visual acuity of 0.5 resolves
# The inked height of the digits and of their label, and whatever of them does not have the room it needs.
INKED = """() => {
  const at = document.querySelector('#amount');
  const room = at.getBoundingClientRect();
  const word = document.querySelector('#word').getBoundingClientRect();
  const ruler = document.createElement('canvas').getContext('2d');
  const ink = (one, text) => {
    const look = getComputedStyle(one);
    ruler.font = `${look.fontWeight} ${look.fontSize} ${look.fontFamily}`;
    const capitals = look.textTransform === 'uppercase';
    const box = ruler.measureText(capitals ? text.toLocaleUpperCase(document.documentElement.lang) : text);
    return { above: box.actualBoundingBoxAscent, below: Math.max(0, box.actualBoundingBoxDescent) };
  };
  const [digits, label] = [at.querySelector('dd'), at.querySelector('dt')];
  const parts = [digits, label].filter((one) => one.textContent !== '');
  const wide = parts.filter((one) => {
    const box = document.createRange();
    box.selectNodeContents(one);
    const { left, right } = box.getBoundingClientRect();
    return left < room.left - 1 || right > room.right + 1;
  });
  const low = parts.filter((one) => {
    const { top, bottom } = one.getBoundingClientRect();
    return bottom > word.top + 0.1 * word.height || top < -1;
  });
  const name = ink(label, label.textContent);
  return {
    digits_px: ink(digits.querySelector('b'), '8').above,
    label_px: label.textContent === '' ? null : name.above + name.below,
    out: [...wide, ...low].map((one) => one.textContent),
  };
}"""


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("font", mostly_long(FONTS))
def test_the_distance_can_be_read_at_10_m(display: Display, language: str, font: str) -> None:
    for units, amounts_mm in (("metric", (2880.0, 880.0)), ("imperial", (3480.0, 888.0))):
        page = display(f"?lang={language}&theme=sun&units={units}&kiosk=1", font=FONTS[font])
        expect(page.locator("html")).to_have_attribute("lang", language)
        for width_px, height_px, width_mm in SCREENS.values():
            page.set_viewport_size({"width": width_px, "height": height_px})
            for code in ("FORWARD", "SLOW", "LEFT", "RIGHT", "BACK", "TOO_FAR"):
                for amount_mm in amounts_mm:
                    says(
                        page, {**GOOD, "code": code, "stop": code in ("BACK", "TOO_FAR"), "amount_mm": amount_mm}, code
                    )
                    seen = page.evaluate(INKED)
                    assert seen["out"] == [], (code, units, width_px)
                    assert seen["digits_px"] * width_mm / width_px >= DIGITS_MM, (code, units, seen)
                    if seen["label_px"] is not None:
                        assert seen["label_px"] * width_mm / width_px >= LABEL_MM, (code, units, seen)
        page.context.close()


@pytest.mark.long
@pytest.mark.parametrize("language", LANGUAGES)
def test_it_is_accessible_in_every_language(display: Display, language: str) -> None:
    for theme in ("sun", "night"):
        page = display(f"?lang={language}&theme={theme}")
        expect(page.locator("html")).to_have_attribute("lang", language)
        judgements.accessible(page)  # STOP over all
        for code in ("FORWARD", "SLOW", "STOP", "FAULT", "WAIT", "OK"):  # each kind of ground
            drives = code in ("FORWARD", "SLOW")
            says(page, {**GOOD, "code": code, "stop": not drives}, code)
            judgements.accessible(page)
        page.locator("#language").click()
        judgements.accessible(page)
        page.context.close()


# U+0378 is no character and never will be: what is drawn for it is drawn for every character that no font has.
MISSING = """(text) => {
  const look = getComputedStyle(document.querySelector('#word'));
  const canvas = document.createElement('canvas');
  Object.assign(canvas, { width: 80, height: 80 });
  const g = canvas.getContext('2d', { willReadFrequently: true });
  const drawn = (one) => {
    g.clearRect(0, 0, 80, 80);
    g.font = `${look.fontWeight} 48px ${look.fontFamily}`;
    g.fillText(one, 8, 60);
    return g.getImageData(0, 0, 80, 80).data.join();
  };
  const none = drawn('\u0378');
  return [...new Set(text)].filter((one) => one.trim() !== '' && drawn(one) === none);
}"""


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_letter_is_an_empty_box(display: Display, language: str) -> None:
    """It is where no font of this machine has the letter: `./dev test` and the recipe of the manual install some."""
    texts = languages({}).catalogues[language].texts
    page = display(f"?lang={language}&theme=sun")
    expect(page.locator("html")).to_have_attribute("lang", language)
    assert page.evaluate(MISSING, "\u0378") != []
    every = "".join(str(text) for key, text in texts.items() if key.startswith("driver|"))
    assert page.evaluate(MISSING, every + every.upper()) == []


ON_THE_WORD = """() => {
  const word = [...document.querySelectorAll('#word, #amount dd, #speed dd, #deadman p')]
    .map((at) => at.getBoundingClientRect());
  const across = (at, one) => at.left < one.right && at.right > one.left;
  const over = (at, one) => across(at, one) && at.top < one.bottom - one.height / 10 && at.bottom > one.top;
  return [...document.querySelectorAll('#tools > button')].map((button) => button.getBoundingClientRect())
    .filter((at) => at.height > 0 && word.some((one) => over(at, one))).length;
}"""


@pytest.mark.parametrize(
    ("width_px", "height_px"),
    mostly_long([(568, 320), (1366, 768), (740, 360), (390, 844), (768, 1024), (960, 540), (1920, 1080)], short=2),
)
def test_the_buttons_lie_on_no_word(display: Display, width_px: int, height_px: int) -> None:
    """They are shown for some seconds after a touch, just when a driver looks."""
    page = display("?lang=de", width_px, height_px)
    for code in ("FORWARD", "STOP"):
        says(page, {**GOOD, "code": code, "stop": code == "STOP"}, code)
        page.mouse.move(5, 5)
        expect(page.locator("body")).not_to_have_class("idle")
        assert page.evaluate(ON_THE_WORD) == 0, code
    expect(page.locator("body")).to_have_class("idle")  # and then the sign has all of the screen again
    assert page.locator("#show").evaluate("(show) => show.getBoundingClientRect().height") == height_px


WAKE = """
window.__awake = 0;
Object.defineProperty(navigator, 'wakeLock', { value: { request: async () => { window.__awake += 1; } } });
const timed = window.setInterval;
window.setInterval = (call, ms) => timed(call, Math.min(ms, 300));
"""


def test_a_kiosk_has_no_buttons_hides_the_pointer_stays_awake_and_follows_an_update(display: Display) -> None:
    page = display("?lang=en&kiosk=1", before=WAKE)
    says(page, GOOD, "FORWARD")
    expect(page.locator("#tools")).to_be_hidden()
    assert page.evaluate("() => window.__awake") == 1
    page.evaluate("() => document.dispatchEvent(new Event('visibilitychange'))")
    assert page.evaluate("() => window.__awake") == 2  # a browser gives it up when a page is hidden
    expect(page.locator("body")).to_have_class("idle")
    expect(page.locator("body")).to_have_css("cursor", "none")
    page.route("**/api/pages", lambda route: route.fulfill(status=204))
    page.evaluate("() => { window.__loaded_once = true; }")
    page.wait_for_timeout(700)
    assert page.evaluate("() => window.__loaded_once")  # no answer: nothing is given up
    with page.expect_navigation():
        page.route("**/api/pages", lambda route: route.fulfill(json={"digest": "1"}))
    says(page, GOOD, "FORWARD")


def test_the_language_is_chosen_at_the_display_or_by_the_recipe_whichever_was_newest(display: Display) -> None:
    page = display()
    says(page, GOOD, "FORWARD")
    page.locator("#language").click()
    page.get_by_role("button", name="Türkçe", exact=True).click()
    expect(page.locator("#word")).to_have_text("İLERİ")
    says(page, {**GOOD, "language": "ar"}, "FORWARD")
    expect(page.locator("#word")).to_have_text("تقدّم")
    expect(page.locator("html")).to_have_attribute("dir", "rtl")
    page.locator("#language").click()
    page.get_by_role("button", name="Polski", exact=True).click()
    expect(page.locator("#word")).to_have_text("NAPRZÓD")
    says(page, {**GOOD, "language": None}, "FORWARD")
    expect(page.locator("#word")).to_have_text("NAPRZÓD")
    says(page, {**GOOD, "language": "xx"}, "FORWARD")
    page.wait_for_timeout(300)
    assert shows(page) == "FORWARD"
    page.reload()
    says(page, GOOD, "FORWARD")
    expect(page.locator("#word")).to_have_text("FORWARD")  # ?lang= of the address precedes what was chosen


def test_of_two_languages_the_one_that_was_wished_last_stays(display: Display) -> None:
    """Whichever of their files arrives first."""
    page = display()
    held: list[Route] = []
    page.route("**/api/languages/tr", lambda route: held.append(route))  # noqa: PLW0108
    says(page, GOOD, "FORWARD")
    page.locator("#language").click()
    page.get_by_role("button", name="Türkçe", exact=True).click()
    until(page, lambda: held)
    page.locator("#language").click()
    page.get_by_role("button", name="Polski", exact=True).click()
    expect(page.locator("#word")).to_have_text("NAPRZÓD")
    from_disk(held[0])
    page.wait_for_timeout(300)
    expect(page.locator("#word")).to_have_text("NAPRZÓD")
    expect(page.locator("html")).to_have_attribute("lang", "pl")


@pytest.mark.long
def test_a_language_that_could_not_be_had_is_requested_again(display: Display) -> None:
    page = display()
    says(page, GOOD, "FORWARD")
    failed: list[str] = []

    def nothing(route: Route) -> None:
        failed.append(route.request.url)
        route.fulfill(body="cut off")

    page.route("**/api/languages/ar", nothing)
    says(page, {**GOOD, "language": "ar"}, "FORWARD")
    until(page, lambda: failed)
    page.unroute("**/api/languages/ar")
    expect(page.locator("#word")).to_have_text("FORWARD")
    expect(page.locator("#word")).to_have_text("تقدّم")
    assert len(failed) == 1  # it does not ask ten times a second


@pytest.mark.long
def test_feet_sound_and_the_light_sensor(display: Display) -> None:
    page = display(
        "?lang=en",
        before="""
        window.__tones = 0;
        const start = OscillatorNode.prototype.start;
        OscillatorNode.prototype.start = function (...all) { window.__tones += 1; return start.apply(this, all); };
        window.AmbientLightSensor = class extends EventTarget {
          start() { window.__light = this; }
          stop() {}
        };
        window.__lux = (lux) => {
          window.__light.illuminance = lux;
          window.__light.dispatchEvent(new Event('reading'));
        };
        """,
    )
    says(page, GOOD, "FORWARD")
    assert page.evaluate("() => window.__tones") == 0  # off unless somebody wants it
    page.get_by_role("button", name="m / ft").click()
    expect(page.locator("#amount dd")).to_have_text("4.2ft")
    page.get_by_role("button", name="Turn sound on").click()
    says(page, {**GOOD, "code": "SLOW"}, "SLOW")
    until(page, lambda: page.evaluate("() => window.__tones") > 2)
    off = page.get_by_role("button", name="Turn sound off")  # the button says what it does, in every language
    expect(off).to_be_visible()
    assert off.get_attribute("aria-pressed") is None
    for lux, theme in ((3, "night"), (40, "night"), (800, "sun"), (40, "sun")):
        page.evaluate("(lux) => window.__lux(lux)", lux)
        expect(page.locator("html")).to_have_attribute("data-theme", theme)


def test_sounds_that_the_browser_blocks_do_not_pile_up(display: Display) -> None:
    """Wanted by the address, and nobody has touched the screen yet."""
    page = display(
        "?lang=en&sound=on",
        before="""
        window.__tones = 0;
        const start = OscillatorNode.prototype.start;
        OscillatorNode.prototype.start = function (...all) { window.__tones += 1; return start.apply(this, all); };
        const resume = AudioContext.prototype.resume;
        window.__blocked = true;
        AudioContext.prototype.resume = function () { return window.__blocked ? this.suspend() : resume.call(this); };
        """,
    )
    for code in ("SLOW", "FORWARD", "SLOW", "FORWARD"):
        says(page, {**GOOD, "code": code}, code)
    assert page.evaluate("() => window.__tones") == 0
    page.evaluate("() => { window.__blocked = false; }")
    page.get_by_role("button", name="Turn sound on").click()
    expect(page.get_by_role("button", name="Turn sound off")).to_be_visible()
    until(page, lambda: page.evaluate("() => window.__tones") == 1)  # FORWARD, as it is now


GROUND = "() => getComputedStyle(document.querySelector('#show')).backgroundColor"
RED, WHITE = "rgb(176, 0, 0)", "rgb(255, 255, 255)"


def test_brake_flashes_red_and_white_and_is_framed_where_motion_is_not_wanted(display: Display) -> None:
    page = display()
    brake = GOOD | {"code": "BRAKE", "stop": True, "amount_mm": None, "closing_mm_s": 20.0}
    says(page, brake, "BRAKE")
    flash = "() => document.querySelector('#show').getAnimations()[0]"
    assert page.evaluate(f"() => ({flash})().effect.getTiming().duration") == 500  # ms: 2 Hz
    grounds = []
    for at_ms in (100, 400):
        page.evaluate(f"() => {{ const one = ({flash})(); one.pause(); one.currentTime = {at_ms}; }}")
        grounds.append(page.evaluate(GROUND))
        says(page, brake, "BRAKE")
    assert grounds == [RED, WHITE]
    says(page, GOOD | {"code": "STOP", "stop": True}, "STOP")
    assert page.evaluate("() => document.querySelector('#show').getAnimations().length") == 0
    page.emulate_media(reduced_motion="reduce")
    says(page, brake, "BRAKE")
    assert page.evaluate("() => document.querySelector('#show').getAnimations().length") == 0
    assert page.evaluate("() => getComputedStyle(document.querySelector('#show')).boxShadow").startswith(WHITE)
