"""The manager's page: the figures of a recorded week, days to choose, paper, and what it says where nothing is."""

import csv
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser import judgements
from tests.browser.chromium import visited
from tests.browser.conftest import Visit
from tests.browser.recorded_week import FAULTS, TRUCKS, Pages, Week, in_zone, prepared
from tests.browser.test_pages import WIDTHS_PX

A4_PT = (595, 842)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Pages, Week]]:
    folder = tmp_path_factory.mktemp("records")
    with in_zone():
        week = prepared(folder / "north_works.gateway")
        with Pages(folder) as pages:
            yield pages, week


@pytest.fixture
def week(served: tuple[Pages, Week]) -> Week:
    return served[1]


@pytest.fixture
def page(served: tuple[Pages, Week], visit: Visit) -> Page:
    opened = visit(f"{served[0].url}/manager")
    expect(opened.locator(".figure")).to_have_count(7)
    return opened


def figures(page: Page) -> dict[str, str]:
    """By name, as people read them."""
    return dict(
        page.locator(".figure").evaluate_all(
            "(all) => all.map((one) => [one.querySelector('dt').textContent, one.querySelector('dd').textContent])"
        )
    )


def panel(page: Page, title: str) -> str:
    return page.get_by_role("region", name=title, exact=True).inner_text()


def test_the_week_in_short_and_day_by_day(page: Page, week: Week) -> None:
    expect(page.get_by_role("heading", level=1)).to_have_text("bay1: what the bay did")
    expect(page.locator(".head")).to_contain_text("2026-11-17 to 2026-11-23 · 7 days of Europe/Berlin")
    expect(page.locator(".head")).to_contain_text("made 2026-11-23 15:42:20")  # the browser's own zone is another
    told = figures(page)
    assert told["Trucks"] == str(sum(TRUCKS)) == str(sum(week.trucks))
    assert told["Corrections"] == f"{week.corrections / sum(TRUCKS):.2f}"
    fault_s = sum(60 * length for _, length in FAULTS.values())
    assert told["Availability"].replace("\u202f", "") == f"{100 * (1 - fault_s / week.recorded_s):.1f}%"
    passed_s = 6 * 86_400 + 15.7 * 3600 + 20
    assert told["Recorded"].replace("\u202f", "") == f"{100 * week.recorded_s / passed_s:.1f}%"
    rows = page.get_by_role("region", name="Day by day").locator("tbody tr")
    expect(rows).to_have_count(7)
    assert [int(text) for text in rows.locator("[data-name=trucks]").all_inner_texts()] == [n for n in TRUCKS if n]
    expect(rows.nth(5)).to_contain_text("2026-11-22 Sun")
    expect(rows.nth(5)).to_contain_text("not recorded")
    expect(rows.nth(2).locator("[data-name='not recorded']")).to_have_text(re.compile(r"^5\.0\sh$"))


def test_pictures_show_what_the_numbers_say(page: Page, week: Week) -> None:
    bars = page.get_by_role("img", name="Trucks of each day")
    assert bars.locator(".total").all_text_contents() == [str(count) for count in TRUCKS if count]
    expect(bars.get_by_text("2026-11-22: not recorded")).to_have_count(1)
    heights = bars.locator("rect.part[fill='var(--value)']").evaluate_all(
        "(all) => all.map((bar) => Number(bar.getAttribute('height')))"
    )
    placed = [
        int(text)
        for text in page.get_by_role("region", name="Day by day").locator("[data-name='in place']").all_inner_texts()
    ]
    assert sum(placed) == week.placed
    assert heights == pytest.approx([heights[0] * count / placed[0] for count in placed])


@pytest.mark.long
def test_stops_by_cause_the_longest_first(page: Page, week: Week) -> None:
    faults = page.get_by_role("table", name="Faults that stopped the bay, the longest first").locator("tbody tr")
    assert faults.locator("th").all_inner_texts() == ["camera down", "ranger down", "sensors disagree", "vision stale"]
    assert [text.split(",")[1].strip() for text in faults.locator("td.value").all_inner_texts()] == [
        "2×",
        "1×",
        "1×",
        "1×",
    ]
    assert faults.last.locator("td").last.inner_text().replace("\u202f", "") == "100%"
    causes = page.get_by_role("region", name="Stops by cause").locator("table.stack tbody tr")
    seconds = [int(text.replace("\u202f", "")) for text in causes.locator("[data-name=seconds]").all_inner_texts()]
    assert seconds == sorted((round(length) for length in week.stop_s.values()), reverse=True)


