"""The manual: the pages of docs/, rendered on the gateway, for a plant has no internet.

Only files that were found at the start are opened, whatever an address names; HTML in a page is shown as text.
"""

import re
from collections import Counter
from functools import cache
from html import escape
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, Response

from gateway.web.auth.access import Level
from gateway.web.auth.addresses import Addresses
from gateway.web.auth.page_files import missing_page, placed

ADDRESSES = Addresses()
PACKAGE = Path(str(files("gateway")))
FOLDER = PACKAGE / "manual" if (PACKAGE / "manual").is_dir() else PACKAGE.parent / "docs"  # installed; a checkout
PAGES = {path.stem: path for path in FOLDER.glob("*.md")}
IMAGES = {path.name: path for path in FOLDER.glob("images/*")}
FRAME = (PACKAGE / "web" / "static" / "manual.html").read_text(encoding="utf-8")
MARKDOWN = MarkdownIt("js-default")  # with tables, without HTML
COMMENT = re.compile(r"<!--.*?-->\n?|<br>", re.DOTALL)  # marks of generated parts; breaks in cells of tables


@cache
def html(name: str) -> str:
    """The page of docs/ with this name. Raises KeyError."""
    tokens = MARKDOWN.parse(COMMENT.sub(" ", PAGES[name].read_text(encoding="utf-8")))
    for opening, anchor in anchors(tokens):
        opening.attrSet("id", anchor)
    for token in tokens:
        token.attrs.pop("style", None)  # of aligned columns; the pages' Content-Security-Policy refuses it
        for part in token.children or ():
            _lead_to_the_manual(part)
    return _framed(title(name), MARKDOWN.renderer.render(tokens, MARKDOWN.options, {}))


@cache
def contents() -> str:
    """The list of all pages, the technician's first."""
    names = sorted(PAGES, key=lambda name: (name != "technician", title(name).casefold()))
    entries = "".join(f'<li><a href="/manual/{name}">{escape(title(name))}</a></li>' for name in names)
    return _framed("Manual", f"<h1>Manual</h1><ul>{entries}</ul>")


def title(name: str) -> str:
    with PAGES[name].open(encoding="utf-8") as page:
        return page.readline().removeprefix("# ").strip()


def anchors(tokens: list[Token]) -> list[tuple[Token, str]]:
    """Each heading's token, and the name by which links reach it: as GitHub makes it."""
    used: Counter[str] = Counter()
    found = []
    for opening, text in pairwise(tokens):
        if opening.type == "heading_open":
            words = "".join(part.content for part in text.children or ())
            name = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
            found.append((opening, f"{name}-{used[name]}" if used[name] else name))
            used[name] += 1
    return found


def _lead_to_the_manual(part: Token) -> None:
    """What a link or a picture leads to: a page here, its place, or an address; what isn't served is plain text."""
    key = {"link_open": "href", "image": "src"}.get(part.type)
    if key is None:
        return
    path, mark, place = str(part.attrs[key]).partition("#")
    if path.removesuffix(".md") in PAGES:
        part.attrs[key] = f"/manual/{path.removesuffix('.md')}{mark}{place}"
    elif path.removeprefix("images/") in IMAGES:
        part.attrs[key] = f"/manual/{path}"
    elif path and "://" not in path:
        del part.attrs[key]


def _framed(heading: str, text: str) -> str:
    return FRAME.replace("<title>Manual</title>", f"<title>{escape(heading)}</title>").replace("<!-- text -->", text)


@ADDRESSES.get("/manual", Level.VIEWER, "the manual: a list of its pages")
def _contents(request: Request) -> Response:
    return HTMLResponse(placed(contents(), _base_path(request)))


@ADDRESSES.get("/manual/{name}", Level.VIEWER, "a page of the manual")
def _page(request: Request, name: str) -> Response:
    base_path = _base_path(request)
    return HTMLResponse(placed(html(name), base_path)) if name in PAGES else missing_page(base_path)


@ADDRESSES.get("/manual/images/{name}", Level.VIEWER, "a picture of the manual")
def _image(request: Request, name: str) -> Response:
    return FileResponse(IMAGES[name]) if name in IMAGES else missing_page(_base_path(request))


def _base_path(request: Request) -> str:
    found: str = request.app.state.logins.config.base_path
    return found
