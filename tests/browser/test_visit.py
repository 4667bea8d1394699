"""What the pages say in a truck's visit, from a simulated bay: far out, in place and rolling, on its way out."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.browser.conftest import Visit
from tests.browser.plant import Plant, plant
from tests.long import mostly_long

# It creeps nearer, within its band, and back, without an end: nearer is an alarm, whether or not a PLC writes.
CREEPING = """
seed = 5
repeat = true
camera = { fps = 10 }
start = { distance_cm = 28 }
legs = [
  { distance_cm = 25, speed_cm_s = 5, hold_s = 6 },
  { distance_cm = 28, speed_cm_s = 5, hold_s = 6 },
]
"""
FAR_OUT = """
seed = 6
camera = { fps = 10 }
start = { distance_cm = 490 }
"""
# In place, then loaded with the marker covered, then backing off; without an end.
LOADED = """
seed = 7
repeat = true
camera = { fps = 10 }
start = { distance_cm = 200 }
legs = [
  { distance_cm = 28, speed_cm_s = 40, hold_s = 14 },
  { distance_cm = 200, speed_cm_s = 20, hold_s = 4 },
]
faults = [{ kind = "marker_hidden", at_s = 8, for_s = 8 }]
"""
PAGES = (
    "/",
    "/#bay1",
    "/history#bay1",
    "/manager?bay=bay1",
    "/tune/bay1",
    "/setup",
    "/setup/new-bay",
    "/calibrate/bay1",
)


@pytest.fixture(scope="module")
def rolls(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("rolls"), CREEPING, bays=2, records=lambda _: None) as running:
        yield running


@pytest.fixture
def truck(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Plant]:
    with plant(tmp_path, request.param) as running:
        yield running


@pytest.mark.parametrize("path", mostly_long(PAGES))
def test_every_page_shows_the_alarm_of_a_truck_that_rolls(rolls: Plant, visit: Visit, path: str) -> None:
    bar = visit(rolls.url + path).locator(".alarmbar")
    expect(bar).to_contain_text("Truck rolls while in place", timeout=40_000)


def test_the_driver_is_told_to_brake(rolls: Plant, visit: Visit) -> None:
    page = visit(rolls.url + "/driver/bay1?lang=en")
    expect(page.locator("#word")).to_have_text("BRAKE", timeout=60_000)


@pytest.mark.long
@pytest.mark.parametrize(("truck", "word"), [(FAR_OUT, "DRIVE UP"), (LOADED, "LEAVE")], indirect=["truck"])
def test_the_driver_is_told_to_come_or_to_leave(truck: Plant, visit: Visit, word: str) -> None:
    page = visit(truck.url + "/driver/bay1?lang=en")
    expect(page.locator("#word")).to_have_text(word, timeout=60_000)