@pytest.mark.long
def test_alarms_beside_the_standard(page: Page, week: Week) -> None:
    alarms = page.get_by_role("region", name="Alarms", exact=True)
    expect(alarms).to_contain_text("ANSI/ISA-18.2-2016")
    rate = alarms.locator("[data-figure=per_hour]")
    expect(rate).to_contain_text(f"{week.alarms / (week.recorded_s / 3600):.2f}")
    expect(rate).to_contain_text("up to 6; at most 12")
    expect(rate).to_contain_text("acceptable")
    expect(alarms.get_by_role("table", name="The most frequent alarms")).to_contain_text("Camera down")


@pytest.mark.long
def test_days_are_chosen_and_stand_in_the_address(page: Page) -> None:
    page.get_by_label("from", exact=True).fill("2026-11-18")
    page.get_by_label("to", exact=True).fill("2026-11-18")
    expect(page.locator(".figure dd.value").first).to_have_text("41")
    assert page.url.endswith("/manager?bay=bay1&from=2026-11-18&to=2026-11-18")
    page.reload()
    expect(page.locator(".figure dd.value").first).to_have_text("41")
    page.get_by_role("button", name="Yesterday").click()
    expect(page.get_by_text("Nothing is recorded of these days.")).to_be_visible()
    expect(page.locator("main")).to_contain_text("from 2026-11-17 00:00:00 to 2026-11-23 15:42:00")
    page.go_back()
    expect(page.locator(".figure dd.value").first).to_have_text("41")
    page.get_by_role("combobox", name="bay").select_option("bay2")
    expect(page.get_by_text("There are no records of bay2 yet")).to_be_visible()


COVERED = """() => {
  const boxes = [...document.querySelectorAll('.manager .panel')].map((one) => one.getBoundingClientRect());
  const [top, left] = [Math.min(...boxes.map((box) => box.top)), Math.min(...boxes.map((box) => box.left))];
  const [end, right] = [Math.max(...boxes.map((box) => box.bottom)), Math.max(...boxes.map((box) => box.right))];
  const head = document.querySelector('.head').getBoundingClientRect().height;
  const panels = boxes.reduce((sum, box) => sum + box.width * box.height, 0);
  return [panels / ((right - left) * (end - top - head)), (right - left) / innerWidth];
}"""


@pytest.mark.long
def test_a_wide_screen_has_no_half_empty_rows(page: Page) -> None:
    for width_px, height_px, across in ((1366, 768, 0.97), (1920, 1080, 0.85), (3840, 2160, 0.98)):
        page.set_viewport_size({"width": width_px, "height": height_px})
        page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        covered, wide = page.evaluate(COVERED)
        assert covered > 0.95, width_px  # the rest is the room between panels
        assert wide > across, width_px


VOID_PX = """() => {
  const bottom = (at) => at.getBoundingClientRect().bottom;
  const panels = [...document.querySelectorAll('.manager > .panel, .pile > .panel')];
  return Math.max(...panels.map((panel) => bottom(panel) - Math.max(...[...panel.children].map(bottom))));
}"""


@pytest.mark.long
@pytest.mark.parametrize(("width_px", "most_px"), [(1366, 100), (1920, 100)])
def test_no_panel_is_half_empty(page: Page, width_px: int, most_px: float) -> None:
    page.set_viewport_size({"width": width_px, "height": 900})
    page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
    assert page.evaluate(VOID_PX) < most_px


@pytest.mark.long
def test_figures_of_few_trucks_are_grey_and_say_of_how_many(page: Page) -> None:
    """A median of nine looks unlike one of three hundred; what is counted over time does not."""
    few = page.locator(".figure.few")
    expect(few).to_have_count(0)
    expect(page.locator("[data-few]")).to_have_count(2)  # the saturday, in both pictures
    page.goto(page.url.split("?")[0] + "?bay=bay1&from=2026-11-21&to=2026-11-21&units=imperial")
    expect(few.locator("dt")).to_have_text(["Time to position", "Spread of Z in place"])
    expect(few.locator(".tag")).to_have_text(["n = 9", "n = 9"])
    expect(few.nth(1)).to_contain_text(re.compile(r"0\.2\sin"))
    muted = page.locator(".muted").first.evaluate("(one) => getComputedStyle(one).color")
    assert few.locator("dd.value").first.evaluate("(one) => getComputedStyle(one).color") == muted
    accuracy = page.get_by_role("region", name="Accuracy").locator("tbody tr")
    expect(accuracy.nth(2)).to_have_class("few")
    expect(accuracy.nth(2)).to_contain_text("Distance Z, in")
    for label in ("Distance of the trucks when last in place, each day", "Trucks of each day"):
        marks = page.get_by_role("img", name=label).locator(".axes text[text-anchor=end]").all_text_contents()
        assert len(set(marks)) == len(marks) >= 3, marks


