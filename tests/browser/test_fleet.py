"""The fleet page: what needs a look, found among many bays, and what is known of one."""

import json
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import expect

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
    """A status of each gateway; bay-7 of the south has failed, and nobody has reviewed the configuration of bay-3."""
    for n in range(BAYS):
        site, name = ("north", "south")[n % 2], f"bay-{n}"
        given = json.loads(status(t_ms))
        (bay,) = given["health"]
        bay |= {"bay": name, "title": f"Loading {n}", "ne107": {"name": "FAILURE" if n == 7 else "GOOD"}}
        if n == 3:
            given["gateway"]["configuration"] = {"in_force": "b" * 64, "reviewed": "a" * 64, "as_reviewed": False}
        message = json.dumps(given | {"site": site, "instance": name})
        to = ["-h", broker.host, "-p", str(broker.port), "-q", "1", "-r", "-t", f"loading/{site}/{name}/status"]
        subprocess.run([program("mosquitto_pub"), *to, "-m", message], check=True)


def test_what_needs_a_look_is_found_among_many(
    broker: Mosquitto, tmp_path: Path, visit: Visit, started: ExitStack
) -> None:
    fleet = started.enter_context(Fleet(tmp_path, broker.url, silent_s=600))
    for t_ms in (1, 2):
        publish(broker, t_ms)
    page = visit(f"{fleet.url}/")
    counted = page.get_by_role("status")
    expect(counted).to_have_text(f"2 of {BAYS} bays need a look; {BAYS} shown")
    expect(page.get_by_text("This page can't change anything at a bay.")).to_be_visible()
    judgements.accessible(page)
    page.get_by_label("only what needs a look").check()
    expect(counted).to_have_text(f"2 of {BAYS} bays need a look; 2 shown")
    failed = page.get_by_role("row", name="bay-7")
    expect(failed).to_contain_text("failure")
    page.get_by_label("only what needs a look").uncheck()
    page.get_by_label("search").fill("south bay-3 ")
    expect(page.get_by_role("row", name="bay-3 Loading 3 ")).to_contain_text("configuration is not the reviewed one")
    page.get_by_role("button", name="bay-3", exact=True).click()
    detail = page.get_by_role("complementary", name="gateway")
    expect(detail).to_contain_text("b" * 16)
    judgements.no_sideways_scroll(page)
    broker.kill()
    expect(page.get_by_role("alert")).to_contain_text("No connection to the broker.")
