"""The settings page: a key changed, its fault named at the field, the difference, the save, the undo, the restart."""

import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from argon2 import PasswordHasher
from playwright.sync_api import Locator, Page, Route, expect

from gateway import config
from tests.browser import judgements
from tests.browser.chromium import Watch, until
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, Plant, plant

PASSWORD = "truck stands under a spout"


def free_port() -> int:
    """A gateway that is started again listens where it did before."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant"), STANDING, hmi_port=free_port()) as made:
        yield made


def look(page: Page, words: str = "Look at the changes") -> None:
    page.get_by_role("button", name=words, exact=True).click()
    expect(page.get_by_role("dialog").locator("pre.diff")).to_be_visible()


def test_a_key_is_changed_saved_and_the_save_undone(running: Plant, visit: Visit) -> None:
    before = running.config.read_text()
    page = visit(f"{running.url}/setup#bays/bay1/fusion", width_px=1280)
    field = page.get_by_label("radius_threshold_px", exact=True)
    row = page.locator("[data-key='bays.bay1.fusion.radius_threshold_px']")
    expect(row).to_contain_text("allowed: 0 to 20000 px; default: 180")
    field.fill("99999")
    expect(row.get_by_role("alert")).to_have_text("▲ allowed: 0 to 20000")
    expect(page.get_by_role("button", name="Look at the changes")).to_be_disabled()
    field.fill("150.5")
    expect(row).to_contain_text("changed")
    page.get_by_label("Search").fill("Z_th")
    page.get_by_label("visit.leave_distance_mm", exact=True).first.fill("310")  # Z_th is 300, and a band follows
    fault = page.locator("[data-key='visit.leave_distance_mm']").get_by_role("alert")
    expect(fault).to_contain_text("must be at least")  # as the gateway says, without any click
    page.get_by_label("visit.leave_distance_mm", exact=True).first.fill("2000")
    expect(fault).to_have_count(0)
    look(page)
    dialog = page.get_by_role("dialog")
    expect(dialog.locator(".added")).to_contain_text(["", "[fusion]", "radius_threshold_px = 150.5", "", "[visit]", ""])
    expect(dialog).to_contain_text("bays.bay1.fusion.radius_threshold_px: 180.0 -> 150.5")
    judgements.accessible(page)
    dialog.get_by_role("button", name="Save").click()
    expect(page.locator("[data-saved]")).to_contain_text(f"{running.config}.previous")
    expect(page.get_by_text("2 keys of the file wait for a restart")).to_be_visible()
    after = running.config.read_text()
    assert after.startswith(before.rstrip("\n"))
    assert "radius_threshold_px = 150.5" in after

    page.get_by_role("button", name="Undo the last save").click()
    dialog.get_by_role("button", name="Save").click()
    expect(page.locator("[data-saved]")).to_be_visible()
    expect(page.get_by_text("wait for a restart")).to_have_count(0)
    assert running.config.read_text() == before


def section(page: Page, name: str) -> Locator:
    return page.get_by_role("navigation", name="sections").get_by_role("link", name=name, exact=True)


@pytest.mark.long
def test_a_section_that_is_opened_by_keyboard_keeps_the_focus(running: Plant, visit: Visit) -> None:
    """And a broken address is one of no section."""
    page = visit(f"{running.url}/setup#100%", width_px=1280)
    expect(page.get_by_text("There is no such section (any more).")).to_be_visible()
    link = section(page, "mqtt")
    link.focus()
    page.keyboard.press("Enter")
    expect(link).to_have_attribute("aria-current", "page")
    expect(link).to_be_focused()


@pytest.mark.long
def test_taking_back_leaves_no_wrong_text_in_a_field(running: Plant, visit: Visit) -> None:
    page = visit(f"{running.url}/setup#fusion", width_px=1280)
    field = page.get_by_label("radius_threshold_px", exact=True)
    alert = page.locator("[data-key='fusion.radius_threshold_px']").get_by_role("alert")
    bar = page.get_by_role("region", name="changes")
    take_back = bar.get_by_role("button", name="Take back")
    before = field.input_value()
    field.fill("99999")
    page.get_by_label("radius_hysteresis_px", exact=True).fill("7")
    expect(bar.get_by_role("status")).to_have_text("1 change 1 wrong")
    take_back.click()
    expect(bar.get_by_role("status")).to_have_text("No changes")
    expect(field).to_have_value(before)
    expect(alert).to_have_count(0)
    expect(page.locator("main")).to_be_focused()  # the button is gone
    field.fill("99999")  # and no change
    expect(bar.get_by_role("status")).to_have_text("No changes 1 wrong")
    take_back.click()
    expect(field).to_have_value(before)
    field.fill("99999")
    section(page, "mqtt").click()  # there, nobody sees what is wrong
    expect(bar.get_by_role("status")).to_have_text("No changes")


def test_a_user_is_made_gets_a_new_password_and_is_removed(running: Plant, visit: Visit) -> None:
    before = running.config.read_text()
    page = visit(f"{running.url}/setup#hmi", width_px=1280)
    hashed, bar = page.locator("[data-key='hmi.users.vera.password_hash']"), page.get_by_role("region", name="changes")
    page.get_by_label("new name").fill("vera")
    page.get_by_label("new name").press("Enter")
    expect(page.locator("[data-key='hmi.users.vera.role']").get_by_role("combobox")).to_have_value("viewer")

    def new_password(first: str, second: str) -> None:
        hashed.get_by_label("password_hash").fill(first)
        hashed.get_by_label("the same again").fill(second)
        expect(page.get_by_role("button", name="Look at the changes")).to_be_disabled()  # typed, and not taken
        hashed.get_by_role("button", name="Set password").click()

    new_password(PASSWORD, PASSWORD[1:])
    expect(hashed.get_by_role("alert").filter(has_text="The two passwords differ.")).to_be_visible()
    new_password(PASSWORD, PASSWORD)
    expect(hashed.get_by_role("status")).to_have_text("The new password holds from the save on.")
    expect(hashed.get_by_label("password_hash")).to_have_value("")
    judgements.accessible(page)
    look(page)
    page.get_by_role("dialog").get_by_role("button", name="Save").click()
    expect(page.locator("[data-saved]")).to_be_visible()
    first = config.load(running.config).hmi.users[0].password_hash
    assert PasswordHasher().verify(first, PASSWORD)

    new_password(f"{PASSWORD} 2", f"{PASSWORD} 2")
    page.get_by_role("button", name="Look at the changes").click()
    page.get_by_role("dialog").get_by_role("button", name="Save").click()  # though the difference shows none
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert PasswordHasher().verify(config.load(running.config).hmi.users[0].password_hash, f"{PASSWORD} 2")

    page.get_by_role("button", name="Remove hmi.users.vera").click()
    expect(bar.get_by_role("status")).to_have_text("1 change")
    look(page)
    page.get_by_role("dialog").get_by_role("button", name="Save").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert running.config.read_text() == before


def test_settings_of_vision_with_warnings_are_saved_only_after_they_were_read(
    running: Plant, visit: Visit, watches: list[Watch]
) -> None:
    before = running.config.read_text()
    page = visit(f"{running.url}/setup#bays/bay1/vision", width_px=1280)
    page.get_by_label("min_area_px2", exact=True).fill("90000000")  # nothing is so large
    look(page)
    save = page.get_by_role("dialog").get_by_role("button", name="Save", exact=True)
    save.click()
    warnings = page.get_by_role("dialog", name=re.compile(r"These settings are saved with (1 warning|\d+ warnings):"))
    found = warnings.get_by_role("listitem").filter(has_text="finds the marker less often")
    expect(found).to_contain_text("bay1/live")
    judgements.accessible(page)
    agree = warnings.get_by_role("button", name="Save all the same")
    expect(agree).to_be_disabled()
    warnings.get_by_role("button", name="Cancel").click()
    expect(warnings).to_have_count(0)
    assert running.config.read_text() == before
    save.click()
    warnings.get_by_role("checkbox").check()
    agree.click()
    expect(page.locator("[data-saved]")).to_be_visible()
    assert "min_area_px2 = 90000000" in running.config.read_text()
    page.get_by_role("button", name="Undo the last save").click()
    save.click()  # and no question
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert running.config.read_text() == before
    refusals = watches[0].complaints
    assert len(refusals) == 2
    assert all("409 (Conflict)" in refusal and "/api/setup/save" in refusal for refusal in refusals)
    refusals.clear()


@pytest.mark.long
def test_a_score_that_takes_long_is_waited_for_in_sight_and_may_be_cancelled(
    running: Plant, visit: Visit, watches: list[Watch]
) -> None:
    warning = {"id": "x []", "text": "not scored", "key": "", "pictures": [], "test_set": "dusk 2", "bay": "bay1"}
    body = {"error": "warnings", "detail": "not scored", "warnings": [{**warning, "scoring": True}]}
    score = {"running": True, "done": 3, "total": 40}
    page = visit(f"{running.url}/setup#bays/bay1/vision", width_px=1280)
    page.route("**/api/setup/save", lambda route: route.fulfill(status=409, json=body))
    page.route("**/bay1/test-sets/dusk%202/score", lambda route: route.fulfill(json=score))
    page.route("**/bay1/test-sets/dusk%202/score/cancel", lambda route: route.fulfill(json=score))
    page.get_by_label("min_area_px2", exact=True).fill("300")
    look(page)
    dialog = page.get_by_role("dialog")
    save = dialog.get_by_role("button", name="Save", exact=True)
    save.click()
    expect(dialog.get_by_role("status")).to_have_text("Scoring: 3 of 40 pictures")
    judgements.accessible(page)
    dialog.get_by_role("button", name="Cancel scoring").click()
    expect(dialog.get_by_role("status")).to_have_count(0)
    expect(save).to_be_enabled()
    save.click()
    expect(dialog.get_by_role("status")).to_have_text("Scoring: 3 of 40 pictures")
    score["running"] = False  # without a result: now it is a question
    warnings = page.get_by_role("dialog", name="These settings are saved with 1 warning:")
    expect(warnings.get_by_role("listitem")).to_contain_text("dusk 2: not scored")
    warnings.get_by_role("button", name="Cancel").click()
    watches[0].complaints[:] = [each for each in watches[0].complaints if "/api/setup/save" not in each]


@pytest.mark.long
def test_a_save_can_be_undone_as_soon_as_its_dialog_has_closed(running: Plant, visit: Visit) -> None:
    """The text that was saved is long in coming."""
    before = running.config.read_text()
    page = visit(f"{running.url}/setup#bays/bay1/fusion")
    page.get_by_label("radius_threshold_px", exact=True).fill("150.5")
    look(page)
    held: list[Route] = []
    page.route("**/api/setup/settings", lambda route: held.append(route))  # noqa: PLW0108
    dialog = page.get_by_role("dialog")
    save = dialog.get_by_role("button", name="Save", exact=True)
    save.click()
    until(page, lambda: held)
    page.wait_for_timeout(300)
    expect(dialog).to_be_visible()
    held[0].continue_()
    page.unroute("**/api/setup/settings")
    expect(page.locator("[data-saved]")).to_be_visible()
    assert running.config.read_text() != before
    page.get_by_role("button", name="Undo the last save").click()
    save.click()
    expect(dialog).to_have_count(0)
    assert running.config.read_text() == before


@pytest.mark.long
def test_changes_are_not_checked_beside_the_dialog_that_saves_them(running: Plant, visit: Visit) -> None:
    page = visit(f"{running.url}/setup#bays/bay1/fusion")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url.rsplit("/", 1)[1]))
    page.get_by_label("radius_threshold_px", exact=True).fill("150.5")
    look(page)
    checks = asked.count("preview")  # by the dialog, and on a busy machine before it
    page.wait_for_timeout(1000)
    assert asked.count("preview") == checks
    page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    until(page, lambda: asked.count("preview") == checks + 1)


@pytest.mark.long
def test_bays_of_the_command_line_are_named_and_the_files_kept(
    visit: Visit, tmp_path: Path, started: ExitStack
) -> None:
    both = started.enter_context(plant(tmp_path, STANDING, bays=2))
    page = visit(f"{both.url}/setup#bays", width_px=1280)
    expect(page.get_by_text("This gateway was started with other bays than the file's (--bays).")).to_be_visible()
    expect(page.get_by_role("button", name="Add")).to_have_count(0)
    page.goto(f"{both.url}/setup#fusion")
    page.get_by_label("radius_threshold_px", exact=True).fill("150.5")
    look(page)
    page.get_by_role("dialog").get_by_role("button", name="Save").click()
    expect(page.locator("[data-saved]")).to_be_visible()
    page.goto(f"{both.url}/setup/new-bay")
    expect(page.locator("main")).to_contain_text("started with other bays than the file's (--bays)")


@pytest.mark.long
def test_a_restart_is_confirmed_and_the_page_comes_back(running: Plant, visit: Visit, watches: list[Watch]) -> None:
    page = visit(f"{running.url}/setup", width_px=360)
    pid = running.gateway.process.pid
    page.get_by_label("site", exact=True).fill("south_works")
    look(page)
    judgements.no_sideways_scroll(page)
    page.get_by_role("dialog").get_by_role("button", name="Save").click()
    page.get_by_role("button", name="Restart").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("Stop is shown on all bays for about 10 seconds")
    said = dialog.locator(".notice")

    def truck_named() -> bool:
        """A gateway that has just started says so first."""
        if "a truck" not in " ".join(said.all_inner_texts()):
            dialog.get_by_role("button", name="Restart now").click()
            page.wait_for_timeout(500)
        return "a truck" in " ".join(said.all_inner_texts())

    until(page, truck_named)
    expect(said).to_contain_text("a truck is at a bay (bay bay1: ")
    dialog.get_by_role("checkbox").check()
    dialog.get_by_role("button", name="Restart now").click()
    expect(page.locator("[data-restarting]")).to_be_visible()
    expect(page.locator("[data-restarting]")).to_have_count(0, timeout=60_000)
    expect(page.get_by_label("site", exact=True)).to_have_value("south_works", timeout=20_000)
    expect(page.get_by_text("waits for a restart")).to_have_count(0)
    assert running.gateway.process.poll() is None
    assert running.gateway.process.pid == pid, "the process is the same"
    (watch,) = watches
    assert any("409" in complaint for complaint in watch.complaints)
    watch.complaints.clear()  # meanwhile nobody answered


def test_the_doctor_examines_beside_the_running_gateway(running: Plant, visit: Visit) -> None:
    page = visit(f"{running.url}/setup#doctor", width_px=1280)
    page.get_by_role("button", name="Examine now").click()
    camera = page.locator(".findings li", has_text="camera bay1")
    expect(camera).to_contain_text("ask the running gateway, which has it", timeout=60_000)
    expect(page.locator(".findings li", has_text="clock")).to_have_count(1)
    judgements.accessible(page)
