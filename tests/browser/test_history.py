"""The history page on a bay with a recording of known numbers; and where nothing is kept."""

import re
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, Route, expect

from tests.browser import judgements
from tests.browser.chromium import until, visited
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, Plant, plant
from tests.unit.web.history import BEGIN_MS, LATER_MS, VISIT, recorded_in

AT = f"/history#bay1/{BEGIN_MS + 30_000}/hour"
# Share of a canvas's pixels of this colour, by a test of r, g, b.
SHARE = """(canvas, colour) => {
  const { width, height } = canvas;
  const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);
  let count = 0;
  for (let at = 0; at < data.length; at += 4)
    if (data[at + 3] > 200 && colour.every((value, n) => Math.abs(data[at + n] - value) < 3)) count += 1;
  return count / (width * height);
}"""
RED, GREY, BLUE = [176, 0, 22], [93, 102, 108], [91, 114, 133]


def kept(folder: Path) -> None:
    recorded_in(folder / "bay1", visits=2)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant"), STANDING, records=kept, bays=2) as running:
        yield running


@pytest.fixture
def page(site: Plant, visit: Visit) -> Page:
    opened = visit(site.url + AT)
    expect(opened.locator(".visits tbody tr")).to_have_count(1)  # the other one was an hour before
    return opened


def hovered(page: Page, at_ms: int) -> str:
    """What is read at that moment of the timeline of an hour."""
    over = page.locator(".past .u-over").first
    box = over.bounding_box()
    title = page.locator("#past-title").inner_text()
    assert box is not None
    begins = (
        1000 * datetime.fromisoformat(title.split(": ", 1)[1].split(" to ")[0]).timestamp()
    )  # as the gateway's zone
    share = (at_ms - begins) / 3_600_000
    page.mouse.move(box["x"] + share * box["width"], box["y"] + box["height"] / 2)
    return page.locator(".past .read").inner_text()


