"""Takes the pages' pictures for README and docs anew, from running simulations: `./dev screenshots [NAME ...]`."""

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from playwright.sync_api import Browser, Page, expect

from tests.browser.chromium import chromium, until, visited
from tests.browser.held_boards import POSES, board_plant
from tests.browser.plant import STANDING, TO_AND_FRO, first_visit, plant
from tests.browser.recorded_week import Pages, in_zone, prepared
from tests.browser.recorded_week_pictures import with_pictures
from tests.e2e.processes import Gateway

NOON_MS = 1_794_999_600_000  # 2026-11-18 12:00 in Berlin: the day with most trucks
WAIT_S = 90.0  # for the moment that is to be shown
TREND_MS = 25_000.0  # so that a trend has something to show
FREE_PORTS = ("--modbus-port", "0", "--hmi-port", "0")


def of_code(code: str) -> Callable[[Page], None]:
    """The moment at which the driver is told this."""
    return lambda page: until(page, lambda: page.evaluate("() => document.body.dataset.code") == code, WAIT_S)


def with_trend(decision: str, why: str = "") -> Callable[[Page], None]:
    def moment(page: Page) -> None:
        page.wait_for_timeout(TREND_MS)
        word, reason = page.locator(".decision .word"), page.locator(".decision .why")

        def so() -> bool:
            return word.inner_text() == decision and why in reason.inner_text()

        for _ in range(10):
            until(page, so, WAIT_S)
            page.wait_for_timeout(1500)  # until events and visit are shown, too
            if so():
                return
        raise AssertionError(f"{decision}, {why}: never for this time")

    return moment


def one_in_trouble(page: Page) -> None:
    """All others are well."""
    expect(page.get_by_role("button", name="in trouble")).to_contain_text(re.compile(r"\b1$"), timeout=1000 * WAIT_S)
    expect(page.get_by_role("button", name="Acknowledge").first).to_be_visible(timeout=1000 * WAIT_S)


def tried(page: Page) -> None:
    """A frozen frame, other settings, and what they do."""
    page.get_by_label("paper", exact=True).check()
    page.get_by_role("button", name="Freeze", exact=True).click()
    slider = page.get_by_label("range 1, saturation, lower", exact=True)
    slider.focus()
    for _ in range(40):
        page.keyboard.press("ArrowRight")
    slider.blur()
    expect(page.locator("[data-panel=mask] img")).to_be_visible()
    expect(page.locator(".effect .hint")).to_contain_text("Medians", timeout=1000 * WAIT_S)
    page.evaluate("() => scrollTo(0, 0)")


def camera_tried(page: Page) -> None:
    """A control of the camera that is tried, during a function check."""
    page.get_by_role("button", name="Begin function check").click()
    field = page.locator("[data-control=exposure_time_absolute] input[type=number]")
    expect(field).to_be_enabled(timeout=1000 * WAIT_S)
    field.fill("30")
    field.press("Enter")
    expect(page.locator("#camera").get_by_role("status")).to_have_text("1 tried", timeout=1000 * WAIT_S)
    expect(page.locator(".tiles .stage img").last).to_be_visible(timeout=1000 * WAIT_S)
    page.wait_for_timeout(2000)


def taught(page: Page) -> None:
    """A teach-in, measured to its end."""
    expect(page.locator(".bay-now")).to_contain_text("MAY MOVE", timeout=1000 * WAIT_S)
    page.locator("#teach-in select").select_option("60")
    page.get_by_role("button", name="Measure this truck").click()
    expect(page.locator("#teach-in .values")).to_be_visible(timeout=1000 * WAIT_S)


@dataclass(frozen=True)
class Shot:
    name: str
    args: tuple[str, ...]  # of `gateway simulate`
    path: str
    moment: Callable[[Page], None]
    width_px: int = 1366
    height_px: int = 900
    theme: Literal["light", "dark"] = "light"


