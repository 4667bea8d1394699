"""Takes the pages' pictures for README and docs anew, from running simulations: `./dev screenshots [NAME ...]`."""

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import Browser, Page, expect

from tests.browser.chromium import chromium, until, visited
from tests.browser.plant import first_visit
from tests.browser.recorded_week import Pages, in_zone, prepared
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
        expect(page.locator(".decision .word")).to_have_text(decision, timeout=1000 * WAIT_S)
        expect(page.locator(".decision .why")).to_contain_text(why, timeout=1000 * WAIT_S)
        page.wait_for_timeout(1500)

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


def at_once(page: Page) -> None:
    page.wait_for_timeout(500)


@dataclass(frozen=True)
class Shot:
    name: str
    args: tuple[str, ...]  # of `gateway simulate`
    path: str
    moment: Callable[[Page], None]
    width_px: int = 1366
    height_px: int = 900
    whole: bool = False  # all of the page, not only what fits into the window


APPROACH = ("--scenario", "approach")
FAULTS = ("--scenario", "faults", "--bays", "4")
SHOTS = (
    Shot("operator", APPROACH, "/#bay1", with_trend("MAY MOVE"), height_px=940),
    Shot("operator-stop", APPROACH, "/#bay1", with_trend("STOP", "in place"), height_px=940),
    Shot("operator-phone", APPROACH, "/#bay1", with_trend("MAY MOVE"), width_px=390, height_px=844),
    Shot("overview", FAULTS, "/", one_in_trouble),
    Shot("technician", APPROACH, "/tune/bay1", tried, width_px=1600, height_px=1000),
    Shot("driver-forward", APPROACH, "/driver", of_code("FORWARD"), 960, 540),
    Shot("driver-slow", APPROACH, "/driver", of_code("SLOW"), 960, 540),
    Shot("driver-ok", APPROACH, "/driver", of_code("OK"), 960, 540),
    Shot("login", APPROACH, "/login", at_once, 960, 540),
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
                    shot.moment(page)
                    path = folder / f"hmi-{shot.name}.png"
                    page.screenshot(path=path, full_page=shot.whole)
                    assert watch.complaints == []
                print(path)


def take_week(browser: Browser, name: str, path: Path) -> None:
    """Of a week that is prepared: nobody waits for it."""
    address, selector, count = WEEK[name]
    with in_zone(), TemporaryDirectory() as folder:
        prepared(Path(folder) / "north_works.gateway")
        with Pages(Path(folder)) as pages, visited(browser, pages.url + address, height_px=1000) as (page, watch):
            expect(page.locator(selector)).to_have_count(count)
            page.screenshot(path=path, full_page=name == "manager")
            assert watch.complaints == []
    print(path)


def main() -> None:
    parser = argparse.ArgumentParser(prog="./dev screenshots", description=__doc__)
    known = [*(shot.name for shot in SHOTS), *WEEK]
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


if __name__ == "__main__":
    main()