@pytest.mark.long
def test_hover_reads_the_values_and_a_gap_reads_as_one(page: Page) -> None:
    text = hovered(page, BEGIN_MS + 30_000)
    assert re.search(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\b", text)
    assert re.search(r"R 100 to 180.px, mean 15[45]", text)
    assert re.search(r"Z 300 to 900.mm, mean 600", text)
    assert "stop 30" in text or "stop 29" in text
    assert "nothing recorded" in hovered(page, BEGIN_MS + 5 * 60_000)
    blind = hovered(page, LATER_MS + 30_000)
    assert "vision stale" in blind
    assert "R –" in blind


def test_what_is_drawn_is_what_was_recorded(page: Page) -> None:
    strip = page.locator(".past .strip")
    until(page, lambda: strip.evaluate(SHARE, RED) > 0)
    # One of 60 minutes without the camera, all of the height of one row of four; one half of another in place.
    assert 0.001 < strip.evaluate(SHARE, RED) < 0.02
    assert 0.0005 < strip.evaluate(SHARE, BLUE) < 0.01
    page.get_by_role("button", name="Earlier").click()
    until(page, lambda: strip.evaluate(SHARE, RED) == 0)
    page.get_by_role("button", name="Later").click()
    until(page, lambda: strip.evaluate(SHARE, RED) > 0)
    page.get_by_role("button", name="30 days").click()
    expect(page.get_by_role("button", name="30 days")).to_have_attribute("aria-pressed", "true")
    until(page, lambda: page.evaluate("() => location.hash").endswith("/month"))


def test_visits_are_listed_filtered_and_given_as_a_file(page: Page) -> None:
    page.get_by_role("button", name="day", exact=True).click()
    expect(page.locator(".visits tbody tr")).to_have_count(2)
    newest = page.locator(".visits tbody tr").first
    expect(newest).to_contain_text("(2 times)")
    expect(newest).to_contain_text(re.compile(r"181\.5.px"))
    picture = newest.locator("img")
    until(page, lambda: picture.evaluate("(img) => img.naturalWidth") == 64)
    expect(page.locator(".visits tbody tr").nth(1).locator("img")).to_have_count(0)
    page.get_by_label("which visits").select_option("never")
    expect(page.locator(".visits tbody tr")).to_have_count(0)
    expect(page.locator(".visits")).to_contain_text("No visit fits the filter")
    page.get_by_label("which visits").select_option("faults")
    expect(page.locator(".visits tbody tr")).to_have_count(2)
    with page.expect_download() as download:
        page.locator(".visits").get_by_role("link", name="CSV").click()
    lines = Path(download.value.path()).read_text(encoding="utf-8").splitlines()
    assert len(lines) == 3
    assert str(VISIT.begun_ms) in lines[1]


def test_older_visits_are_searched_on_the_server_and_one_is_taken_away_as_evidence(page: Page) -> None:
    visits, rows = page.locator(".visits"), page.locator(".visits tbody tr")
    visits.get_by_role("button", name="Older").click()
    expect(rows).to_have_count(2)  # the one of an hour before
    expect(visits).to_contain_text("These are all that there are.")
    page.get_by_label("which visits").select_option("dust")
    expect(rows).to_have_count(0)
    expect(visits).to_contain_text("No visit fits the filter")
    page.get_by_label("which visits").select_option("corrected")
    expect(rows).to_have_count(1)
    visits.get_by_role("button", name="Older").click()
    expect(rows).to_have_count(2)
    page.get_by_label("which alarm").select_option("camera_down")
    expect(rows).to_have_count(0)
    page.get_by_label("which alarm").select_option("")
    rows.first.get_by_role("button").click()
    with page.expect_download() as download:
        page.locator(".film").get_by_role("link", name="Evidence").click()
    assert re.fullmatch(r"evidence-bay1-\d{8}T\d{6}\.zip", download.value.suggested_filename)
    with zipfile.ZipFile(download.value.path()) as evidence:
        assert evidence.testzip() is None
        names = {Path(name).name for name in evidence.namelist()}
    assert {"why.html", "verify.txt", "SHA256SUMS"} < names
    assert sum(name.endswith(".pictures") for name in names) == 2


@pytest.mark.long
def test_evidence_is_offered_to_technicians_only(site: Plant, visit: Visit) -> None:
    page = visit(f"{site.url}{AT}")

    def as_viewer(route: Route) -> None:
        told = route.fetch()
        route.fulfill(response=told, json={**told.json(), "role": "viewer"})

    page.route("**/api/session", as_viewer)
    page.reload()
    page.locator(".visits tbody tr").first.get_by_role("button").click()
    expect(page.locator(".film").get_by_role("button", name="Close")).to_be_visible()
    expect(page.locator(".film").get_by_role("link", name="Evidence")).to_have_count(0)


@pytest.mark.long
def test_why_is_told_in_the_pages_language(site: Plant, visit: Visit) -> None:
    page = visit(f"{site.url}{AT}/why")
    expect(page.locator(".why-panel .headline")).to_be_visible()  # the address has been written anew
    page.evaluate("() => localStorage.setItem('gateway.language', 'de')")
    page.reload()
    expect(page.locator(".why-panel .headline")).to_have_text(
        "Für diesen Zeitpunkt ist kein vollständiger Zustand aufgezeichnet"
    )


@pytest.mark.long
def test_a_phone_names_values_in_the_pages_language_and_is_no_narrower_than_the_page(site: Plant, visit: Visit) -> None:
    page = visit(site.url + AT.replace("#", "?lang=de#"), width_px=390, height_px=844)
    expect(page.locator(".visits td[data-name='Dauer']")).to_have_count(1)
    expect(page.get_by_label("welcher Alarm")).to_be_visible()
    assert page.evaluate("() => document.documentElement.scrollWidth") == 390


def test_a_visit_is_a_film(page: Page) -> None:
    page.locator(".visits tbody tr").first.get_by_role("button").click()
    film = page.locator(".film")
    expect(film.locator("img")).to_have_attribute("src", re.compile("/kept-pictures/2/0.jpg"))  # before it was in place
    expect(film.locator(".controls")).to_contain_text("1 of 4")
    until(page, lambda: film.locator("img").evaluate("(img) => img.naturalWidth") == 64)
    film.get_by_role("button", name="Play").click()
    expect(film.locator(".controls")).to_contain_text("4 of 4")
    expect(film.get_by_role("button", name="Play")).to_be_visible()  # it has stopped at the end
    film.get_by_label("picture", exact=True).fill("1")
    expect(film.locator("figcaption")).to_contain_text("frame 78")
    film.get_by_role("button", name="one picture on").click()
    expect(film.locator("figcaption")).to_contain_text("frame 90")
    film.get_by_role("button", name="Close").click()
    expect(film).to_have_count(0)


@pytest.mark.long
def test_a_press_on_one_of_the_last_trucks_asks_why(page: Page) -> None:
    trucks = page.locator(".trucks a")
    expect(trucks).to_have_count(2)
    expect(trucks.first).to_contain_text("(2 times)")
    until(page, lambda: trucks.first.locator("img").evaluate("(img) => img.naturalWidth") == 64)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url) if "/why?" in request.url else None)
    for times in (1, 2):  # the same truck again asks again, whatever was looked at meanwhile
        trucks.first.click()
        until(page, lambda times=times: len(asked) == times)  # type: ignore[misc]
        expect(page.locator(".why-panel .answer")).to_contain_text("No complete state of that moment is recorded")
        page.get_by_role("button", name="hour", exact=True).click()
    assert len(set(asked)) == 1