APPROACH = ("--scenario", "approach")
STANDS = ("--scenario", "standing")
FAULTS = ("--scenario", "faults", "--bays", "4")
SHOTS = (
    Shot("operator", APPROACH, "/#bay1", with_trend("MAY MOVE"), height_px=940),
    Shot("operator-stop", APPROACH, "/#bay1", with_trend("IN PLACE", "Loading may start."), height_px=940),
    Shot("operator-dark", APPROACH, "/#bay1", with_trend("MAY MOVE"), height_px=940, theme="dark"),
    Shot("operator-phone", APPROACH, "/#bay1", with_trend("MAY MOVE"), width_px=390, height_px=844),
    Shot("overview", FAULTS, "/", one_in_trouble),
    Shot("technician", APPROACH, "/tune/bay1", tried, width_px=1600, height_px=1000),
    Shot("teach-in", STANDS, "/tune/bay1#teach-in", taught, height_px=860),
    Shot("camera", (*STANDS, "--seed", "2"), "/tune/bay1#camera", camera_tried, height_px=860),
    Shot("driver-forward", APPROACH, "/driver?kiosk=1", of_code("FORWARD"), 960, 540),
    Shot("driver-slow", APPROACH, "/driver?kiosk=1", of_code("SLOW"), 960, 540),
    Shot("driver-ok", APPROACH, "/driver?kiosk=1", of_code("OK"), 960, 540),
)
WEEK = {"manager": ("/manager", ".figure", 7), "history": (f"/history#bay1/{NOON_MS}/day", ".visits tbody tr", 41)}


def take(browser: Browser, shots: list[Shot], folder: Path) -> None:
    """One simulation for those that need the same one."""
    for args in dict.fromkeys(shot.args for shot in shots):
        with Gateway("simulate", "--json", *args, *FREE_PORTS) as gateway:
            url = gateway.started()["hmi"].rstrip("/")
            first_visit(url)
            for shot in (shot for shot in shots if shot.args == args):
                size = {"width_px": shot.width_px, "height_px": shot.height_px}
                with visited(browser, url + shot.path, **size) as (page, watch):  # type: ignore[arg-type]
                    page.emulate_media(color_scheme=shot.theme)
                    shot.moment(page)
                    path = folder / f"hmi-{shot.name}.png"
                    page.screenshot(path=path)
                    assert watch.complaints == []
                print(path)


def take_week(browser: Browser, name: str, path: Path) -> None:
    """Of a week that is prepared: nobody waits for it."""
    address, selector, count = WEEK[name]
    with in_zone(), TemporaryDirectory() as folder:
        records = Path(folder) / "north_works.gateway"
        prepared(records)
        with_pictures(records)
        with Pages(Path(folder)) as pages, visited(browser, pages.url + address, height_px=1200) as (page, watch):
            expect(page.locator(selector)).to_have_count(count)
            if name == "history":
                expect(page.locator(".visits img").first).to_be_visible()
                page.wait_for_timeout(1500)
            page.screenshot(path=path, full_page=name == "manager")
            assert watch.complaints == []
    print(path)


SETTINGS = ("settings", "settings-save")
FILE = "/etc/loading-gateway/gateway.toml"  # in place of the simulation's own


def renamed(page: Page, ours: Path, shown: str) -> None:
    page.evaluate(
        """([ours, shown]) => {
          const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
          while (texts.nextNode()) texts.currentNode.data = texts.currentNode.data.replaceAll(ours, shown);
          for (const field of document.querySelectorAll('input')) field.value = field.value.replaceAll(ours, shown);
        }""",
        [str(ours), shown],
    )


def take_settings(browser: Browser, names: list[str], folder: Path) -> None:
    """Two keys changed, one of them to something that is not allowed; then what a save would change."""
    with (
        TemporaryDirectory() as scratch,
        plant(Path(scratch), STANDING) as running,
        visited(browser, f"{running.url}/setup#bays/bay1/fusion") as (page, watch),
    ):
        page.get_by_label("radius_threshold_px", exact=True).fill("150")
        page.get_by_label("vision_deadline_s", exact=True).fill("30")
        expect(page.get_by_role("alert")).to_have_count(1)
        for name in SETTINGS:
            if name == "settings-save":
                page.get_by_label("vision_deadline_s", exact=True).fill("0.5")
                page.get_by_role("button", name="Look at the changes").click()
                expect(page.locator("pre.diff")).to_be_visible()
            renamed(page, running.config, FILE)
            if name in names:
                page.screenshot(path=folder / f"hmi-{name}.png")
                print(folder / f"hmi-{name}.png")
        assert watch.complaints == []


