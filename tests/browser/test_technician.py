"""The technician's page: a slider is tried on a frozen frame, goes live in a function check, and is written back."""

import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import FilePayload, Locator, Page, Request, Route, expect

from gateway import config
from tests.browser.chromium import PATIENCE_MS, Watch, end_function_check, until
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, TO_AND_FRO, Plant, plant
from tests.e2e.plc import Plc

# Decoding fails where the page shows another picture meanwhile: that one is waited for.
WHITE = """async (image) => {
  for (let source; source !== image.src;) {
    source = image.src;
    await image.decode().catch((error) => { if (source === image.src) throw error; });
  }
  const canvas = new OffscreenCanvas(image.naturalWidth, image.naturalHeight);
  const g = canvas.getContext('2d');
  g.drawImage(image, 0, 0);
  const { data } = g.getImageData(0, 0, canvas.width, canvas.height);
  let white = 0;
  for (let at = 0; at < data.length; at += 4) white += data[at] > 127;
  return white;
}"""
PATIENCE_S = PATIENCE_MS / 1000
AREA = "min_area_px2"
LIVE = "These settings are live."


@pytest.fixture(scope="module")
def bay(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant"), STANDING) as running:
        yield running


@pytest.fixture
def page(bay: Plant, visit: Visit) -> Page:
    return tuning(bay, visit)


def tuning(bay: Plant, visit: Visit) -> Page:
    opened = visit(f"{bay.url}/tune/bay1")
    expect(mask(opened)).to_be_visible()
    return opened


def mask(page: Page) -> Locator:
    return page.locator("[data-panel=mask] img")


def white(page: Page) -> int:
    """Pixels of the mask that is shown now."""
    found: int = mask(page).evaluate(WHITE)
    return found


def frozen(page: Page) -> None:
    page.get_by_role("button", name="Freeze", exact=True).click()
    expect(page.locator(".source select")).to_have_value(re.compile("."))
    expect(page.get_by_role("button", name="Live", exact=True)).to_have_attribute("aria-pressed", "false")
    settled(page)


def settled(page: Page) -> None:
    """The newest settings have been tried on the chosen picture, and timed: nothing shown is of an earlier one."""
    expect(page.locator(".tiles")).not_to_have_class(re.compile(r"\bbehind\b"))
    expect(page.locator(".effect .hint")).to_contain_text("Medians")
    expect(page.locator(".effect")).to_have_attribute("aria-busy", "false")


def in_file(path: Path) -> float:
    found: float = config.load(path).bays[0].vision.min_area_px2
    return found


def test_a_slider_changes_the_mask_of_a_frozen_frame_and_nothing_else(bay: Plant, page: Page) -> None:
    before = bay.config.read_text()
    judged = page.locator(".remarks").get_by_text("Judged on frame")  # live: the exposure is of an earlier one
    expect(judged).to_be_visible()
    frozen(page)
    expect(judged).to_have_count(0)
    marker = white(page)
    assert marker > 1000
    for number in (1, 2):  # red lies at both ends of the hues
        slider = page.get_by_label(f"range {number}, saturation, lower", exact=True)
        slider.focus()
        page.keyboard.press("End")
        expect(slider).to_have_value("255")
    until(page, lambda: white(page) < marker / 10)
    settled(page)
    expect(page.locator(".effect .verdict")).to_contain_text("no marker found; the settings in force find it")
    expect(page.locator(".effect .timebar")).to_have_count(2)
    expect(page.locator(".effect .timebar").first).to_contain_text(re.compile(r"\d ms"))
    expect(page.get_by_role("button", name="Go live")).to_be_disabled()  # without a function check nothing goes live
    with Plc(bay.modbus_port) as plc:
        plc.wait_for(
            lambda image: image["may_move"] == 1 and image["radius"] is not None, PATIENCE_S
        )  # what runs still finds it
    page.get_by_role("button", name="Take all back").click()
    until(page, lambda: white(page) == marker)
    assert bay.config.read_text() == before


def test_save_shows_the_difference_and_changes_one_line_of_the_file(
    visit: Visit, tmp_path: Path, started: ExitStack
) -> None:
    bay = started.enter_context(plant(tmp_path, STANDING))
    with Plc(bay.modbus_port) as plc:
        before = bay.config.read_text()
        assert in_file(bay.config) == 200.0
        plc.wait_for(lambda image: image["may_move"] == 1, PATIENCE_S)
        page = tuning(bay, visit)
        page.get_by_role("button", name="Begin function check").click()
        plc.wait_for(lambda image: image["may_move"] == 0, PATIENCE_S)
        expect(page.get_by_role("heading", name=re.compile("FUNCTION CHECK"))).to_contain_text("may_move is OFF")

        field = page.locator(f"#k-{AREA}-n")
        field.fill("350")
        field.press("Enter")
        page.get_by_role("button", name="Go live").click()
        expect(page.get_by_role("status").filter(has_text=LIVE)).to_be_visible()
        assert bay.config.read_text() == before  # the file is another matter

        page.get_by_role("button", name="Save to file…").click()
        dialog = page.get_by_role("dialog")
        expect(dialog.locator(".diff .removed")).to_have_text(re.compile(rf"^-{AREA} = 200\.0 .*no marker\s*$"))
        expect(dialog.locator(".diff .added")).to_have_text(re.compile(rf"^\+{AREA} = 350(\.0)? .*no marker\s*$"))
        assert bay.config.read_text() == before  # shown, and not yet done
        dialog.get_by_role("button", name="Save").click()
        expect(dialog).to_contain_text("Saved.")
        dialog.get_by_role("button", name="Close").click()
        assert in_file(bay.config) == 350.0
        old, new = before.splitlines(), bay.config.read_text().splitlines()
        assert len(old) == len(new)
        changed = [(was, now) for was, now in zip(old, new, strict=True) if was != now]
        assert len(changed) == 1
        assert changed[0][1].endswith("# smaller red things are no marker")
        kept = [path for path in bay.config.parent.iterdir() if path.name.startswith("plant") and path != bay.config]
        assert before in [path.read_text() for path in kept]

        end_function_check(page)
        plc.wait_for(lambda image: image["may_move"] == 1, PATIENCE_S)


@pytest.mark.long
def test_a_second_tab_notices_what_the_first_has_changed(visit: Visit, tmp_path: Path, started: ExitStack) -> None:
    bay = started.enter_context(plant(tmp_path, STANDING))
    first, second = tuning(bay, visit), tuning(bay, visit)
    first.get_by_role("button", name="Begin function check").click()
    expect(second.get_by_role("heading", name=re.compile("FUNCTION CHECK"))).to_be_visible()
    field = first.locator(f"#k-{AREA}-n")
    field.fill("350")
    field.press("Enter")
    first.get_by_role("button", name="Go live").click()
    expect(first.get_by_role("status").filter(has_text=LIVE)).to_be_visible()
    expect(second.locator("#why-not-live")).to_contain_text(f"by somebody else, and live: {AREA}.")
    expect(second.locator(f"#k-{AREA}-n")).to_have_value(re.compile(r"^350"))
    end_function_check(first)
    expect(second.get_by_role("button", name="Begin function check", exact=True)).to_be_visible()


@pytest.mark.long
def test_a_change_is_undone_with_one_click_outside_a_function_check_and_after_the_web_process_was_replaced(
    visit: Visit, watches: list[Watch], tmp_path: Path, started: ExitStack
) -> None:
    bay = started.enter_context(plant(tmp_path, STANDING))
    page = tuning(bay, visit)
    page.get_by_role("button", name="Begin function check", exact=True).click()
    field = page.locator(f"#k-{AREA}-n")
    field.fill("350")
    field.press("Enter")
    page.get_by_role("button", name="Go live").click()
    expect(page.get_by_role("status").filter(has_text=LIVE)).to_be_visible()
    expect(page.get_by_role("button", name="Undo live change", exact=True)).to_be_enabled()
    end_function_check(page)
    undo = page.get_by_role("button", name="Begin function check and undo")
    expect(undo).to_be_enabled()
    bay.process("gw-hmi").kill()
    expect(page.get_by_text("no new data").or_(page.get_by_text("NO CONNECTION", exact=True))).to_be_visible()
    expect(page.get_by_text("connected", exact=True)).to_be_visible(timeout=20_000)
    page.reload()
    expect(field).to_have_value(re.compile(r"^350"))
    expect(page.locator("#undone")).to_have_text(f"Undo live change brings back: {AREA} = 200.")
    undo.click()
    expect(page.get_by_role("heading", name=re.compile("FUNCTION CHECK – may_move is OFF"))).to_be_visible()
    expect(page.get_by_role("status").filter(has_text="What was in force before is live again.")).to_be_visible()
    expect(field).to_have_value(re.compile(r"^200"))
    expect(page.locator("#undone")).to_be_empty()
    expect(page.get_by_role("button", name="Undo live change", exact=True)).to_be_disabled()
    watches[0].complaints.clear()  # of the time without a web process


@pytest.mark.long
def test_settings_with_warnings_go_live_only_after_they_were_read(
    visit: Visit, watches: list[Watch], tmp_path: Path, started: ExitStack
) -> None:
    bay = started.enter_context(plant(tmp_path, STANDING))
    page = tuning(bay, visit)
    page.get_by_role("button", name="Begin function check").click()
    field = page.locator(f"#k-{AREA}-n")
    field.fill("90000000")  # px2: nothing is so large
    field.press("Enter")
    page.get_by_role("button", name="Go live", exact=True).click()
    dialog = page.get_by_role("dialog", name=re.compile(r"These settings go live with \d+ warnings:"))
    expect(dialog.get_by_role("listitem").filter(has_text="finds the marker less often")).to_be_visible()
    agree = dialog.get_by_role("button", name="Go live all the same")
    expect(agree).to_be_disabled()
    held: list[Route] = []
    page.route("**/bays/bay1/profile", lambda route: held.append(route), times=1)  # noqa: PLW0108
    dialog.get_by_role("button", name="Cancel").click()
    until(page, lambda: held)  # what is in force is read again, and no click counts meanwhile
    unchanged = page.get_by_role("status").filter(has_text="Nothing was changed.")
    page.wait_for_timeout(300)
    expect(unchanged).to_have_count(0)
    held[0].continue_()
    expect(unchanged).to_be_visible()
    page.get_by_role("button", name="Go live", exact=True).click()
    dialog.get_by_role("checkbox").check()
    agree.click()
    expect(page.get_by_role("status").filter(has_text=LIVE)).to_be_visible()
    refusals = watches[0].complaints
    assert len(refusals) >= 2
    assert all("409 (Conflict)" in refusal and "/profile/apply" in refusal for refusal in refusals)
    refusals.clear()


@pytest.mark.long
def test_a_profile_is_exported_and_imported(bay: Plant, page: Page, tmp_path: Path) -> None:
    field = page.locator(f"#k-{AREA}-n")
    field.fill("275")
    field.press("Enter")
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Export").click()
    profile = tmp_path / "profile.toml"
    waiting.value.save_as(profile)
    assert re.search(rf"^{AREA} = 275", profile.read_text(), re.MULTILINE)
    page.get_by_role("button", name="Take all back").click()
    expect(field).to_have_value(re.compile(r"^200"))
    page.get_by_label("a profile to import").set_input_files(profile)
    expect(field).to_have_value(re.compile(r"^275"))
    expect(page.get_by_role("status").filter(has_text="profile.toml: one key differs")).to_be_visible()


@pytest.mark.long
def test_settings_are_tried_on_an_uploaded_picture(page: Page) -> None:
    image = np.full((240, 320, 3), 120, np.uint8)
    cv2.circle(image, (200, 100), 40, (40, 36, 190), -1)
    data = cv2.imencode(".png", image)[1].tobytes()
    files = page.get_by_label("pictures to upload")
    files.set_input_files(FilePayload(name="dusk.png", mimeType="image/png", buffer=data))
    expect(page.get_by_role("status").filter(has_text="1 picture uploaded")).to_be_visible()
    expect(page.locator(".source select option:checked")).to_have_text(re.compile(r"^dusk\.png, "))
    settled(page)
    expect(page.locator(".tile.picture figcaption")).to_contain_text("uploaded")
    expect(page.get_by_role("row", name=re.compile("^R px")).get_by_role("cell").first).to_have_text(
        re.compile(r"^(39|40|41)\.")
    )
    files.set_input_files([FilePayload(name=f"{n}.png", mimeType="image/png", buffer=data) for n in range(9)])
    expect(page.get_by_role("status").filter(has_text="9 files: at most 8 at a time")).to_be_visible()


SAME_FRAME = """() => {
  const frames = [...document.querySelectorAll('.tiles [data-frame]')].map((tile) => tile.dataset.frame);
  const stages = [...document.querySelectorAll('.stage img')].map((img) => img.src.split('/').at(-2));
  const tiles = document.querySelector('.tiles').dataset.trial;
  if (new Set(frames).size > 1 || stages.some((trial) => trial !== tiles)) window.__apart.push([tiles, frames, stages]);
}"""


@pytest.mark.long
def test_all_pictures_are_of_one_frame_and_a_click_samples_the_one_that_is_seen(
    visit: Visit, tmp_path: Path, started: ExitStack
) -> None:
    """The truck moves, and the picture itself comes late, as a large one does."""
    bay = started.enter_context(plant(tmp_path, TO_AND_FRO))
    page = tuning(bay, visit)

    def late(route: Route) -> None:
        page.wait_for_timeout(400)
        route.continue_()

    page.route("**/trial/*/picture", late)
    page.evaluate("() => { window.__apart = []; }")
    page.evaluate(f"() => {{ const look = {SAME_FRAME}; setInterval(look, 30); }}")
    tiles = page.locator(".tiles")
    first = tiles.get_attribute("data-trial")
    until(page, lambda: tiles.get_attribute("data-trial") != first)
    asked: list[object] = []

    def note(request: Request) -> None:
        if request.url.endswith("/freeze"):
            asked.append(request.post_data_json)

    page.on("request", note)
    seen = page.evaluate("""() => {
      const picture = document.querySelector('.tile.picture');
      const [frame, trial] = [picture.dataset.frame, document.querySelector('.tiles').dataset.trial];
      picture.querySelector('canvas').click();
      return [Number(frame), Number(trial)];
    }""")
    expect(page.locator(".eyedropper .swatch")).to_be_visible()
    assert asked == [{"trial": seen[1]}]
    taken = page.evaluate("() => fetch('/api/bays/bay1/captures').then((answer) => answer.json())")
    assert [one["frame_ids"] for one in taken] == [[seen[0]]]
    settled(page)
    assert page.locator(".tile.picture").get_attribute("data-frame") == str(seen[0])
    assert page.evaluate("() => window.__apart") == []


BITMAPS = """
window.__bitmaps = [];
const make = window.createImageBitmap.bind(window);
window.createImageBitmap = async (...all) => {
  const bitmap = await make(...all);
  window.__bitmaps.push(bitmap);
  return bitmap;
};
"""
OPEN = "() => window.__bitmaps.filter((one) => one.width > 0).length"  # a closed one has no size


@pytest.mark.long
def test_the_memory_of_a_picture_is_given_back_when_the_next_one_is_shown(page: Page) -> None:
    page.evaluate("() => {" + BITMAPS + "}")
    until(page, lambda: page.evaluate("() => window.__bitmaps.length") > 6)
    until(page, lambda: page.evaluate(OPEN) <= 2)


NOT_YET = "not yet the chosen picture"


@pytest.mark.long
def test_a_picture_that_is_not_the_chosen_one_is_marked_and_not_to_be_clicked(page: Page) -> None:
    held: list[Route] = []
    asked: list[str] = []
    holding = True

    def hold(route: Route) -> None:
        if holding:
            held.append(route)
        else:
            route.continue_()

    page.route("**/trial", hold)
    page.on("request", lambda request: asked.append(request.url.rsplit("/", 1)[1]))
    image = cv2.imencode(".png", np.full((240, 320, 3), 120, np.uint8))[1].tobytes()
    files = page.get_by_label("pictures to upload")
    files.set_input_files(FilePayload(name="dusk.png", mimeType="image/png", buffer=image))
    tile = page.locator(".tile.picture")
    expect(tile).to_contain_text(NOT_YET)
    expect(page.locator(".tiles")).to_have_class(re.compile(r"\belsewhere\b"))
    picture = tile.locator("canvas")
    expect(picture).to_have_attribute("aria-disabled", "true")
    picture.dispatch_event("click")
    picture.press("Enter")
    page.wait_for_timeout(300)
    assert {"freeze", "eyedropper"} & set(asked) == set()
    holding = False
    for route in held:
        route.continue_()
    expect(tile).not_to_contain_text(NOT_YET)
    picture.press("Enter")
    until(page, lambda: "eyedropper" in asked)


@pytest.mark.long
def test_the_eyedropper_takes_the_colour_at_a_place(page: Page) -> None:
    """The marker stands in the middle of the picture; what is asked for is what is let in."""
    frozen(page)
    for number in (1, 2):
        page.get_by_label(f"range {number}, saturation, lower", exact=True).focus()
        page.keyboard.press("End")
    until(page, lambda: white(page) < 100)
    picture = page.locator(".tile.picture canvas").first
    picture.scroll_into_view_if_needed()
    picture.click()
    until(page, lambda: white(page) > 1000)


def orange_bay() -> bytes:
    image = np.full((240, 320, 3), 120, np.uint8)
    cv2.circle(image, (160, 120), 50, (18, 91, 231), -1)
    return cv2.imencode(".png", cv2.GaussianBlur(image, (3, 3), 0))[1].tobytes()


@pytest.mark.long
def test_a_marker_of_another_colour_is_taught_by_a_click_tried_and_saved(
    visit: Visit, watches: list[Watch], tmp_path: Path, started: ExitStack
) -> None:
    bay = started.enter_context(plant(tmp_path, STANDING))
    page = tuning(bay, visit)
    page.get_by_label("robust", exact=True).check()
    expect(page.get_by_label("widens them")).to_have_count(0)
    picture = FilePayload(name="orange.png", mimeType="image/png", buffer=orange_bay())
    page.get_by_label("pictures to upload").set_input_files(picture)
    settled(page)
    verdict, colour, said = page.locator(".effect .verdict"), page.locator("#k-marker_colour"), page.locator("#picked")
    expect(verdict).to_contain_text("no marker found")
    page.locator(".tile.picture canvas").click()
    expect(said).to_contain_text(re.compile(r"#e75b12 hue 21° \(21° to 21°\), chroma 2\.22.*Proposed"))
    expect(said).to_contain_text("Another colour than the marker's")
    expect(colour).to_have_value("#e75b12")
    settled(page)
    expect(verdict).to_have_text(re.compile(r"^marker found, R (49|50)\."))
    colour.fill("#e75b1")
    expect(page.get_by_text("# and six hex digits, two each of red, green and blue")).to_be_visible()
    expect(colour).to_have_attribute("aria-invalid", "true")
    colour.press("Enter")
    expect(colour).to_have_value("#e75b12")  # what is no colour changes nothing

    page.get_by_role("button", name="Save to file…").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.locator(".diff .added").filter(has_text='marker_colour = "#e75b12"')).to_have_count(1)
    dialog.get_by_role("button", name="Save").click()
    warned = page.get_by_role("dialog").filter(has_text="finds the marker less often")  # the simulated one is red
    warned.get_by_role("checkbox").check()
    warned.locator("button.primary").click()
    expect(dialog).to_contain_text("Saved.")
    assert config.load(bay.config).bays[0].vision.marker_colour == "#e75b12"
    watches[0].complaints.clear()  # of the save that was refused for its warnings