@pytest.mark.long
def test_the_file_has_the_same_days(page: Page, tmp_path: Path) -> None:
    with page.expect_download() as waiting:
        page.get_by_role("link", name="CSV").click()
    path = tmp_path / "statistics.csv"
    waiting.value.save_as(path)
    assert waiting.value.suggested_filename == "statistics-bay1-2026-11-17-to-2026-11-23.csv"
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["trucks"]) for row in rows] == list(TRUCKS)
    assert rows[0]["begin"] == "2026-11-17T00:00:00+01:00"


@pytest.mark.long
def test_a_week_is_two_sheets_of_a4(page: Page) -> None:
    pdf = page.pdf(prefer_css_page_size=True, print_background=True)
    assert len(re.findall(rb"/Type\s*/Page[^s]", pdf)) == 2
    (box, *_) = re.findall(rb"/MediaBox\s*\[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert tuple(map(float, box)) == pytest.approx(A4_PT, abs=1)
    page.emulate_media(media="print")
    expect(page.get_by_role("button", name="Print")).to_be_hidden()
    expect(page.locator(".top")).to_be_hidden()
    assert panel(page, "Day by day").count("2026-11-") == 7
    assert page.evaluate("() => getComputedStyle(document.documentElement).backgroundColor") == "rgb(255, 255, 255)"


@pytest.mark.long
def test_a_month_of_which_most_days_were_not_recorded_is_a_small_file(served: tuple[Pages, Week], page: Page) -> None:
    page.goto(f"{served[0].url}/manager?from=2026-11-01&to=2026-11-30")
    expect(page.locator(".days .blank").first).to_be_visible()
    assert len(page.pdf(prefer_css_page_size=True, print_background=True)) < 2_000_000


@pytest.mark.long
def test_it_is_accessible_and_fits_into_every_width(page: Page) -> None:
    judgements.accessible(page)
    judgements.usable_by_keyboard(page)
    judgements.usable_when_zoomed(page)
    judgements.still_where_motion_is_not_wanted(page)
    for width_px in WIDTHS_PX:
        page.set_viewport_size({"width": width_px, "height": 900})
        page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        judgements.no_sideways_scroll(page)


def test_times_of_every_page_are_of_the_gateways_zone(served: tuple[Pages, Week], visit: Visit) -> None:
    """Which it names; the browser's own is another."""
    noon_ms = 1_794_999_600_000  # 2026-11-18 12:00 in Berlin
    page = visit(f"{served[0].url}/history#bay1/{noon_ms}/day")
    expect(page.get_by_role("heading", level=1)).to_have_text("bay1: 2026-11-18 00:00:00 to 2026-11-19 00:00:00")
    expect(page.get_by_label("moment", exact=True)).to_have_value(re.compile("^2026-11-18T12:00"))
    page.get_by_label("moment", exact=True).fill("2026-11-18T13:00:00")
    page.get_by_label("moment", exact=True).press("Enter")
    expect(page).to_have_url(re.compile(f"{noon_ms + 3_600_000}"))
    for path in ("/", "/history", "/manager", "/manual"):
        page.goto(f"{served[0].url}{path}")
        expect(page.locator("header.top")).to_contain_text("Times: Europe/Berlin, UTC+1")


@pytest.mark.long
def test_the_bay_is_kept_from_task_to_task(served: tuple[Pages, Week], visit: Visit) -> None:
    page = visit(f"{served[0].url}/#bay2")
    tasks = page.get_by_role("navigation", name="pages")
    expect(tasks.get_by_role("link")).to_have_text(["Live", "History", "Report", "Manual"])  # a viewer's
    expect(page.get_by_role("heading", level=1)).to_have_text("bay2")
    tasks.get_by_role("link", name="History").click()
    expect(page).to_have_url(re.compile("/history#bay2"))
    tasks.get_by_role("link", name="Report").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("bay2: what the bay did")
    tasks.get_by_role("link", name="Manual").click()  # a page of no bay
    expect(page.locator("article")).to_be_visible()
    tasks.get_by_role("link", name="Live").click()
    expect(page).to_have_url(f"{served[0].url}/#bay2")
    tasks.get_by_role("link", name="Live").click()
    expect(page.get_by_role("heading", name="All bays")).to_be_visible()


@pytest.mark.long
def test_where_nothing_is_recorded_it_says_what_to_set(browser: Browser, tmp_path: Path) -> None:
    with (
        Pages(tmp_path, recorded=False) as pages,
        visited(browser, f"{pages.url}/login") as (page, watch),
    ):
        watch.excused = re.compile("503")
        page.goto(f"{pages.url}/manager")
        told = page.get_by_role("alert")
        expect(told).to_contain_text("There are no figures to show")
        expect(told).to_contain_text('state_dir = "/var/lib/loading-gateway"')
        expect(page.get_by_role("link", name="CSV")).to_have_count(0)
        judgements.accessible(page)
        assert watch.complaints == []
