"""The report of *Why?* is saved in the page's language. No gateway runs: its scripts and a report are given by hand."""

import re
from pathlib import Path

from playwright.sync_api import Browser, Route

from gateway.records import page as report_page
from gateway.records.inquiry import Inquiry
from tests.page_texts import STATIC
from tests.recorded_bay import S, recorded, unix

SITE = "http://127.0.0.1:9"  # nobody is asked there
SAVE = """async () => {
  await (await import('/static/lib/lang.js')).load('de');
  await (await import('/static/history/report.js')).save('/api/bays/bay1/why.html?at_ms=1', 'why-bay1.html');
}"""


def test_the_report_is_saved_in_the_language_of_the_page(browser: Browser, tmp_path: Path) -> None:
    folder, _ = recorded(tmp_path, until_s=30)
    english = report_page.html(Inquiry(folder.path).at(unix(round(1020 * S))), [], "2026-11-28")
    assert "How it came about" in english

    def answered(route: Route) -> None:
        path = route.request.url.removeprefix(SITE)
        if path.startswith("/static/"):
            route.fulfill(path=STATIC / path.removeprefix("/static/"), content_type="text/javascript")
        elif path.startswith("/api/languages/"):
            route.fulfill(path=STATIC / "languages" / "de.json", content_type="application/json")
        else:
            body = english if "why.html" in path else "<!DOCTYPE html><title>page</title>"
            route.fulfill(body=body, content_type="text/html; charset=utf-8")

    page = browser.new_page()
    try:
        page.route("**/*", answered)
        page.goto(SITE)
        with page.expect_download() as given:
            page.evaluate(SAVE)
        assert given.value.suggested_filename == "why-bay1.html"
        saved = Path(given.value.path()).read_text(encoding="utf-8")
    finally:
        page.close()
    assert saved.startswith('<!DOCTYPE html>\n<html lang="de" dir="ltr">')
    shown = re.sub(r"<(script|style|pre).*?</\1>|<[^>]+>", " ", saved, flags=re.DOTALL)
    for text in (
        *("Der Lkw durfte fahren: nichts hält den Lkw an: D = 0", "Wie es dazu kam", "Messwerte und Ausgänge"),
        *("Sekunden vom gefragten Zeitpunkt an", "Halt beendet", "Marke gefunden", "Geltende Konfiguration"),
    ):
        assert text in shown
    for text in ("The truck was allowed", "How it came about", "stop cleared", "Configuration in force"):
        assert text not in shown
