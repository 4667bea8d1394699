"""Pages without a gateway: files from the disk, a socket that says what the test wants, answers that the test gives."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from urllib.parse import urlsplit

from playwright.sync_api import Page, Route

from gateway.web.auth.headers import CONTENT_SECURITY_POLICY
from gateway.web.languages import Languages, languages

STATIC = Path(__file__).parents[2] / "gateway" / "web" / "static"
HOST = "127.0.0.1:9"  # nobody listens there: every request is answered below
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
PAGES = {
    "": "index.html",
    "driver": "driver.html",
    "login": "login.html",
    "history": "history.html",
    "manager": "manager.html",
    "calibrate": "calibrate.html",
    "setup/new-bay": "new-bay.html",
}
Answer = Callable[[Route], object]
# __says: a text, or what becomes JSON; null: nothing. __delay_ms: between question and answer. __shown: whatever stood
# there, one after the other, each with the opacity of the STOP over it.
SOCKET = """
const often = window.setInterval.bind(window);
window.__says = null;
window.__delay_ms = 20;
window.__shown = [];
window.WebSocket = class {
  static OPEN = 1;
  readyState = 0;
  constructor(url) {
    window.__asked = url;
    window.__socket = this;
    setTimeout(() => { this.readyState = 1; this.onopen?.({}); this.send(); }, 5);
  }
  send() {
    const timer = often(() => {
      if (this.readyState !== 1) clearInterval(timer);
      else if (window.__says !== null) {
        clearInterval(timer);
        this.onmessage?.({ data: typeof window.__says === 'string' ? window.__says : JSON.stringify(window.__says) });
      }
    }, window.__delay_ms);
  }
  close() { this.readyState = 3; this.onclose?.({ code: 1000, reason: '' }); }
};
addEventListener('DOMContentLoaded', () => {
  new MutationObserver(() => window.__shown.push(`${document.body.dataset.code} ${document.body.dataset.fresh}`))
    .observe(document.body, { attributeFilter: ['data-code', 'data-fresh'] });
});
"""


@cache
def shipped() -> Languages:
    """Read once: pages ask for them twice each."""
    return languages({})


def from_disk(route: Route) -> None:
    """A page or one of its files, with the headers that the gateway sends."""
    path = urlsplit(route.request.url).path
    if path == "/api/pages":
        route.fulfill(body='{"digest": "0"}', content_type="application/json")
        return
    if path.startswith("/api/languages"):
        code = path.removeprefix("/api/languages").removeprefix("/")
        known = shipped()
        body = json.dumps(known.catalogues[code].model_dump() if code else {"languages": known.listed()})
        route.fulfill(body=body, content_type="application/json")
        return
    if path.startswith("/static/"):
        file = STATIC / path.removeprefix("/static/")
    else:
        file = STATIC / (PAGES.get(path.strip("/")) or PAGES[path.split("/")[1]])
    if not file.is_file():
        route.fulfill(status=404)
        return
    headers = {"Content-Type": TYPES[file.suffix], "Content-Security-Policy": CONTENT_SECURITY_POLICY}
    route.fulfill(body=file.read_bytes(), headers=headers)


def with_json(text: str) -> Answer:
    return lambda route: route.fulfill(body=text, content_type="application/json")


def say(page: Page, what: object) -> None:
    """What the socket answers from now on; None: nothing."""
    page.evaluate("(what) => { window.__says = what; }", what)
