"""What holds for every page: it loads without a fault, asks nobody else, is accessible, and fits into any width."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.browser import judgements
from tests.browser.chromium import until, visited
from tests.browser.plant import Plant, plant

# A telephone, a tablet, an old panel PC, a desk, a wall.
WIDTHS_PX = (360, 768, 1366, 1920, 3840)
# Address, and what stands there when the page has its data.
PAGES = {
    "all bays": ("/", "() => document.querySelectorAll('main a, main button').length > 2"),
    "one bay": ("/#bay1", "() => document.querySelector('.picture .tag')?.textContent === 'LIVE'"),
    "technician": ("/tune/bay1", "() => document.querySelector('[data-panel=mask] img')?.complete"),
    "history": ("/history", "() => document.querySelector('#empty-title') !== null"),
    "driver": ("/driver/bay1", "() => document.body.dataset.fresh === 'true'"),
    "login": ("/login", "() => document.activeElement?.id === 'name'"),
}


@pytest.fixture(scope="module")
def bays(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant"), bays=2) as running:
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


def test_it_can_be_used_by_keyboard(page: Page) -> None:
    judgements.usable_by_keyboard(page)


def test_it_fits_into_every_width(page: Page) -> None:
    for width_px in WIDTHS_PX:
        page.set_viewport_size({"width": width_px, "height": 900})
        page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        judgements.no_sideways_scroll(page)
