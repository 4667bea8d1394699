"""The calibration page: boards before the camera become views by themselves, and the lens is saved to the file."""

import re
import zipfile
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route, expect

from gateway import config
from tests.browser import judgements
from tests.browser.chromium import Watch
from tests.browser.conftest import Visit
from tests.browser.held_boards import POSES, TRUE, board_plant

ROUND_MS = 60_000.0  # each pose for 2 s, and on a busy machine once more


def look_at_it(page: Page) -> None:
    judgements.accessible(page)
    for width_px in (390, 3840, 1366):
        page.set_viewport_size({"width": width_px, "height": 900})
        judgements.no_sideways_scroll(page)


def without_new_picture(route: Route) -> None:
    """As of a camera that has given none for 12 s."""
    answer = route.fetch()
    nothing: dict[str, object] = {
        "verdict": "no_picture",
        "frame_id": None,
        "points": [],
        "held_s": 0,
        "age_ms": 12_000,
        "work_ms": 0,
    }
    route.fulfill(response=answer, json=answer.json() | nothing | {"view": None})


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_lens_from_the_board_to_the_file(
    visit: Visit, watches: list[Watch], tmp_path: Path, started: ExitStack
) -> None:
    plant = started.enter_context(board_plant(tmp_path))
    page = visit(f"{plant.url}/calibrate/bay1")
    watches[0].excused = re.compile("409")  # a look may be under way when the calibration is ended
    calibrated(page, plant.config)


def calibrated(page: Page, file: Path) -> None:
    page.get_by_label("inner corners in a row").fill("2")
    expect(page.get_by_role("button", name="Begin")).to_be_disabled()
    page.get_by_label("inner corners in a row").fill("8")
    page.get_by_label("side of a square").fill("18")
    look_at_it(page)
    judgements.usable_by_keyboard(page)
    page.get_by_role("button", name="Begin").click()
    expect(page.locator("[data-view]")).to_have_count(len(POSES), timeout=2 * ROUND_MS)
    expect(page.locator("[data-count]")).to_have_text("11 of 10 views")
    for need in ("views", "left", "right", "top", "bottom", "distance", "coverage"):
        expect(page.locator(f"[data-need={need}]")).to_have_attribute("data-open", "false")
    expect(page.locator("[data-verdict=similar]")).to_be_visible()
    expect(page.locator("[data-rms]")).to_contain_text("over 11 views")
    look_at_it(page)

    page.get_by_role("button", name="Remove view 1", exact=True).click()
    expect(page.locator("[data-view='1']")).to_have_count(0)
    # Its pose is shown again, and taken: what stands below the views moves meanwhile, away from under a click.
    expect(page.locator("[data-count]")).to_have_text("11 of 10 views", timeout=ROUND_MS)
    expect(page.locator(".result")).to_have_attribute("aria-busy", "false")
    page.get_by_label("True radius of the marker").fill("150")
    with page.expect_download() as taken:
        page.get_by_role("link", name="Views (ZIP)").click()
    with zipfile.ZipFile(taken.value.path()) as views:
        assert len(views.namelist()) >= 11  # with what to do with them

    page.get_by_role("button", name="Look at the change in the file…").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.locator(".added").filter(has_text="[vision.intrinsics]")).to_have_count(1)
    expect(dialog).to_contain_text("bays.bay1.fusion.cross_check.marker_radius_mm: (absent) -> 150")
    assert "intrinsics" not in file.read_text()  # shown, and not yet done
    judgements.accessible(page)
    dialog.get_by_role("button", name="Save").click()
    expect(page.locator("[data-saved]")).to_contain_text("The rest takes effect at the next start")

    page.route("**/calibration/look", without_new_picture)
    expect(page.locator("[data-verdict=no_picture]")).to_be_visible()
    expect(page.locator("[data-age]")).to_have_text(re.compile(r"^picture 1[2-9]\.\d\u202fs old$"))
    expect(page.locator(".live .picture")).to_have_class("picture old")
    expect(page.get_by_role("button", name="Take this view now")).to_be_disabled()
    page.unroute_all(behavior="wait")
    expect(page.locator(".live .picture")).to_have_class("picture")
    page.get_by_role("button", name="End this calibration").click()
    expect(page.get_by_role("button", name="Begin")).to_be_visible()
    expect(page.get_by_label("inner corners in a row")).to_have_value("8")  # remembered

    saved = config.load(file).bays[0]
    lens = saved.vision.intrinsics
    assert lens is not None
    assert (lens.width_px, lens.height_px) == (640, 480)
    assert [lens.fx, lens.fy] == pytest.approx([TRUE.fx, TRUE.fy], rel=0.003)
    assert [lens.cx, lens.cy] == pytest.approx([TRUE.cx, TRUE.cy], abs=2)
    assert saved.fusion.cross_check is not None
    assert saved.fusion.cross_check.focal_px == pytest.approx((lens.fx + lens.fy) / 2, rel=1e-6)
    assert file.read_text().startswith("# The lens of this bay is not known yet.\n")
