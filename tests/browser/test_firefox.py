"""The pages in a browser of another make: each has its data, no script fails, and the driver's display ends in STOP."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.browser.firefox import Firefox, firefox
from tests.browser.plant import Plant, plant
from tests.browser.test_pages import PAGES, kept

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def bays(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant"), records=kept, bays=2) as running:
        yield running


@pytest.fixture(scope="module")
def other() -> Iterator[Firefox]:
    with firefox() as running:
        yield running


@pytest.mark.parametrize("name", PAGES)
def test_a_page_works_in_firefox(bays: Plant, other: Firefox, name: str) -> None:
    path, ready = PAGES[name]
    other.size(1366, 768)
    other.open("about:blank")
    other.open(bays.url + path)
    other.until(ready)
    for width_px in (360, 1366):
        other.size(width_px, 768)
        assert other.evaluate("() => document.documentElement.scrollWidth <= innerWidth"), width_px
    assert other.complaints == []


def test_the_drivers_display_ends_in_stop_when_the_gateway_goes_away(tmp_path: Path, other: Firefox) -> None:
    with plant(tmp_path) as running:
        other.open(f"{running.url}/driver/bay1")
        other.until("() => document.body.dataset.fresh === 'true'")
    other.until("() => getComputedStyle(document.querySelector('#deadman')).opacity === '1'")
    assert other.evaluate("() => document.querySelector('#deadman .word').textContent") == "STOP"