@pytest.mark.long
def test_a_function_check_ends_only_when_what_is_saved_is_in_force_and_names_what_follows(
    visit: Visit, tmp_path: Path, started: ExitStack
) -> None:
    bay = started.enter_context(plant(tmp_path, STANDING, keeps=True))
    page = tuning(bay, visit)
    page.get_by_role("button", name="Begin function check", exact=True).click()
    end = page.get_by_role("button", name="End function check…")
    expect(end).to_be_visible()
    former = bay.config.read_text()
    bay.config.write_text(f"{former}\n[fusion]\nradius_threshold_px = 120.0\n")
    end.click()
    notice = page.get_by_role("alert").filter(has_text="Saved, and not in force yet: fusion.radius_threshold_px.")
    notice.get_by_role("button", name="Restart the gateway").click()
    question = page.get_by_role("dialog", name="Restart the gateway")
    expect(question).to_contain_text("Stop is shown on all bays for about 10 seconds.")
    question.get_by_role("button", name="Cancel").click()
    bay.config.write_text(former)
    end.click()
    dialog = page.get_by_role("dialog", name="End the function check?")
    expect(dialog).to_contain_text("D = 1 at R of 180.0 px and Z of 300 mm: these thresholds are in force")
    expect(dialog).to_contain_text("it must leave the mark, and come again")
    dialog.get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("heading", name=re.compile("FUNCTION CHECK"))).to_be_visible()
    end_function_check(page)
    expect(page.get_by_role("heading", name="The bay is at work")).to_be_visible()
