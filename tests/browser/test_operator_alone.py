"""The operator's page without a gateway: what only many bays, other visitors or a page in the background show."""

import json
import re
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from gateway.alarms.records import Alarm
from gateway.alarms.states import AlarmState
from gateway.config import FusionConfig
from gateway.core.state import REASON_MEANING, Reason
from gateway.sinks.mqtt import reference
from gateway.sinks.mqtt.messages import StatePayload
from gateway.web.server import lists, models
from gateway.web.server.gateway_client import GatewayClient
from tests.browser import judgements
from tests.browser.alone import HOST, SOCKET, from_disk, say, with_json
from tests.browser.chromium import Watch, until

STATE = reference.examples()["state"].model_dump(mode="json")
EVENT = reference.examples()["event"].model_dump(mode="json")
# A picture only where a test wants one; the page asks again and again otherwise.
NO_PICTURE = """
window.__pictures = 0;
const ask = window.fetch.bind(window);
window.fetch = (path, how) => {
  if (!String(path).includes('/picture?')) return ask(path, how);
  window.__pictures += 1;
  return ask(path, how);
};
"""
Open = Callable[..., Page]


def state(bay: str, **change: Any) -> dict[str, Any]:
    return {**STATE, "bay": bay, "stop": False, "may_move": True, **change}


def broken(bay: str) -> dict[str, Any]:
    reason = Reason.CAMERA_DOWN
    return state(
        bay,
        stop=True,
        may_move=False,
        u=None,
        v=None,
        radius_px=None,
        d=None,
        reason={"name": reason.name, "code": int(reason), "text": REASON_MEANING[reason]},
        vision={"quality": {"name": "LINK_DOWN", "code": 3}, "age_ms": 5000.0, "detail": "connection refused"},
        ne107={"name": "FAILURE", "code": 1, "active": ["FAILURE"]},
    )


NOW = cast(GatewayClient, SimpleNamespace(unix_ms=lambda t_ns: t_ns and 1_795_000_000_000))


def alarm(bay: str, kind: str, state: AlarmState) -> models.AlarmView:
    active = state is not AlarmState.RETURNED
    return lists.alarm_view(NOW, Alarm(f"{bay}.{kind}", kind, bay, state, active, 1, 1, 3, "connection refused"))


def live(states: list[dict[str, Any]], alarms: tuple[models.AlarmView, ...] = (), events: int = 0) -> Any:
    """A message as the gateway's own models make it."""
    view = models.LiveView(
        server_time_ms=1_795_000_000_000,
        bays=tuple(
            models.BayView(
                bay=each["bay"],
                unit_id=n + 1,
                state=StatePayload.model_validate(each),
                age_ms=20.0,
                thresholds=models.ThresholdsView.model_validate(
                    {**dict(FusionConfig()), "recipe": 0, "recipe_name": None}
                ),
                aim=models.AimView(u_px=None, v_px=None, tolerance_px=20.0, mirrored=False),
                deadlines=models.DeadlinesView(vision_ms=300.0, range_ms=400.0, plc_ms=None),
                function_check="OFF",
                method="robust",
                stage_ms={},
            )
            for n, each in enumerate(states)
        ),
        alarms=summary(alarms),
        links=models.LinksView(age_ms=20.0, modbus=(), mqtt=None, sparkplug=None, tasks=(), events_dropped=0),
        events_newest=events,
    )
    return json.loads(view.model_dump_json())


def summary(alarms: tuple[models.AlarmView, ...]) -> models.AlarmSummary:
    by_bay = {each.bay: sum(other.bay == each.bay for other in alarms) for each in alarms if each.bay is not None}
    return models.AlarmSummary(
        unacknowledged=len(alarms),
        active=len(alarms),
        latched=0,
        shelved=0,
        suppressed=0,
        out_of_service=0,
        by_bay=by_bay,
        first=alarms[0] if alarms else None,
        newest_change=len(alarms),
    )


class StandInServer:
    """What the pretended gateway answers."""

    def __init__(self) -> None:
        self.session = {"name": None, "role": "technician", "can_login": True, "csrf": "token", "bays": ["bay1"]}
        self.alarms: tuple[models.AlarmView, ...] = ()
        self.events: list[dict[str, Any]] = []
        self.posts: list[tuple[str, str | None, Any]] = []

    def answer(self, route: Route) -> None:
        request = route.request
        path = request.url.removeprefix(f"http://{HOST}")
        if request.method == "POST":
            self.posts.append((path, request.headers.get("x-csrf-token"), request.post_data_json))
            with_json("{}")(route)
        elif path == "/api/session":
            with_json(json.dumps(self.session))(route)
        elif path == "/api/alarms":
            view = models.AlarmsView(
                server_time_ms=0, summary=summary(self.alarms), alarms=self.alarms, omitted=0, changes=()
            )
            with_json(view.model_dump_json())(route)
        elif path.startswith("/api/events"):
            with_json(json.dumps({"newest": len(self.events), "events": self.events}))(route)
        elif "/picture?" in path:
            route.fulfill(body=JPEG, content_type="image/jpeg", headers={"X-Frame-Id": "7", "X-Frame-Size": "64x48"})
        else:
            route.fulfill(status=404)


