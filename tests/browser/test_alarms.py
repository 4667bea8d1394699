"""A bay whose camera is gone: the alarm is acknowledged, and stop is on all the same; the registers are the PLC's."""

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from gateway.core.state import Reason
from gateway.modbus.registers.register_map import REGISTERS
from tests.browser import judgements
from tests.browser.chromium import PATIENCE_MS, until
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, Plant, plant
from tests.e2e.plc import Plc

CAMERA_GONE = STANDING + 'faults = [{ kind = "camera_lost", at_s = 1, for_s = 3600 }]\n'
LASTING = ("map_version", "stop", "may_move", "reason", "vision_quality")


@pytest.fixture(scope="module")
def bay(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant"), CAMERA_GONE) as running:
        yield running


@pytest.fixture(scope="module")
def plc(bay: Plant) -> Iterator[Plc]:
    with Plc(bay.modbus_port) as polling:
        polling.wait_for(lambda image: image["reason"] == Reason.CAMERA_DOWN, PATIENCE_MS / 1000)
        yield polling


@pytest.fixture
def page(bay: Plant, plc: Plc, visit: Visit) -> Page:
    return visit(f"{bay.url}/#bay1")


def test_acknowledging_ends_no_stop(page: Page, plc: Plc) -> None:
    alarm = page.locator(".alarms li").filter(has_text="Camera down").first
    expect(alarm).to_contain_text("active, not acknowledged")
    judgements.accessible(page)  # in trouble, too
    button = alarm.get_by_role("button", name=re.compile("Acknowledge"))
    button.focus()
    begun = len(plc.polls)
    page.keyboard.press("Enter")
    expect(alarm).to_contain_text("active, acknowledged")
    expect(button).to_have_count(0)
    expect(page.locator(".decision .word")).to_have_text("STOP")
    plc.wait_for(lambda _: len(plc.polls) > begun + 50)
    assert {poll.image["stop"] for poll in plc.polls[begun:]} == {1}
    assert {poll.image["may_move"] for poll in plc.polls[begun:]} == {0}


def test_the_registers_are_those_that_the_plc_reads(page: Page, plc: Plc) -> None:
    page.get_by_text("Registers as the PLC reads them").click()
    rows = page.locator(".registers tbody tr")
    expect(rows).to_have_count(len(REGISTERS))

    def by_name() -> dict[str, list[str]]:
        shown = [row.split("\t") for row in rows.all_inner_texts()]
        assert [int(cells[0]) for cells in shown] == [register.address for register in REGISTERS]
        return {cells[1].split()[0]: cells for cells in shown}

    # For a moment a busy machine's page may know nothing: then it shows nothing.
    until(page, lambda: all(by_name()[name][4] != "–" for name in LASTING))
    now = by_name()
    for name in LASTING:
        assert int(now[name][4], 16) == plc.last[name], now[name]
    assert now["radius"][2] == "no value"
