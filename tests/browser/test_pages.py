"""What holds for every page: it loads without a fault, asks nobody else, is accessible, and fits into any width."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser import judgements
from tests.browser.chromium import until, visited
from tests.browser.conftest import Visit
from tests.browser.plant import Plant, plant
from tests.unit.web.history import recorded_in

# A telephone, a tablet, an old panel PC, a desk, a wall.
WIDTHS_PX = (360, 768, 1366, 1920, 3840)
# Address, and what stands there when the page has its data.
PAGES = {
    "all bays": ("/", "() => document.querySelectorAll('main a, main button').length > 2"),
    "one bay": ("/#bay1", "() => document.querySelector('.picture .tag:not(.bad)') !== null"),
    "technician": ("/tune/bay1", "() => document.querySelector('[data-panel=mask] img')?.complete"),
    "calibration": ("/calibrate/bay1", "() => document.querySelector('.board form') !== null"),
    "new bay": ("/setup/new-bay", "() => document.querySelector('#step-title, main .notice') !== null"),
    "settings": ("/setup#mqtt", "() => document.querySelector('.table button') !== null"),
    "every bay's fusion": ("/setup#fusion", "() => document.querySelectorAll('.key').length > 5"),
    "history": ("/history", "() => document.querySelector('#past-title, #empty-title') !== null"),
    "manager": (
        "/manager?bay=bay1&from=2026-11-23&to=2026-11-23",  # of which day something is recorded
        "() => document.querySelectorAll('.figure').length === 7",
    ),
    "driver": ("/driver/bay1", "() => document.body.dataset.fresh === 'true'"),
    "manual": ("/manual/technician#test-sets", "() => document.querySelector('.top nav') !== null"),
    "login": ("/login", "() => document.activeElement?.id === 'name'"),
}


def kept(folder: Path) -> None:
    recorded_in(folder / "bay1", visits=2)


@pytest.fixture(scope="module")
def bays(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant"), records=kept, bays=2) as running:
        yield running


@pytest.fixture(scope="module", params=PAGES)
def page(request: pytest.FixtureRequest, browser: Browser, bays: Plant) -> Iterator[Page]:
    path, ready = PAGES[request.param]
    with visited(browser, bays.url + path) as (opened, watch):
        until(opened, lambda: opened.evaluate(ready))
        yield opened
        assert watch.complaints == []
        assert watch.requests > 3  # it was looked at


def test_it_is_accessible(page: Page) -> None:
    judgements.accessible(page)


@pytest.mark.long
def test_it_is_accessible_in_the_dark(page: Page) -> None:
    page.emulate_media(color_scheme="dark")
    try:
        expect(page.locator("html")).to_have_attribute("data-theme", re.compile("dark|night"))
        judgements.accessible(page)
    finally:
        page.emulate_media(color_scheme="light")


def test_it_can_be_used_by_keyboard(page: Page) -> None:
    judgements.usable_by_keyboard(page)


@pytest.mark.long
def test_it_can_be_used_at_twice_the_size(page: Page) -> None:
    judgements.usable_when_zoomed(page)


@pytest.mark.long
def test_nothing_moves_where_motion_is_not_wanted(page: Page) -> None:
    judgements.still_where_motion_is_not_wanted(page)


def test_dialogs_and_menus_give_the_focus_back(bays: Plant, visit: Visit) -> None:
    """To the control that opened them, when they are left by Escape."""
    page = visit(f"{bays.url}/tune/bay1")
    for control, opened in (("#save", "dialog[aria-labelledby=save-title]"), (".viewing > button", "#viewing")):
        expect(page.locator(control)).to_be_enabled()
        page.locator(control).focus()
        page.keyboard.press("Enter")
        expect(page.locator(opened)).to_be_visible()
        page.keyboard.press("Escape")
        expect(page.locator(opened)).to_be_hidden()
        expect(page.locator(control)).to_be_focused()


SHIFTS = """
window.__shift = 0;
new PerformanceObserver((list) => {
  for (const entry of list.getEntries()) if (!entry.hadRecentInput) window.__shift += entry.value;
}).observe({ type: 'layout-shift', buffered: true });
"""


@pytest.mark.long
@pytest.mark.parametrize("name", ["technician", "one bay", "history"])
def test_the_layout_stays_where_it_is_while_the_first_answers_arrive(bays: Plant, visit: Visit, name: str) -> None:
    """0.1 is the most that is called good of the sum (Cumulative Layout Shift)."""
    path, ready = PAGES[name]
    page = visit(bays.url + path, before=SHIFTS)
    until(page, lambda: page.evaluate(ready))
    page.wait_for_timeout(1500)
    assert page.evaluate("() => window.__shift") < 0.1


def test_it_fits_into_every_width(page: Page) -> None:
    for width_px in WIDTHS_PX:
        page.set_viewport_size({"width": width_px, "height": 900})
        page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        judgements.no_sideways_scroll(page)
        judgements.no_word_is_cut(page)
