"""The place of the beacon's LED, by one click in the picture of the technician's page; and what the beacon proves."""

import re
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import expect

from gateway import config
from tests.browser.chromium import PATIENCE_MS
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, plant

BEACON = "\n[ranger.hcsr04]\nbeacon = true\nrelay = true\n\n[camera.beacon]\nu_px = 600\nv_px = 40\nradius_px = 8\n"


def test_one_click_on_the_led_sets_its_place_and_the_page_shows_what_it_proves(
    visit: Visit, tmp_path: Path, started: ExitStack
) -> None:
    bay = started.enter_context(plant(tmp_path, STANDING, more=BEACON))
    page = visit(f"{bay.url}/tune/bay1#camera")
    panel = page.locator("#camera .beacon")
    expect(panel).to_contain_text("PROVEN: the pictures are of the present.", timeout=PATIENCE_MS)
    expect(panel).to_contain_text("From the light to the state:")
    expect(panel).to_contain_text("u 600 v 40 r 8")
    look = panel.get_by_role("button", name="Look at the change in the file…")
    expect(look).to_be_disabled()

    page.get_by_label("is the beacon's LED").check()
    page.get_by_label("patch").select_option("15")
    shot = page.locator("canvas.shot")
    room = shot.bounding_box()
    assert room is not None
    scale = room["width"] / 640
    shot.click(position={"x": 601.5 * scale, "y": 38.5 * scale})
    expect(panel).to_contain_text(re.compile(r"u 60[01]\s+v 3[78]\s+r 7\.5"))  # to the pixel of this screen
    look.click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("A restart of the gateway is needed for:")
    dialog.get_by_role("button", name="Save").click()
    expect(dialog.locator("[data-saved]")).to_be_visible()
    saved = config.load(bay.config).bays[0]
    assert saved.camera.beacon is not None
    assert (saved.camera.beacon.u_px, saved.camera.beacon.v_px) == pytest.approx((601, 38), abs=1)
    assert saved.camera.beacon.radius_px == 7.5
    assert saved.ranger.has_beacon

    health = visit(f"{bay.url}/").locator("[aria-labelledby=health-title]")
    expect(health).to_contain_text(re.compile(r"relay\s*may move"), timeout=PATIENCE_MS)
