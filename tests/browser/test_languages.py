"""The pages for desks in their other languages: chosen by the viewer, remembered, fitting at every width, and complete,
but for what `./dev translations` lists.

`missingTexts` has what a page has looked up and not found in the language's file, since it was loaded.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser import judgements
from tests.browser.chromium import Watch, until
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, Plant, plant
from tests.browser.recorded_week import Pages, in_zone, prepared
from tests.browser.test_pages import PAGES, WIDTHS_PX
from tests.long import mostly_long
from tests.page_texts import of_languages, page_texts
from tests.unit.web.history import BEGIN_MS, recorded_in

SAYS = {"de": "Verlauf", "es": "Historial", "tr": "Geçmiş"}
LOOKED_AT = ("one bay", "technician", "history")


@pytest.fixture(scope="module")
def bay(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with plant(tmp_path_factory.mktemp("plant")) as running:
        yield running


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    """Two bays with a standing truck each, and what was recorded of one."""

    def records(folder: Path) -> None:
        recorded_in(folder / "bay1", visits=2)

    with plant(tmp_path_factory.mktemp("site"), STANDING, records=records, bays=2) as running:
        yield running


@pytest.fixture(scope="module")
def week(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pages]:
    folder = tmp_path_factory.mktemp("records")
    with in_zone():
        prepared(folder / "north_works.gateway")
        with Pages(folder) as pages:
            yield pages


@pytest.mark.parametrize("language", mostly_long(SAYS))
@pytest.mark.parametrize("name", LOOKED_AT)
def test_a_page_in_another_language(bay: Plant, visit: Visit, name: str, language: str) -> None:
    path, ready = PAGES[name]
    address, _, moment = path.partition("#")
    page = visit(f"{bay.url}{address}?lang={language}#{moment}")
    until(page, lambda: page.evaluate(ready))
    expect(page.locator("html")).to_have_attribute("lang", language)
    expect(page.get_by_role("navigation").get_by_role("link").nth(1)).to_have_text(SAYS[language])
    for width_px in WIDTHS_PX:
        page.set_viewport_size({"width": width_px, "height": 900})
        judgements.no_sideways_scroll(page)
    judgements.accessible(page)


def test_the_viewer_chooses_and_the_browser_remembers(bay: Plant, visit: Visit) -> None:
    page = visit(f"{bay.url}/history")
    expect(page.get_by_role("navigation").get_by_role("link").nth(1)).to_have_text("History")
    page.locator(".viewing > button").click()
    page.get_by_label("language").select_option("tr")
    expect(page.get_by_role("navigation").get_by_role("link").nth(1)).to_have_text("Geçmiş")
    page.goto(f"{bay.url}/")
    expect(page.get_by_role("navigation").get_by_role("link").nth(1)).to_have_text("Geçmiş")
    page.locator(".viewing > button").click()
    page.get_by_label("görünüm").select_option("dark")
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.reload()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")


def test_the_tabs_title_the_brand_and_words_of_two_letters_are_translated(bay: Plant, visit: Visit) -> None:
    page = visit(f"{bay.url}/history?lang=de#bay1")
    expect(page).to_have_title(re.compile("Verlauf von bay1$"))
    expect(page.locator(".brand")).to_have_text("Ladeplätze")
    page = visit(f"{bay.url}/?lang=de#bay1")
    expect(page.locator(".brand")).to_contain_text("north_works")
    expect(page.get_by_text("Restweg", exact=True)).to_be_visible()
    expect(page.get_by_text("nein", exact=True).first).to_be_visible()
    expect(page.locator("p[role=status]").first).to_have_text(re.compile("^bay1: (HALT|DARF FAHREN|IN POSITION)[.]"))


def opened(visit: Visit, url: str, language: str, ready: str) -> Page:
    address, _, place = url.partition("#")
    page = visit(f"{address}{'&' if '?' in address else '?'}lang={language}#{place}")
    until(page, lambda: page.evaluate(ready))
    expect(page.locator("html")).to_have_attribute("lang", language)
    return page


def complete(page: Page) -> None:
    """Nothing of what was drawn so far is missing in the language's file, but what `./dev translations` lists."""
    listed = page_texts() - of_languages()[page.evaluate("() => document.documentElement.lang")]
    assert set(page.evaluate("() => [...globalThis.missingTexts]")) <= listed


def unfold(page: Page) -> None:
    page.evaluate("() => document.querySelectorAll('details').forEach((one) => { one.open = true; })")


def operator(page: Page) -> None:
    unfold(page)
    expect(page.locator(".registers tbody tr").nth(50)).to_be_attached()
    expect(page.locator(".events tbody tr").first).to_be_attached()


def technician(page: Page) -> None:
    """All that is tried: a picture with its times, a clip, its colours; and a function check."""
    unfold(page)
    expect(page.locator(".pictures > p.sr")).not_to_be_empty()  # with times
    page.locator(".check button").click()
    expect(page.locator(".check.warn")).to_be_visible()
    page.locator(".source button").nth(2).click()
    expect(page.locator(".effect .trace")).to_be_visible()
    expect(page.locator(".tiles.elsewhere")).to_have_count(0)
    page.locator(".picture canvas").click()
    expect(page.locator("#picked .swatch")).to_be_visible()
    page.locator("#save").click()
    expect(page.locator("dialog")).to_be_visible()
    page.keyboard.press("Escape")
    page.locator(".check.warn .primary").click()  # asks
    page.locator("dialog .primary").click()
    expect(page.locator(".check.warn")).to_have_count(0)