def take_calibration(browser: Browser, path: Path) -> None:
    """Until every pose was taken, and one of them is there again."""
    with (
        TemporaryDirectory() as scratch,
        board_plant(Path(scratch)) as running,
        visited(browser, f"{running.url}/calibrate/bay1", height_px=1200) as (page, watch),
    ):
        page.get_by_label("inner corners in a row").fill("8")
        page.get_by_label("side of a square").fill("18")
        page.get_by_role("button", name="Begin").click()
        expect(page.locator("[data-view]")).to_have_count(len(POSES), timeout=2000 * WAIT_S)
        expect(page.locator("[data-verdict=similar]")).to_be_visible()
        expect(page.locator("[data-rms]")).to_contain_text(f"over {len(POSES)} views")
        page.evaluate("() => scrollTo(0, 0)")
        page.screenshot(path=path)
        assert watch.complaints == []
    print(path)


NEW_BAY = "new-bay"


def take_new_bay(browser: Browser, path: Path) -> None:
    """The step at which the camera of a bay is looked at: the simulated one, for nothing is plugged in here."""
    with (
        TemporaryDirectory() as scratch,
        plant(Path(scratch), STANDING) as running,
        visited(browser, f"{running.url}/setup/new-bay") as (page, watch),
    ):
        page.get_by_label("bay1").check()
        page.get_by_role("button", name="Next: Camera").click()
        expect(page.locator(".look .figures")).to_contain_text(re.compile(r"rate[1-9].*markerR"), timeout=1000 * WAIT_S)
        page.screenshot(path=path)
        assert watch.complaints == []
    print(path)


TEST_SET = "test-set"


def take_test_set(browser: Browser, path: Path) -> None:
    """Pictures of a truck on its way, labelled as proposed; the tried settings miss those that are far."""
    with (
        TemporaryDirectory() as scratch,
        plant(Path(scratch), TO_AND_FRO, keeps=True) as running,
        visited(browser, f"{running.url}/tune/bay1#test-sets", height_px=1000) as (page, watch),
    ):
        panel = page.locator("#test-sets")
        panel.get_by_label("new set").fill("Dusk")
        panel.get_by_role("button", name="Make").click()
        for number in range(1, 7):
            page.get_by_role("button", name="Live", exact=True).click()
            page.wait_for_timeout(800)
            panel.get_by_role("button", name="Add the frame shown").click()
            expect(panel.get_by_role("heading", name=re.compile(f"000{number}-"))).to_be_visible()
            panel.get_by_role("button", name="Marker here").click()
            expect(panel.get_by_text(f"{number} of them labelled")).to_be_visible()
        panel.get_by_role("button", name="Close").click()
        field = page.locator("#k-min_area_px2-n")
        field.fill("25000")
        field.press("Enter")
        panel.get_by_role("button", name="Score these settings").click()
        expect(panel.locator(".scored")).to_be_visible(timeout=1000 * WAIT_S)
        page.wait_for_timeout(2000)  # until the small pictures are there
        panel.screenshot(path=path)
        assert watch.complaints == []
    print(path)


CALIBRATION = "calibration"


def main() -> None:
    parser = argparse.ArgumentParser(prog="./dev screenshots", description=__doc__)
    known = [*(shot.name for shot in SHOTS), *WEEK, *SETTINGS, NEW_BAY, CALIBRATION, TEST_SET]
    parser.add_argument("names", nargs="*", help=f"of: {', '.join(known)}; none: all")
    parser.add_argument("--folder", type=Path, default=Path("docs/images"))
    args = parser.parse_args()
    strangers = set(args.names) - set(known)
    if strangers:
        parser.error(f"no such picture: {', '.join(sorted(strangers))}")
    with chromium() as browser:
        take(browser, [shot for shot in SHOTS if not args.names or shot.name in args.names], args.folder)
        for name in (name for name in WEEK if not args.names or name in args.names):
            take_week(browser, name, args.folder / f"hmi-{name}.png")
        if wanted := [name for name in SETTINGS if not args.names or name in args.names]:
            take_settings(browser, wanted, args.folder)
        if not args.names or NEW_BAY in args.names:
            take_new_bay(browser, args.folder / f"hmi-{NEW_BAY}.png")
        if not args.names or CALIBRATION in args.names:
            take_calibration(browser, args.folder / f"hmi-{CALIBRATION}.png")
        if not args.names or TEST_SET in args.names:
            take_test_set(browser, args.folder / f"hmi-{TEST_SET}.png")


if __name__ == "__main__":
    main()
