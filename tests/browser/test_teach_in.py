"""The teach-in on the technician's page: a truck that stands is measured, and what is saved makes D = 1 there."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from gateway import config
from tests.browser.chromium import PATIENCE_MS, Watch
from tests.browser.conftest import Visit
from tests.browser.plant import plant
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway

PATIENCE_S = PATIENCE_MS / 1000
# 36 cm: R is 150 px, and D is 0 by the thresholds of the file.
FARTHER = """
seed = 40
camera = { fps = 10 }
start = { distance_cm = 36, lateral_mm = 10 }
"""


@pytest.mark.long
@pytest.mark.timeout(300)  # a measurement that is refused is begun again
def test_a_truck_that_stands_is_measured_saved_and_in_place_from_then_on(
    visit: Visit, watches: list[Watch], tmp_path: Path
) -> None:
    with plant(tmp_path, FARTHER) as bay, Plc(bay.modbus_port) as plc:
        before = bay.config.read_text()
        plc.wait_for(lambda image: image["may_move"] == 1, PATIENCE_S)
        page = visit(f"{bay.url}/tune/bay1#teach-in")
        watches[0].excused = re.compile("status of 409")  # a refusal, see below
        panel = page.locator("#teach-in")
        panel.locator("select").select_option("20")
        values, measuring = panel.locator(".values tbody tr"), panel.locator("progress")
        begin, anew = (panel.get_by_role("button", name=name) for name in ("Measure this truck", "Begin again"))
        while values.count() == 0:  # a machine that stands still for seconds is refused, and rightly so: once more then
            if anew.is_visible():  # measured, but no values follow from it
                anew.click()
            with page.expect_response(lambda answer: answer.request.method == "POST") as begun:
                begin.click()
            if begun.value.ok:
                expect(measuring).to_be_visible()
                expect(measuring).to_have_count(0)
        expect(panel.locator(".spreads tbody tr").first.locator("td").first).to_have_text(re.compile(r"15\d\.\d"))
        expect(values).to_have_count(5)
        radius, distance, _, aim_v, _ = values.all()
        expect(radius).to_contain_text(re.compile(r"R_th.*180\.0.*1[45]\d\.\d", re.DOTALL))
        expect(distance).to_contain_text(re.compile(r"Z_th.*300.*3[78]\d", re.DOTALL))
        for curve in panel.locator("path.dots").all():
            assert len(re.findall("h0", curve.get_attribute("d") or "")) > 90
        expect(panel.locator("path.suggested")).to_have_count(2)

        aim_v.get_by_role("checkbox").uncheck()
        panel.get_by_role("button", name="Look at the change in the file…").click()
        dialog = page.get_by_role("dialog")
        expect(dialog.locator(".diff .added").filter(has_text="radius_threshold_px = 1")).to_have_count(1)
        expect(dialog).to_contain_text(re.compile(r"A restart of the gateway is needed for:.*radius_threshold_px: 180"))
        assert bay.config.read_text() == before  # shown, and not yet done
        dialog.get_by_role("button", name="Save").click()
        expect(dialog.locator("[data-saved]")).to_contain_text("take effect at the next start")
        page.close()  # before the gateway ends
        assert plc.last["stop"] == 0  # the thresholds of the start are in force until the next one
    saved = config.load(bay.config).bays[0]
    assert 145 < saved.fusion.radius_threshold_px < 151  # the paper's R is 1.5 px too large
    assert 370 < saved.fusion.distance_threshold_mm < 390
    assert saved.guidance.aim_u_px not in (None, 319.5)
    assert saved.guidance.aim_v_px == 239.5  # not ticked
    assert "# The bay of a test. This comment and the others must outlive" in bay.config.read_text()
    again = ("simulate", "--json", "--config", str(bay.config), "--scenario", str(tmp_path / "scenario.toml"))
    with Gateway(*again, "--modbus-port", "0", "--no-hmi") as gateway, Plc(gateway.started()["modbus_port"]) as plc:
        plc.wait_for(lambda image: image["stop"] == 1 and image["in_place"] == 1, PATIENCE_S)
