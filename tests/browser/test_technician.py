"""The technician's page: a slider is tried on a frozen frame, goes live in a function check, and is written back."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from gateway import config
from tests.browser.chromium import PATIENCE_MS, until
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, Plant, plant
from tests.e2e.plc import Plc

WHITE = """async (image) => {
  await image.decode();
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
    frozen(page)
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


def test_save_shows_the_difference_and_changes_one_line_of_the_file(visit: Visit, tmp_path: Path) -> None:
    with plant(tmp_path, STANDING) as bay, Plc(bay.modbus_port) as plc:
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

        page.get_by_role("button", name="End function check").click()
        plc.wait_for(lambda image: image["may_move"] == 1, PATIENCE_S)
        page.close()  # before the gateway ends


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
    expect(page.get_by_role("status").filter(has_text="profile.toml: 1 key differs")).to_be_visible()


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
