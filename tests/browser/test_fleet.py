"""The fleet page: what needs a look, found among many bays, and what is known of one."""

import json
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import expect

from gateway.fleet.sqlite_store import SqliteStore
from gateway.fleet.store import News
from gateway.fleet.trends import PERIOD_MS, Sample
from tests.browser import judgements
from tests.browser.conftest import Visit
from tests.e2e.brokers import Mosquitto, program
from tests.e2e.fleet_process import Fleet
from tests.unit.fleet.test_roster import status

BAYS = 40


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path) as running:
        yield running


def publish(broker: Mosquitto, t_ms: int) -> None:
    """A status of each gateway; bay-7 of the south has failed, nobody has reviewed the configuration of bay-3, and
    bay-39 was heard once."""
    for n in range(BAYS if t_ms == 1 else BAYS - 1):
        site, name = ("north", "south")[n % 2], f"bay-{n}"
        given = json.loads(status(t_ms))
        (bay,) = given["health"]
        bay |= {"bay": name, "title": f"Loading {n}", "ne107": {"name": "FAILURE" if n == 7 else "GOOD"}}
        if n == 3:
            given["gateway"]["configuration"] = {"in_force": "b" * 64, "reviewed": "a" * 64, "as_reviewed": False}
        message = json.dumps(given | {"site": site, "instance": name})
        to = ["-h", broker.host, "-p", str(broker.port), "-q", "1", "-r", "-t", f"loading/{site}/{name}/status"]
        subprocess.run([program("mosquitto_pub"), *to, "-m", message], check=True)


def past_days(database: Path) -> None:
    """There was much dust in bay-3 ten days ago."""
    store = SqliteStore(database)
    period = time.time_ns() // 1_000_000 // PERIOD_MS - 60
    store._keep(News(samples=[Sample(("south", "bay-3"), "bay-3", period, 0.4)]))
    store.close()


def test_what_needs_a_look_is_found_among_many(
    broker: Mosquitto, tmp_path: Path, visit: Visit, started: ExitStack
) -> None:
    past_days(tmp_path / "fleet.sqlite")
    fleet = started.enter_context(Fleet(tmp_path, broker.url, silent_s=600))
    fleet.until(lambda _: fleet.get("/api/fleet")["connected"])
    for t_ms in (1, 2):
        publish(broker, t_ms)
    page = visit(f"{fleet.url}/")
    counted = page.get_by_role("status")
    expect(counted).to_have_text(f"3 of {BAYS} bays need a look; {BAYS} shown")
    expect(page.get_by_text("This page can't change anything at a bay.")).to_be_visible()
    expect(page.locator("tbody").nth(1).get_by_role("row").first).to_contain_text("bay-39")
    expect(page.get_by_role("row", name="bay-39")).to_contain_text("silent")
    expect(page.get_by_role("row", name="bay-5 ").get_by_role("link")).to_have_attribute("href", "https://bay-1/#bay-5")
    judgements.accessible(page)
    page.get_by_label("only what needs a look").check()
    expect(counted).to_have_text(f"3 of {BAYS} bays need a look; 3 shown")
    failed = page.get_by_role("row", name="bay-7")
    expect(failed).to_contain_text("failure")
    page.get_by_label("only what needs a look").uncheck()
    page.get_by_label("search").fill("south bay-3 ")
    expect(page.get_by_role("row", name="bay-3 Loading 3 ")).to_contain_text("configuration is not the reviewed one")
    page.get_by_role("button", name="bay-3", exact=True).click()
    detail = page.get_by_role("complementary", name="gateway")
    expect(detail).to_contain_text("b" * 16)
    expect(detail.get_by_role("img", name="10 days ago: 40")).to_be_visible()
    line = detail.locator("polyline").first.get_attribute("points")
    assert line is not None
    assert [float(point.split(",")[1]) for point in line.split()] == [18.8, 27.2], "from 40 % of dust to 10 %"
    judgements.accessible(page)
    judgements.no_sideways_scroll(page)
    broker.kill()
    expect(page.get_by_role("alert")).to_contain_text("No connection to the broker.")
