"""The watch itself: each fault that it is there for is put into a page, and must be noticed."""

import functools
import threading
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser import judgements
from tests.browser.chromium import SERVER_GONE, Watch, until
from tests.browser.conftest import Visit

PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>A page</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,"><style>{style}</style></head>
<body><main><h1>A page</h1>{body}<p id="answer" role="status"></p></main>
<script>{script}; document.querySelector('#answer').textContent = 'ready';</script></body></html>"""
CONTROLS = """<a href="/">home</a> <button>go</button>
<label>from <input type="range" id="low"></label>
<fieldset><legend>which</legend><label><input type="radio" name="r" checked>a</label>
<label><input type="radio" name="r">b</label></fieldset>"""
TRAP = """<button onkeydown="event.preventDefault()">trap</button><button>never</button>"""

Site = Callable[..., str]


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Not on the terminal."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """site(body, script, style) is the address of such a page."""
    folder: Path = tmp_path_factory.mktemp("site")
    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()

        def address(body: str = CONTROLS, script: str = "", style: str = "") -> str:
            name = f"{len(list(folder.iterdir()))}.html"
            (folder / name).write_text(PAGE.format(body=body, script=script, style=style))
            return f"http://127.0.0.1:{server.server_port}/{name}"

        yield address
        server.shutdown()
        thread.join(10)


def ready(page: Page) -> Page:
    expect(page.locator("#answer")).to_have_text("ready")
    return page


def test_a_good_page_passes_every_judgement(visit: Visit, site: Site, watches: list[Watch]) -> None:
    page = ready(visit(site()))
    judgements.accessible(page)
    judgements.no_sideways_scroll(page)
    assert judgements.usable_by_keyboard(page) == ["home", "go", "", ""]
    assert watches[0].requests >= 1


@pytest.mark.long
@pytest.mark.parametrize(
    ("script", "expected"),
    [
        ("console.error('broken')", "console: broken"),
        ("setTimeout(() => { throw new Error('thrown late') }, 0)", "thrown late"),
        ("Promise.reject(new Error('unheard'))", "unheard"),
        ("fetch('/nothing-here')", "404"),
        ("fetch('http://192.0.2.1/').catch(() => {})", "a request to http://192.0.2.1/"),
        ("new Image().src = 'http://fonts.example/a.png'", "a request to http://fonts.example/a.png"),
        ("new WebSocket('ws://127.0.0.2:1/')", "a request to ws://127.0.0.2:1/"),
        ("document.body.append(Object.assign(document.createElement('iframe'), {src: 'http://example.org/'}))",
         "a request to http://example.org/"),
    ],
)  # fmt: skip
def test_what_a_page_may_not_do_is_noticed(
    visit: Visit, site: Site, watches: list[Watch], script: str, expected: str
) -> None:
    page = visit(site(script=script))
    (watch,) = watches
    until(page, lambda: any(expected in complaint for complaint in watch.complaints))
    watches.clear()  # and they are no fault of the test


def test_a_lost_server_is_excused_only_when_the_test_ended_it(visit: Visit, site: Site, watches: list[Watch]) -> None:
    page = ready(visit(site()))
    (watch,) = watches
    watch.host = "127.0.0.1:1"  # where nobody listens
    refused = "() => fetch('http://127.0.0.1:1/', {mode: 'no-cors'}).catch(() => console.error('heard it'))"
    for watch.excused, console in ((SERVER_GONE, []), (None, ["net::ERR_"])):
        watch.complaints.clear()
        page.evaluate(refused)
        until(page, lambda: any("heard it" in complaint for complaint in watch.complaints))
        others = [complaint for complaint in watch.complaints if "heard it" not in complaint]
        assert len(others) == len(console)
        assert all(part in complaint for part, complaint in zip(console, others, strict=True))
    watches.clear()


@pytest.mark.long
@pytest.mark.parametrize(
    ("judge", "body", "style", "expected"),
    [
        (judgements.accessible, "<img src='data:,'><p style='color:#ccc'>pale</p>", "", "color-contrast"),
        (judgements.no_sideways_scroll, "<div style='width:2000px'>wide</div>", "", "2000"),
        (judgements.no_word_is_cut, "<p style='width:3em; overflow-wrap:anywhere'>whole indivisible</p>", "", "indiv"),
        (judgements.usable_by_keyboard, CONTROLS, "*:focus { outline: none }", "nothing shows"),
        (
            judgements.usable_by_keyboard,
            CONTROLS + "<a href='/' tabindex='1'>first</a>",
            "",
            "a tab order of their own",
        ),
        (judgements.usable_by_keyboard, CONTROLS + TRAP, "", "not reached by Tab"),
        (judgements.usable_by_keyboard, "<p>words</p>", "", "nothing on this page"),
    ],
)
def test_a_fault_that_a_person_would_meet_is_noticed(
    visit: Visit, site: Site, judge: Callable[[Page], object], body: str, style: str, expected: str
) -> None:
    page = ready(visit(site(body=body, style=style)))
    with pytest.raises(AssertionError, match=expected):
        judge(page)