def labelled_set(page: Page) -> None:
    """One picture, labelled and scored; and the set is deleted."""
    unfold(page)
    page.locator("#new-set").fill("dusk")
    page.locator("#new-set").press("Enter")
    page.locator(".test-sets > .row").nth(1).get_by_role("button").first.click()
    page.locator(".labelling .overlay").press("+")  # where the robust method proposes none, it begins in the middle
    page.locator(".labelling .primary").click()
    expect(page.locator(".setscore .primary")).to_be_enabled()
    page.locator(".setscore .primary").click()
    expect(page.locator(".setscore .scored")).to_be_visible()
    page.locator(".test-sets > .row").first.get_by_role("button").last.click()
    page.locator(".test-sets .primary").first.click()
    expect(page.locator(".setscore")).to_have_count(0)


def calibration(page: Page) -> None:
    page.locator(".board .primary").click()
    expect(page.locator(".live [data-verdict=not_found]")).to_be_visible()
    page.locator(".outcome > p button").click()
    expect(page.locator(".board form")).to_be_visible()


def settings(page: Page) -> None:
    """Every section, a search, a wrong value, a change; and the doctor."""
    places = page.locator(".tree .wide a").evaluate_all("(all) => all.map((one) => one.getAttribute('href'))")
    assert len(places) > 20
    for place in places:
        page.evaluate("(place) => { location.hash = place; }", place)
        expect(page.locator(f'.tree [aria-current="page"][href="{place}"]')).to_be_attached()
    page.evaluate("() => { location.hash = 'fusion'; }")
    page.locator(".tree input[type=search]").fill("cross_check")
    expect(page.locator(".content h2 + .keys .key").first).to_be_visible()
    page.locator(".tree input[type=search]").fill("")
    field = page.locator("[data-key='fusion.radius_threshold_px'] input")
    for wrong in ("x", "-5"):
        field.fill(wrong)
        expect(page.locator(".fault")).to_be_visible()
    field.fill("97")
    page.locator(".setup-page > .bar .primary").click()
    expect(page.locator("dialog .diff")).to_be_visible()
    page.keyboard.press("Escape")
    page.evaluate("() => { location.hash = 'doctor'; }")
    page.locator(".doctor button").click()
    expect(page.locator(".findings li").first).to_be_visible()
    page.locator(".setup-page > .bar button").first.click()  # taken back


def new_bay(page: Page) -> None:
    page.locator(".choices label").last.click()
    for step in (1, 2):
        page.locator(".steps button").nth(step).click()
        if page.locator(".steps button").nth(step + 1).is_disabled():
            break
    expect(page.locator("form.field")).to_be_visible()


def history(page: Page) -> None:
    expect(page.locator(".visits tbody tr")).to_have_count(1)
    page.locator(".visits tbody button").click()
    expect(page.locator(".film")).to_be_visible()
    page.locator(".why-panel .primary").click()
    expect(page.locator(".why-panel").locator(".answer, .notice").first).to_be_visible()


def login(page: Page) -> None:
    page.locator("#name").fill("nobody")
    page.locator("#password").fill("nothing at all")
    page.keyboard.press("Enter")
    expect(page.locator(".notice.bad")).to_be_visible()


def looked(_: Page) -> None:
    """It is drawn, and that is all."""


OF_SITE: dict[str, tuple[str, str, Callable[[Page], None]]] = {
    "all bays": (*PAGES["all bays"], looked),
    "one bay": (*PAGES["one bay"], operator),
    "technician": (*PAGES["technician"], technician),
    "test set": (*PAGES["technician"], labelled_set),
    "calibration": (*PAGES["calibration"], calibration),
    "settings": (*PAGES["settings"], settings),
    "history": (f"/history#bay1/{BEGIN_MS + 30_000}/hour", "() => document.querySelector('.visits') !== null", history),
    "driver": (*PAGES["driver"], looked),
}


@pytest.mark.long
@pytest.mark.parametrize("language", SAYS)
@pytest.mark.parametrize("name", OF_SITE)
def test_a_page_has_every_text_in_another_language(
    site: Plant, visit: Visit, watches: list[Watch], name: str, language: str
) -> None:
    """It is used in one of them: all look up the same texts."""
    address, ready, use = OF_SITE[name]
    page = opened(visit, site.url + address, language, ready)
    if name == "calibration":  # it is ended while a look may be under way
        watches[0].excused = re.compile("409")
    if language == "de":
        use(page)
    complete(page)


@pytest.mark.long
@pytest.mark.parametrize("language", SAYS)
def test_the_page_that_sets_up_a_bay_has_every_text_in_another_language(
    bay: Plant, visit: Visit, language: str
) -> None:
    page = opened(visit, f"{bay.url}/setup/new-bay?new", language, PAGES["new bay"][1])
    new_bay(page)
    complete(page)


@pytest.mark.long
@pytest.mark.parametrize("language", SAYS)
def test_the_managers_page_has_every_text_in_another_language(week: Pages, visit: Visit, language: str) -> None:
    page = opened(visit, f"{week.url}/manager", language, "() => document.querySelectorAll('.figure').length === 7")
    complete(page)


@pytest.mark.long
@pytest.mark.parametrize("language", SAYS)
def test_the_login_has_every_text_in_another_language(
    bay: Plant, visit: Visit, watches: list[Watch], language: str
) -> None:
    page = opened(visit, f"{bay.url}/login", language, PAGES["login"][1])
    watches[0].excused = re.compile("401")
    login(page)
    complete(page)
