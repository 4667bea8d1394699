"""Who may see what, as a person meets it: the way to the login, a wrong password, both roles, and out again."""

import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from gateway.web.auth.passwords import hashed
from tests.browser import judgements
from tests.browser.chromium import Watch
from tests.browser.conftest import Visit
from tests.browser.plant import Plant, plant
from tests.e2e.test_first_password import NAME, PASSWORD, fresh_gateway

VIEWER, TECHNICIAN = ("olga", "viewer", "spout-and-truck-41"), ("theo", "technician", "lime-kiln-dust-77")
# Chromium tells the console about every answer that is no success.
REFUSED = re.compile(r"the server responded with a status of 40[13]|HTTP Authentication failed")


@pytest.fixture(scope="module")
def bay(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    users = "".join(
        f'[[hmi.users]]\nname = "{name}"\nrole = "{role}"\npassword_hash = "{hashed(password)}"\n'
        for name, role, password in (VIEWER, TECHNICIAN)
    )
    with plant(tmp_path_factory.mktemp("plant"), role="driver", users=users) as running:
        yield running


def log_in(page: Page, name: str, password: str) -> None:
    """As people do: the name is where the cursor stands already."""
    expect(page.get_by_label("Name")).to_be_focused()
    page.keyboard.type(name)
    page.keyboard.press("Tab")
    page.keyboard.type(password)
    page.keyboard.press("Enter")


def test_a_caller_without_a_login_is_redirected_to_it_and_then_to_the_requested_page(bay: Plant, visit: Visit) -> None:
    page = visit(f"{bay.url}/#bay1")
    expect(page).to_have_url(re.compile(r"/login\?next="))
    log_in(page, VIEWER[0], VIEWER[2])
    expect(page.locator(".picture .tag")).to_have_text("LIVE")
    expect(page.get_by_title("viewer")).to_have_text("olga")
    judgements.accessible(page)


def test_what_a_wrong_password_meets(bay: Plant, visit: Visit, watches: list[Watch]) -> None:
    page = visit(f"{bay.url}/login")
    watches[0].excused = REFUSED
    log_in(page, VIEWER[0], "not-her-password")
    trouble = page.get_by_role("alert")
    expect(trouble).to_be_visible()
    expect(page.get_by_label("Password", exact=True)).to_have_value("")
    expect(page.get_by_label("Password", exact=True)).to_be_focused()
    expect(page).to_have_url(re.compile("/login"))
    answer = trouble.inner_text()
    page.get_by_label("Name").fill("nobody-of-this-name")
    page.get_by_label("Password", exact=True).fill("not-a-password")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Log in")).to_be_enabled()
    assert trouble.inner_text() == answer  # whether there is such a user stays untold


def test_a_viewer_sees_and_a_technician_tunes(bay: Plant, visit: Visit, watches: list[Watch]) -> None:
    for (name, _, password), tunes in ((VIEWER, False), (TECHNICIAN, True)):
        page = visit(f"{bay.url}/login?next=/")
        log_in(page, name, password)
        expect(page.locator("header.top")).to_contain_text(name)
        expect(page.get_by_role("link", name="Set up")).to_have_count(int(tunes))
        answer = page.request.get(f"{bay.url}/tune/bay1", max_redirects=0)
        assert answer.ok == tunes


@pytest.mark.long
def test_after_a_logout_nothing_leads_back_to_the_page(bay: Plant, visit: Visit, watches: list[Watch]) -> None:
    """Its links end with the login, too."""
    page = visit(f"{bay.url}/login?next=/history")
    watches[0].excused = REFUSED
    log_in(page, VIEWER[0], VIEWER[2])
    expect(page.locator(".alarmbar")).to_contain_text("alarm")
    page.get_by_role("button", name="Log out").click()
    expect(page).to_have_url(f"{bay.url}/login")
    page.wait_for_timeout(500)
    assert page.url == f"{bay.url}/login"


@pytest.mark.long
def test_the_login_speaks_the_browsers_language_and_remembers_another(bay: Plant, visit: Visit) -> None:
    page = visit(
        f"{bay.url}/login", before="Object.defineProperty(navigator, 'languages', { get: () => ['de-AT', 'en'] })"
    )
    expect(page.locator("html")).to_have_attribute("lang", "de")
    expect(page.get_by_role("button", name="Anmelden")).to_be_visible()
    page.locator(".viewing > button").click()
    page.locator("#viewing select").first.select_option("tr")
    expect(page.locator("html")).to_have_attribute("lang", "tr")
    page.goto(f"{bay.url}/login")
    expect(page.locator("html")).to_have_attribute("lang", "tr")
    expect(page.locator("#name")).to_be_focused()
    judgements.accessible(page)


@pytest.mark.long
def test_an_address_of_no_page_says_so(bay: Plant, visit: Visit, watches: list[Watch]) -> None:
    page = visit(f"{bay.url}/login")
    watches[0].excused = re.compile(r"the server responded with a status of 404")
    page.goto(f"{bay.url}/hystory")
    expect(page.get_by_role("heading")).to_have_text("There is no such page")
    judgements.accessible(page)


@pytest.mark.long
def test_who_may_not_see_a_page_is_told_so(bay: Plant, visit: Visit) -> None:
    page = visit(f"{bay.url}/login")
    log_in(page, VIEWER[0], VIEWER[2])
    expect(page.locator("header.top")).to_contain_text("olga")
    page.goto(f"{bay.url}/setup")
    expect(page.get_by_text("needs a login with more rights")).to_be_visible()


def test_the_first_visitor_makes_the_first_password_and_goes_on_to_set_up(
    tmp_path: Path, visit: Visit, started: ExitStack, watches: list[Watch]
) -> None:
    _, url, _ = started.enter_context(fresh_gateway(tmp_path))
    page = visit(f"{url}/", trusts_all=True)
    watches[0].excused = re.compile(r"a status of 400|net::ERR_|status of 40[19]")  # while its process is replaced, too
    expect(page.get_by_role("heading")).to_have_text("Make the first password")
    expect(page.get_by_role("link")).to_have_count(0)
    for width_px in (390, 1366):
        page.set_viewport_size({"width": width_px, "height": 844})
        judgements.accessible(page)
        judgements.no_sideways_scroll(page)

    def typed(password: str, again: str) -> None:
        page.get_by_label("Name").fill(NAME)
        page.get_by_label("Password", exact=True).fill(password)
        page.get_by_label("the same again").fill(again)
        page.keyboard.press("Enter")

    trouble = page.get_by_role("alert")
    typed(PASSWORD, "another")
    expect(trouble).to_have_text("The two passwords differ.")
    typed("short", "short")
    expect(trouble).to_contain_text("at least 10 are needed")
    typed(PASSWORD, PASSWORD)
    expect(page).to_have_url(f"{url}/setup/new-bay")
    expect(page.locator("header.top")).to_contain_text(NAME)
    page.goto(f"{url}/login")
    expect(page.get_by_role("heading")).to_have_text("Log in to the loading gateway")
    expect(page.get_by_label("the same again")).to_have_count(0)