JPEG = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()


@pytest.fixture
def client() -> StandInServer:
    return StandInServer()


@pytest.fixture
def watch() -> Watch:
    return Watch(HOST)


@pytest.fixture
def operator(browser: Browser, client: StandInServer, watch: Watch) -> Iterator[Open]:
    contexts = []

    def opened(says: Any, path: str = "/", width_px: int = 1366) -> Page:
        context = browser.new_context(viewport={"width": width_px, "height": 900})
        contexts.append(context)
        watch.over(context)
        context.add_init_script(SOCKET + NO_PICTURE)
        context.route("**/*", from_disk)
        context.route("**/api/**", client.answer)
        page = context.new_page()
        page.goto(f"http://{HOST}{path}")
        say(page, says)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert watch.complaints == []


def test_of_64_bays_those_in_trouble_come_first(operator: Open, client: StandInServer) -> None:
    names = [f"bay{n}" for n in range(1, 65)]
    client.session["bays"] = names
    client.alarms = (alarm("bay40", "ranger_stale", AlarmState.UNACKNOWLEDGED),)
    states = [broken(name) if name == "bay33" else state(name) for name in names]
    page = operator(live(states, client.alarms))
    tiles = page.locator(".tiles .tile")
    expect(tiles).to_have_count(64)
    expect(tiles.nth(0)).to_contain_text("bay33")
    expect(tiles.nth(0)).to_contain_text("camera down")
    expect(tiles.nth(1)).to_contain_text("bay40")
    expect(tiles.nth(1)).to_contain_text("1 alarm")
    expect(tiles.nth(2).locator("b").first).to_have_text("bay1")
    expect(tiles.nth(63).locator("b").first).to_have_text("bay64")
    page.get_by_role("button", name="in trouble 2").click()
    expect(tiles).to_have_count(2)
    page.get_by_role("button", name="all 64").click()
    page.get_by_label("find a bay by name").fill("bay6")
    expect(tiles).to_have_count(6)  # bay6, bay60 to bay64
    judgements.accessible(page)
    for width_px in (360, 768, 3840):
        page.set_viewport_size({"width": width_px, "height": 900})
        judgements.no_sideways_scroll(page)
    tiles.first.click()
    expect(page.locator(".decision .word")).to_have_text("MAY MOVE")
    until(page, lambda: page.evaluate("() => window.__asked").endswith("/api/live?bay=bay6"))


HERE = {"d": True, "stop": True, "may_move": False, "in_place": True, "phase": "IN_PLACE", "in_place_ms": 125_000.0}
SCALE = {"px_mm": 56_000.0, "spread": 0.012, "visits": 12, "newest_ms": 1_794_000_000_000, "jump": None}


def fact(page: Page, name: str) -> str:
    text: str = page.locator(".facts-grid > div", has=page.get_by_text(name, exact=True)).locator("dd").inner_text()
    return " ".join(text.split())


def test_the_visit_of_a_truck(operator: Open) -> None:
    page = operator(live([state("bay1", **HERE, scale=SCALE)]))
    expect(page.locator(".decision .why")).to_contain_text("in place: ")
    assert [fact(page, name) for name in ("Stop", "May move", "In place", "Moved since", "Visit", "D")] == [
        *("on", "no", "yes, seen 2 min 5 s", "no", "in place", "1")
    ]
    assert re.fullmatch(r"56 000 px mm spread 1\.2 %, 12 visits, newest 2026-11-0[67]", fact(page, "R × Z learned")), (
        fact(page, "R × Z learned")
    )
    held = {**HERE, "d": None, "held": True, "held_ms": 35_000.0, "phase": "HELD", "radius_px": None}
    say(page, live([state("bay1", **held, scale={**SCALE, "jump": -0.125})]))
    expect(page.locator(".decision .why")).to_contain_text("in place, held by the ranger alone: ")
    assert (fact(page, "In place"), fact(page, "D")) == ("yes, held 35.0 s", "unknowable")
    assert fact(page, "R × Z learned").endswith("newest differs by −13 %")
    judgements.accessible(page)
    moved = {**held, "in_place": False, "held": False, "in_place_ms": None, "held_ms": None, "moved": "DISTANCE"}
    say(page, live([state("bay1", **moved)]))
    expect(page.locator(".decision .why")).not_to_contain_text("in place")
    assert (fact(page, "In place"), fact(page, "Moved since")) == ("no", "yes, by distance")
    for width_px in (360, 768, 1366):
        page.set_viewport_size({"width": width_px, "height": 900})
        judgements.no_sideways_scroll(page)


def test_the_overview_counts_trucks_in_place(operator: Open, client: StandInServer) -> None:
    client.session["bays"] = ["bay1", "bay2", "bay3"]
    held = {**HERE, "held": True, "held_ms": 1000.0}
    page = operator(live([state("bay1", **HERE), state("bay2", **held), state("bay3")]))
    page.get_by_role("button", name="in place 2").click()
    expect(page.locator(".tile .why")).to_have_text(["in place", "in place, held"])


