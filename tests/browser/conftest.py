"""A browser for the whole room and, for each test, pages that are watched."""

from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, Page

from tests.browser import chromium
from tests.browser.chromium import Watch

Visit = Callable[..., Page]


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    with chromium.chromium() as running:
        yield running


@pytest.fixture
def watches() -> Iterator[list[Watch]]:
    """Filled by `visit`, one for each page; a test that expects complaints takes them out."""
    kept: list[Watch] = []
    yield kept
    for watch in kept:
        assert watch.complaints == []


@pytest.fixture
def visit(browser: Browser, watches: list[Watch]) -> Iterator[Visit]:
    """visit(url, width_px=1366, height_px=900) opens a page as a new visitor would: no cookies, nothing cached."""
    contexts = []

    def opened(url: str, width_px: int = 1366, height_px: int = 900) -> Page:
        context = browser.new_context(viewport={"width": width_px, "height": height_px})
        contexts.append(context)
        watch = Watch(urlsplit(url).netloc)
        watch.over(context)
        watches.append(watch)
        page = context.new_page()
        answer = page.goto(url)
        assert answer is not None
        assert answer.ok, f"{url}: {answer.status}"
        return page

    yield opened
    for context in contexts:
        context.close()
