"""A browser for the whole room and, for each test, pages that are watched."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack

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
def started() -> Iterator[ExitStack]:
    """What a test has started and entered here ends after its pages: one whose gateway ends before it complains."""
    with ExitStack() as running:
        yield running


@pytest.fixture
def visit(browser: Browser, watches: list[Watch], started: ExitStack) -> Iterator[Visit]:
    """visit(url, ...): `chromium.visited` until the end of the test."""
    with ExitStack() as open_pages:

        def opened(url: str, **how: object) -> Page:
            page, watch = open_pages.enter_context(chromium.visited(browser, url, **how))  # type: ignore[arg-type]
            watches.append(watch)
            return page

        yield opened
