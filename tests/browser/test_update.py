"""Another version is uploaded, checked, installed and returned from on the page; the machine's root part is played."""

import json
import re
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from playwright.sync_api import Route, expect

from tests.browser import judgements
from tests.browser.chromium import Watch
from tests.browser.conftest import Visit
from tests.browser.plant import plant

SHOWN: dict[str, Any] = {
    **{"version": "0.1.0", "previous": "0.0.9", "stage": "ended", "old": "0.0.9", "new": "0.1.0", "outcome": "updated"},
    **{"why": "", "differing": [], "log": ["2026-01-02T03:04:05Z updated: 0.1.0 runs and is proven"]},
}


def test_an_update_from_the_upload_to_the_way_back(
    tmp_path: Path, visit: Visit, watches: list[Watch], started: ExitStack
) -> None:
    now: dict[str, Any] = {"shown": SHOWN, "package_bytes": 0, "signature_bytes": 0, "pending": False}
    asked: list[Any] = []

    def update(route: Route) -> None:
        if route.request.method == "POST":
            asked.append(json.loads(route.request.post_data or "{}"))
            if route.request.url.endswith("/piece"):
                now[f"{asked[-1]['file']}_bytes"] = asked[-1]["size"]
            else:
                now["pending"] = True
        route.fulfill(json=now)

    package, signature = tmp_path / "loading-gateway_0.2.0_amd64.deb", tmp_path / "loading-gateway_0.2.0_amd64.deb.asc"
    package.write_bytes(bytes(2_500_000))
    signature.write_text("signed")
    running = started.enter_context(plant(tmp_path))
    page = visit(f"{running.url}/setup/update")
    watches[-1].excused = re.compile("status of 503")  # this gateway runs from its sources
    expect(page.get_by_text("was not installed from its package")).to_be_visible()
    expect(page.get_by_role("button", name="Upload")).to_be_hidden()
    page.route("**/api/setup/update**", update)
    page.reload()
    expect(page.get_by_text("In use: version 0.1.0.")).to_be_visible()
    judgements.accessible(page)
    for width_px in (360, 3840, 1366):
        page.set_viewport_size({"width": width_px, "height": 900})
        judgements.no_sideways_scroll(page)
    expect(page.get_by_role("button", name="Install…")).to_be_disabled()
    page.get_by_label("Package (.deb)").set_input_files([package, signature])
    page.get_by_role("button", name="Upload").click()
    expect(page.get_by_role("button", name="Check without switching")).to_be_enabled()
    assert [(one["file"], one["offset"], one["size"]) for one in asked] == [
        ("signature", 0, 6),
        *(("package", n << 20, 2_500_000) for n in range(3)),
    ]

    page.get_by_role("button", name="Install…").click()
    page.get_by_role("button", name="Install", exact=True).click()
    expect(page.get_by_text("The request waits for its start")).to_be_visible()
    assert asked[-1] == {"action": "install", "bays": [], "alarms": []}
    now |= {"pending": False, "shown": {**SHOWN, "stage": "replaying", "outcome": "", "log": ["one", "two"]}}
    expect(page.locator("[aria-current=step]")).to_contain_text("replaying")
    expect(page.get_by_role("region", name="log of the update")).to_have_text("one\ntwo")
    why = "the differences were not accepted; --yes accepts them"
    now["shown"] = {**SHOWN, "outcome": "abandoned", "why": why, "differing": ["bay1"], "new": "0.2.0"}
    page.get_by_label("Accept that the new version decides otherwise in bay1").check()
    page.get_by_role("button", name="Install…").click()
    page.get_by_role("button", name="Install", exact=True).click()
    expect(page.get_by_text("The request waits for its start")).to_be_visible()
    assert asked[-1] == {"action": "install", "bays": ["bay1"], "alarms": []}

    why = "not proven within 120 s: new alarm picture_dark (too dark)"
    now |= {"pending": False, "shown": {**SHOWN, "outcome": "returned", "why": why, "new": "0.2.0"}}
    expect(page.get_by_label("Accept the new alarm picture_dark")).to_be_visible()
    page.get_by_role("button", name="Return to version 0.0.9…").click()
    page.get_by_role("button", name="Return", exact=True).click()
    expect(page.get_by_text("The request waits for its start")).to_be_visible()
    assert asked[-1] == {"action": "back"}
