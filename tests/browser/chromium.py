"""One real browser, and a watch over what the pages in it do. Nothing here knows the gateway."""

import contextlib
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from playwright.sync_api import (
    Browser,
    BrowserContext,
    ConsoleMessage,
    Page,
    Request,
    WebError,
    WebSocket,
    expect,
    sync_playwright,
)

# Debian's: the whole engine without the windows, tabs and menus round it, which take four times as long to start.
EXECUTABLE = Path("/usr/bin/chromium-headless-shell")
FLAGS = (
    "--no-sandbox",  # the tests run as root in containers, too
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",  # what a page should not ask is not asked on a wire
)
PATIENCE_MS = 45_000.0  # for a busy machine; every wait ends as soon as it can
SERVER_GONE = re.compile(r"net::ERR_|WebSocket (connection|is)|Failed to fetch")


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    """Headless, with a new and empty profile that is removed in the end."""
    with sync_playwright() as playwright:
        expect.set_options(timeout=PATIENCE_MS)
        browser = playwright.chromium.launch(executable_path=EXECUTABLE, headless=True, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


@dataclass
class Watch:
    """What pages may not do: write an error to the console, throw, or ask any host but `host`."""

    host: str  # with its port
    complaints: list[str] = field(default_factory=list)
    requests: int = 0
    excused: re.Pattern[str] | None = None  # what the console may say, in a test that provokes it

    def over(self, context: BrowserContext) -> None:
        context.set_default_timeout(PATIENCE_MS)
        context.on("console", self._console)
        context.on("weberror", self._thrown)
        context.on("request", self._asked)
        context.on("page", lambda page: page.on("websocket", self._connected))

    def _console(self, message: ConsoleMessage) -> None:
        if message.type != "error":
            return
        if self.excused is not None and self.excused.search(message.text):
            return
        self.complaints.append(f"console: {message.text} ({message.location})")

    def _thrown(self, error: WebError) -> None:
        self.complaints.append(f"thrown: {error.error}")

    def _asked(self, request: Request) -> None:
        self._to(request.url)

    def _connected(self, socket: WebSocket) -> None:
        self._to(socket.url)

    def _to(self, url: str) -> None:
        self.requests += 1
        found = urlsplit(url)
        if found.scheme in ("data", "blob"):  # made in the page itself
            return
        if found.netloc != self.host:
            self.complaints.append(f"a request to {url}")


@contextlib.contextmanager
def visited(
    browser: Browser,
    url: str,
    *,
    width_px: int = 1366,
    height_px: int = 900,
    before: str = "",
    trusts_all: bool = False,
) -> Iterator[tuple[Page, Watch]]:
    """The page as a new visitor sees it: no cookies, nothing cached. `before`: a script to run first.
    `trusts_all`: as after the question whether to trust a certificate that nobody has signed.

    Whoever uses this looks into the watch's complaints in the end.
    """
    context = browser.new_context(viewport={"width": width_px, "height": height_px}, ignore_https_errors=trusts_all)
    try:
        watch = Watch(urlsplit(url).netloc)
        watch.over(context)
        if before:
            context.add_init_script(before)
        page = context.new_page()
        answer = page.goto(url)
        assert answer is not None
        assert answer.ok, f"{url}: {answer.status}"
        yield page, watch
    finally:
        context.close()


def until(page: Page, fact: Callable[[], object], timeout_s: float = PATIENCE_MS / 1000) -> None:
    """Wait until `fact` holds, while the page goes on (a plain sleep would keep its messages from being heard)."""
    deadline = time.monotonic() + timeout_s
    while not fact():
        assert time.monotonic() < deadline, f"not so in {timeout_s} s"
        page.wait_for_timeout(20)


def end_function_check(page: Page) -> None:
    """On the technician's page: asked for, and confirmed."""
    page.get_by_role("button", name="End function check…").click()
    page.get_by_role("dialog").get_by_role("button", name="End function check").click()
