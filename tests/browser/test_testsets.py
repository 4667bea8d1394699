"""Test sets on the technician's page: pictures labelled, scored, and counted against settings that go live."""

import re
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import FilePayload, expect

from gateway.vision.offline.evaluation import labels
from tests.browser import judgements
from tests.browser.chromium import Watch, end_function_check
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, plant

AREA = "min_area_px2"
LIVE = "These settings are live."


def drawn(u: int, v: int, radius: int, seed: int) -> bytes:
    image = np.random.default_rng(seed).normal(120, 6, (240, 320, 3)).clip(0, 255).astype(np.uint8)
    if radius:
        cv2.circle(image, (u, v), radius, (40, 36, 190), -1, cv2.LINE_AA)
    data: bytes = cv2.imencode(".png", image)[1].tobytes()
    return data


@pytest.mark.long
def test_a_test_set_is_made_labelled_scored_and_stands_before_what_goes_live(
    visit: Visit, watches: list[Watch], tmp_path: Path, started: ExitStack
) -> None:
    bay = started.enter_context(plant(tmp_path, STANDING, keeps=True))
    page = visit(f"{bay.url}/tune/bay1#test-sets")
    page.get_by_role("button", name="Freeze", exact=True).click()  # what is above does not move any more
    expect(page.locator(".effect .hint")).to_contain_text("Medians")
    panel = page.locator("#test-sets")
    panel.get_by_label("new set").fill("Dusk 2")
    panel.get_by_role("button", name="Make").click()
    files = [
        FilePayload(name="near.png", mimeType="image/png", buffer=drawn(160, 120, 60, 1)),
        FilePayload(name="far.png", mimeType="image/png", buffer=drawn(200, 100, 12, 2)),
        FilePayload(name="none.png", mimeType="image/png", buffer=drawn(0, 0, 0, 3)),
    ]
    panel.get_by_label("pictures for the test set").set_input_files(files)
    # Proposed by the robust method, confirmed; moved by keys; drawn with the pointer, and taken back.
    circle = [panel.get_by_label(name, exact=True) for name in ("u px", "v px", "R px")]
    expect(circle[2]).to_have_value(re.compile(r"^(59|60|61)"))
    overlay = panel.get_by_role("application")
    overlay.press("ArrowRight")
    overlay.press("Shift+ArrowUp")
    overlay.press("+")
    expect(circle[0]).to_have_value(re.compile(r"^(160|161)"))
    expect(circle[1]).to_have_value(re.compile(r"^(109|110)"))
    panel.get_by_role("button", name="As the robust method finds it").click()
    judgements.accessible(page)
    panel.get_by_role("button", name="Marker here").click()
    expect(panel.get_by_role("heading", name=re.compile("0002-far.png"))).to_be_visible()
    expect(circle[2]).to_have_value(re.compile(r"^1[123]"))
    panel.get_by_role("button", name="Marker here").click()
    expect(panel.get_by_role("heading", name=re.compile("0003-none.png"))).to_be_visible()
    expect(panel.get_by_text("sure of no marker here")).to_be_visible()
    expect(panel.get_by_alt_text("the picture that is labelled")).to_have_js_property("naturalWidth", 320)
    box = overlay.bounding_box()
    assert box is not None
    overlay.hover(position={"x": box["width"] / 2, "y": box["height"] / 2})
    page.mouse.down()
    overlay.hover(position={"x": box["width"] * 3 / 4, "y": box["height"] / 2})
    page.mouse.up()
    expect(circle[0]).to_have_value(re.compile(r"^(159|160)"))
    expect(circle[2]).to_have_value(re.compile(r"^(79|80|81)"))
    panel.get_by_role("button", name="No marker", exact=True).click()
    expect(panel.get_by_text("3 of at most 100 pictures, 3 of them labelled")).to_be_visible()
    panel.get_by_role("button", name="Close").click()
    expect(panel.get_by_role("button", name=re.compile("0003-none.png"))).to_be_focused()

    field = page.locator(f"#k-{AREA}-n")
    field.fill("3000")  # px2: more than the far marker has
    field.press("Enter")
    panel.get_by_role("button", name="Score these settings").click()
    expect(panel.get_by_role("row", name=re.compile("^marker found"))).to_contain_text("1 of 22 of 2")
    expect(panel.get_by_text("the marker is missed in 1 of 2 pictures")).to_be_visible()
    far = panel.get_by_role("row", name=re.compile("0002-far.png"))
    expect(far).to_have_attribute("data-differs", "true")
    judgements.accessible(page)
    judgements.usable_by_keyboard(page)
    far.get_by_role("button").click()
    compared = page.get_by_role("dialog", name="0002-far.png")
    expect(compared.get_by_role("listitem").filter(has_text="tried")).to_contain_text("no marker")
    compared.get_by_role("button", name="Close").click()

    field.fill("2900")
    field.press("Enter")
    expect(panel.get_by_text("This score is of other settings than those on the page.")).to_be_visible()
    page.get_by_role("button", name="Save to file…", exact=True).last.click()  # scored first
    saving = page.get_by_role("dialog", name="Save to the configuration's file")
    expect(saving).to_contain_text("min_area_px2 = 2900")
    expect(panel.get_by_text("This score is of other settings than those on the page.")).to_have_count(0)
    expect(panel.get_by_text("the marker is missed in 1 of 2 pictures")).to_be_visible()
    saving.get_by_role("button", name="Cancel").click()

    page.get_by_role("button", name="Begin function check").click()
    page.get_by_role("button", name="Go live", exact=True).click()
    dialog = page.get_by_role("dialog", name=re.compile(r"These settings go live with \d+ warnings:"))
    listed = dialog.get_by_role("listitem").filter(has_text="test set Dusk 2")
    expect(listed).to_have_count(2)
    dialog.get_by_role("checkbox").check()
    dialog.get_by_role("button", name="Go live all the same").click()
    expect(page.get_by_role("status").filter(has_text=LIVE)).to_be_visible()
    expect(page.locator("#undone")).to_have_text("Undo live change brings back: min_area_px2 = 200.")
    page.get_by_role("button", name="Undo live change").click()
    expect(page.get_by_role("status").filter(has_text="What was in force before is live again.")).to_be_visible()
    expect(page.locator("#undone")).to_be_empty()
    end_function_check(page)
    expect(page.get_by_role("button", name="Begin function check")).to_be_visible()
    (folder,) = (tmp_path / "state" / "test-sets").glob("*/bay1/Dusk 2")
    watches[0].complaints[:] = [each for each in watches[0].complaints if "/profile/apply" not in each]
    found = labels.load(folder)
    assert [(one.file, one.found) for one in found.labels] == [
        ("0001-near.png", True),
        ("0002-far.png", True),
        ("0003-none.png", False),
    ]
    assert [one.r for one in found.labels[:2]] == [pytest.approx(60.5, abs=1), pytest.approx(12.5, abs=1)]
