"""The camera's own controls on the technician's page: tried on the bay's camera, put back, and saved to the file."""

import re
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Page, Request, Route, expect

from gateway import config
from tests.browser.chromium import PATIENCE_MS, end_function_check, until
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, plant
from tests.e2e.plc import Plc

PATIENCE_S = PATIENCE_MS / 1000


def tried(page: Page, name: str, value: int) -> None:
    field = page.locator(f"[data-control={name}] input[type=number]")
    field.fill(str(value))
    field.press("Enter")


@pytest.fixture
def page(visit: Visit, tmp_path: Path, started: ExitStack) -> Page:
    """The camera's controls, in a function check."""
    bay = started.enter_context(plant(tmp_path, STANDING))
    page = visit(f"{bay.url}/tune/bay1#camera")
    page.get_by_role("button", name="Begin function check").click()
    expect(page.locator("#camera [data-control=gain] input[type=range]")).to_be_enabled()
    return page


@pytest.mark.long
def test_an_answer_from_before_a_change_takes_nothing_back(page: Page) -> None:
    """The page asks once a second what the camera has. An answer may be on its way while a value is tried."""
    panel = page.locator("#camera")
    held: list[Route] = []
    posts: list[object] = []

    def note(request: Request) -> None:
        if request.url.endswith("/camera/try"):
            posts.append(request.post_data_json)

    page.on("request", note)
    before = page.evaluate("() => fetch('/api/bays/bay1/camera').then((answer) => answer.json())")
    page.route("**/api/bays/bay1/camera", lambda route: held.append(route))  # noqa: PLW0108
    until(page, lambda: held)  # asked before the change
    tried(page, "gain", 5)
    expect(panel.get_by_role("status")).to_have_text("1 tried")
    held[0].fulfill(json=before)
    page.wait_for_timeout(300)
    expect(panel.get_by_role("status")).to_have_text("1 tried")
    tried(page, "exposure_time_absolute", 20)
    expect(panel.get_by_role("status")).to_have_text("2 tried")
    assert posts == [{"controls": {"gain": 5}}, {"controls": {"gain": 5, "exposure_time_absolute": 20}}]


@pytest.mark.long
def test_values_reach_the_camera_in_their_order(page: Page) -> None:
    """The first one's request is held up on its way."""
    panel = page.locator("#camera")
    held: list[Route] = []
    posts: list[object] = []

    def on_its_way(route: Route) -> None:
        if not held:
            held.append(route)
            return
        posts.append(route.request.post_data_json)
        route.continue_()

    page.route("**/camera/try", on_its_way)
    tried(page, "gain", 5)
    until(page, lambda: held)
    tried(page, "exposure_time_absolute", 20)
    tried(page, "exposure_time_absolute", 30)
    page.wait_for_timeout(300)
    assert posts == []
    held[0].continue_()
    expect(panel.get_by_role("status")).to_have_text("2 tried")
    assert posts == [{"controls": {"gain": 5, "exposure_time_absolute": 30}}]
    expect(panel.locator("[data-control=exposure_time_absolute] input[type=number]")).to_have_value("30")


def test_controls_are_tried_put_back_and_saved_with_crop_and_rotation(
    visit: Visit, tmp_path: Path, started: ExitStack
) -> None:
    bay = started.enter_context(plant(tmp_path, STANDING))
    with Plc(bay.modbus_port) as plc:
        plc.wait_for(lambda image: image["radius"] is not None, PATIENCE_S)
        page = visit(f"{bay.url}/tune/bay1#camera")
        panel = page.locator("#camera")
        expect(panel.locator("[data-control]")).to_have_count(5)
        gain = panel.locator("[data-control=gain]")
        expect(gain.locator("input[type=range]")).to_be_disabled()
        expect(gain).to_contain_text("0 to 100, step 1, default 0.")

        page.get_by_role("button", name="Begin function check").click()
        expect(gain.locator("input[type=range]")).to_be_enabled()
        dark = panel.locator("[data-control=exposure_time_absolute]")
        tried(page, "exposure_time_absolute", 20)  # of 50
        plc.wait_for(lambda image: 5 < (image["picture_brightness"] or 0) < 25, PATIENCE_S)  # %
        expect(dark).to_contain_text("tried, take back")
        panel.get_by_role("button", name="Undo").click()
        expect(dark.locator("input[type=number]")).to_have_value("50")

        warm = panel.locator("[data-control=white_balance_temperature]")
        expect(warm).to_contain_text("switch its automatic off first")
        expect(warm.locator("input[type=number]")).to_be_disabled()
        panel.locator("[data-control=white_balance_automatic] input").uncheck()
        tried(page, "white_balance_temperature", 5203)  # the nearest of its steps
        expect(warm.locator("input[type=number]")).to_have_value("5200")
        tried(page, "exposure_time_absolute", 20)
        expect(panel.get_by_role("status")).to_have_text("3 tried")
        end_function_check(page)
        expect(panel.get_by_role("status")).to_have_text("as the file says")
        expect(dark.locator("input[type=number]")).to_have_value("50")
        expect(warm.locator("input[type=number]")).to_have_value("4600")

        page.get_by_role("button", name="Begin function check").click()
        tried(page, "gain", 5)
        panel.get_by_role("button", name="Save to file…").click()
        dialog = page.get_by_role("dialog")
        expect(dialog.locator(".diff .added").filter(has_text="gain = 5")).to_have_count(1)
        dialog.get_by_role("button", name="Save").click()
        expect(dialog.locator("[data-saved]")).to_be_visible()
        dialog.get_by_role("button", name="Close").click()
        page.get_by_role("button", name="End function check…").click()
        expect(page.get_by_text("Saved, and not in force yet: camera.controls.")).to_be_visible()

        panel.get_by_label("turned by").select_option("90")
        for label, value in (("left edge", 40), ("upper edge", 0), ("width", 560), ("height", 480)):
            panel.get_by_label(label).fill(str(value))
        framing = panel.get_by_role("group", name="Crop and rotation")
        framing.get_by_role("button", name="Look at the change in the file…").click()
        expect(dialog).to_contain_text(re.compile(r"A restart of the gateway is needed for:.*rotation_deg", re.DOTALL))
        dialog.get_by_role("button", name="Save").click()
        expect(dialog.locator("[data-saved]")).to_be_visible()
    saved = config.load(bay.config).bays[0].camera
    assert (saved.controls.gain, saved.rotation_deg, saved.picture_px) == (5, 90, (480, 560))
    assert "# The bay of a test. This comment and the others must outlive" in bay.config.read_text()