def test_a_bay_without_data_is_not_known(operator: Open, client: StandInServer) -> None:
    """Its page has data of other bays only, or none that is young enough."""
    client.session["bays"] = ["bay1", "bay2"]
    message = live([state("bay1"), state("bay2")])
    message["bays"][1]["age_ms"] = 60_000.0
    message["bays"][0]["state"] = message["bays"][0]["age_ms"] = None
    page = operator(message)
    expect(page.locator(".tile")).to_have_count(2)
    for n in range(2):
        expect(page.locator(".tile").nth(n)).to_contain_text("NOT KNOWN")
        expect(page.locator(".tile").nth(n)).not_to_contain_text("MAY MOVE")


def test_a_message_that_makes_no_sense_is_not_shown_as_the_last_one(operator: Open) -> None:
    page = operator(live([state("bay1")]))
    expect(page.locator(".decision .word")).to_have_text("MAY MOVE")
    for nonsense in ("{", "[]", "null", '{"bays": 3}', '{"bays": []}'):
        say(page, nonsense)
        expect(page.locator(".decision .word")).to_have_text("NOT KNOWN")
        expect(page.get_by_text("NO CONNECTION TO THE GATEWAY.", exact=True)).to_be_visible()
        say(page, live([state("bay1")]))
        expect(page.locator(".decision .word")).to_have_text("MAY MOVE")


def test_a_fault_of_the_page_itself_leaves_nothing_standing_that_looks_live(operator: Open, watch: Watch) -> None:
    watch.excused = re.compile("TypeError")
    page = operator(live([state("bay1")]))
    expect(page.locator(".decision .word")).to_have_text("MAY MOVE")
    strange = live([state("bay1")])
    del strange["bays"][0]["state"]["guidance"], strange["bays"][0]["state"]["rates"]
    say(page, strange)
    expect(page.get_by_text("Treat every bay as STOP.")).to_be_visible()
    expect(page.locator(".decision")).to_have_count(0)


def test_acknowledging_sends_what_was_seen_and_the_token(operator: Open, client: StandInServer) -> None:
    client.alarms = (alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),)
    page = operator(live([broken("bay1")], client.alarms))
    button = page.get_by_role("button", name="Acknowledge Camera down (never ends a stop)")
    expect(button).to_have_attribute(
        "title", "Says that you have seen it. Never ends a stop: only its cause going away does."
    )
    button.click()
    until(page, lambda: client.posts)
    assert client.posts == [("/api/alarms/bay1.camera_down/acknowledge", "token", {"occurrence": 3})]


def test_a_moment_is_marked_with_a_note(operator: Open, client: StandInServer) -> None:
    page = operator(live([state("bay1")]))
    page.get_by_role("button", name="Mark this moment").click()
    page.get_by_label("note for the mark").fill("driver complains")
    page.get_by_role("button", name="Mark", exact=True).click()
    until(page, lambda: client.posts)
    assert client.posts == [("/api/bays/bay1/mark", "token", {"note": "driver complains"})]
    expect(page.get_by_role("button", name="Mark this moment")).to_be_visible()


def test_a_visitor_without_a_name_cannot_acknowledge_and_sees_no_tuning(operator: Open, client: StandInServer) -> None:
    client.session["role"] = "viewer"
    client.alarms = (alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),)
    page = operator(live([broken("bay1")], client.alarms))
    expect(page.get_by_role("button", name="Acknowledge Camera down")).to_be_disabled()
    expect(page.get_by_role("button", name="Mark this moment")).to_have_count(0)
    expect(page.get_by_role("link", name="Technician")).to_have_count(0)
    expect(page.get_by_role("link", name="Log in")).to_have_attribute("href", "/login?next=%2F")


def test_words_from_outside_stay_words(operator: Open, client: StandInServer) -> None:
    """A camera's error, a name, an event: whatever they hold is shown, and is never markup."""
    evil = "<img src=x onerror=alert(1)><b>bold</b>"
    client.events = [{"number": 1, "event": {**EVENT, "bay": "bay1", "detail": evil}}]
    message = live([{**broken("bay1"), "vision": {**broken("bay1")["vision"], "detail": evil}}], events=1)
    page = operator(message)
    expect(page.locator(".events td").last).to_contain_text(evil)
    expect(page.locator(".parts li").first).to_contain_text(evil)
    assert page.locator("img, .events b").count() == 0


def test_a_page_in_the_background_asks_for_no_pictures(operator: Open) -> None:
    page = operator(live([state("bay1")]))
    until(page, lambda: page.evaluate("() => window.__pictures") > 3)
    page.evaluate("""() => {
      Object.defineProperty(document, 'hidden', { get: () => true, configurable: true });
      document.dispatchEvent(new Event('visibilitychange'));
    }""")
    page.wait_for_timeout(500)  # the one that was under way
    asked = page.evaluate("() => window.__pictures")
    page.wait_for_timeout(1000)
    assert page.evaluate("() => window.__pictures") == asked
    page.evaluate("""() => {
      delete document.hidden;
      document.dispatchEvent(new Event('visibilitychange'));
    }""")
    until(page, lambda: page.evaluate("() => window.__pictures") > asked + 2)