def test_why_is_asked_of_the_chosen_moment(site: Plant, page: Page) -> None:
    page.get_by_label("moment").fill("")
    page.locator(".events").get_by_role("button").first.click()
    expect(page.locator(".why-panel header")).to_contain_text(re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}"))
    page.get_by_role("button", name="Why?", exact=True).click()
    # The recording has no complete state.
    expect(page.locator(".why-panel")).to_contain_text("No complete state of that moment is recorded")
    report = page.locator(".why-panel").get_by_role("link", name="Report").get_attribute("href")
    assert report is not None
    assert re.search(rf"/api/bays/bay1/why\.html\?at_ms={LATER_MS + 59_000}$", report)


@pytest.mark.long
def test_it_begins_with_the_time_there_is(site: Plant, browser: Browser) -> None:
    """Where minutes are recorded, with minutes; then as this viewer chose."""

    def young(route: Route) -> None:
        answer = route.fetch()
        records = answer.json()
        route.fulfill(response=answer, json=records | {"first_ms": records["last_ms"] - 9 * 60_000})

    with visited(browser, f"{site.url}/login") as (page, watch):
        page.route("**/api/bays/bay1/records", young)
        page.goto(f"{site.url}/history#bay1")
        length = page.get_by_role("group", name="length of the timeline").locator("[aria-pressed=true]")
        expect(length).to_have_text("15 min")
        page.get_by_role("button", name="8 h").click()
        until(page, lambda: page.evaluate("() => location.hash").endswith("/shift"))
        page.goto(f"{site.url}/login")
        page.goto(f"{site.url}/history#bay1")
        expect(length).to_have_text("8 h")
        assert watch.complaints == []


@pytest.mark.long
def test_another_bay_and_an_old_link(site: Plant, page: Page) -> None:
    page.get_by_label("bay", exact=True).select_option("bay2")
    expect(page.locator("h1")).to_contain_text("bay2")
    page.go_back()
    expect(page.locator("h1")).to_contain_text("bay1")


@pytest.mark.long
def test_it_is_accessible_usable_by_keyboard_and_fits(page: Page) -> None:
    page.locator(".visits tbody tr").first.get_by_role("button").click()
    expect(page.locator(".film .controls")).to_contain_text("of 4")
    judgements.accessible(page)
    judgements.usable_by_keyboard(page)
    judgements.usable_when_zoomed(page)
    for width_px in (360, 768, 1366, 1920):
        page.set_viewport_size({"width": width_px, "height": 900})
        page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        judgements.no_sideways_scroll(page)


@pytest.mark.long
def test_where_nothing_is_recorded_it_says_which_key(tmp_path: Path, started: ExitStack, visit: Visit) -> None:
    running = started.enter_context(plant(tmp_path, STANDING))
    page = visit(f"{running.url}/#bay1")
    page.get_by_role("link", name="History").click()
    expect(page.locator("main")).to_contain_text("Nothing is recorded")
    expect(page.locator("main")).to_contain_text("state_dir")
    judgements.accessible(page)
