"""The operator's page without a gateway: what only many bays, other visitors or a page in the background show."""

import json
import re
import time
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
from gateway.core.state import Reason
from gateway.sinks.mqtt.messages import StatePayload
from gateway.web.server import lists, models
from gateway.web.server.gateway_client import GatewayClient
from tests.browser import judgements
from tests.browser.alone import HOST, SOCKET, from_disk, say, with_json
from tests.browser.chromium import Watch, until
from tools import mqtt

STATE = mqtt.examples()["state"].model_dump(mode="json")
EVENT = mqtt.examples()["event"].model_dump(mode="json")
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
        reason={"name": reason.name, "code": int(reason), "text": reason.meaning},
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
                title="",
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
    shown = [each for each in alarms if each.state not in lists.HIDDEN]
    waits = ("unacknowledged", "returned", "latched_unacknowledged")
    return models.AlarmSummary(
        age_ms=20.0,
        unacknowledged=sum(each.state in waits for each in shown),
        shown=len(shown),
        active=len(alarms),
        latched=0,
        shelved=0,
        suppressed=0,
        out_of_service=0,
        silent_sensors=0,
        function_checks=0,
        by_bay=by_bay,
        highest_by_bay={each.bay: each.priority for each in reversed(shown) if each.bay is not None},
        first=shown[0] if shown else None,
        newest_change=len(alarms),
    )


class StandInServer:
    """What the pretended gateway answers."""

    def __init__(self) -> None:
        self.session: dict[str, Any] = {
            "name": None,
            "role": "technician",
            "can_login": True,
            "csrf": "token",
            "bays": ["bay1"],
        }
        self.alarms: tuple[models.AlarmView, ...] = ()
        self.events: list[dict[str, Any]] = []
        self.posts: list[tuple[str, str | None, Any]] = []
        self.gone = False  # it answers, and has nothing new
        self.frame = (64, 48)  # of the picture
        self.frame_age_ms = 20.0
        self.asked: list[str] = []  # pictures, by their addresses
        self.trucks: list[dict[str, Any]] = []  # recorded

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
        elif path.endswith("/records"):
            last_ms = self.trucks[0]["last_seen_ms"] if self.trucks else None  # none: nothing is recorded
            with_json(json.dumps({"bay": path.split("/")[3], "recorded": False, "last_ms": last_ms}))(route)
        elif "/visits?" in path:
            with_json(json.dumps({"bay": path.split("/")[3], "visits": self.trucks}))(route)
        elif path.startswith("/api/events"):
            with_json(json.dumps({"newest": len(self.events), "events": self.events}))(route)
        elif "/picture?" in path and (self.gone or "/bay_without_picture/" in path):
            route.fulfill(status=204)
        elif "/picture?" in path:
            width, height = self.frame
            self.asked.append(path)
            headers = {
                "X-Frame-Id": "7",
                "X-Frame-Size": f"{width}x{height}",
                "X-Frame-Age-Ms": f"{self.frame_age_ms}",
            }
            jpeg = cv2.imencode(".jpg", np.full((height, width, 3), 90, np.uint8))[1].tobytes()
            route.fulfill(body=jpeg, content_type="image/jpeg", headers=headers)
        else:
            route.fulfill(status=404)


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
        context.route("**/api/languages**", from_disk)
        context.route("**/api/pages", from_disk)
        page = context.new_page()
        page.goto(f"http://{HOST}{path}")
        say(page, says)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert watch.complaints == []


@pytest.mark.long
def test_people_read_a_bay_s_title_beside_its_name(operator: Open, client: StandInServer) -> None:
    client.session |= {"bays": ["bay1", "constructor"], "titles": {"bay1": "Verladung 3 Süd"}}
    page = operator(live([state("bay1"), state("constructor")]))
    expect(page.locator(".tile b[translate]")).to_have_text(["Verladung 3 Süd (bay1)", "constructor"])
    page.locator(".tile").first.click()
    expect(page).to_have_title("Verladung 3 Süd (bay1)")
    expect(page.get_by_role("heading", level=1)).to_have_text("Verladung 3 Süd (bay1)")


def test_of_64_bays_those_in_trouble_come_first(operator: Open, client: StandInServer) -> None:
    names = [f"bay{n}" for n in range(1, 65)]
    client.session["bays"] = names
    client.alarms = (alarm("bay40", "ranger_stale", AlarmState.UNACKNOWLEDGED),)
    states = [broken(name) if name == "bay33" else state(name) for name in names]
    page = operator(live(states, client.alarms))
    tiles = page.locator(".tiles .tile")
    expect(tiles).to_have_count(64)
    expect(tiles.nth(0)).to_contain_text("bay33")
    expect(tiles.nth(0)).to_contain_text("The camera is not connected")
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


@pytest.mark.long
def test_a_tile_draws_how_far_the_truck_is_from_the_mark(operator: Open, client: StandInServer) -> None:
    """`x` of 200: the mark stands at 46 + 116 x 3000 / 3500."""
    client.session["bays"] = ["bay1", "bay2", "bay3"]
    page = operator(
        live([state(f"bay{n}", guidance=TO_GO | {"to_go_mm": mm}) for n, mm in enumerate((1500, 0, None), 1)])
    )
    drawn = "(parts) => parts.map((each) => each.getAttribute('transform'))"
    expect(page.locator(".tile")).to_have_count(3)
    for n, truck, words in (
        (0, ["translate(95.7 0)"], "to go 1500\u202fmm"),
        (1, ["translate(145.4 0)"], "to go 0\u202fmm"),
        (2, [], ""),
    ):
        tile = page.locator(".tile").nth(n)
        expect(tile.locator(".to-go")).to_have_text(words)
        assert tile.locator(".truck").evaluate_all(drawn) == truck
        assert tile.locator(".side g").first.get_attribute("transform") == "translate(145.4 0)"


@pytest.mark.long
def test_tiles_fill_the_width(operator: Open, client: StandInServer) -> None:
    for bays, wide, columns in ((2, 1366, 2), (1, 1366, 1), (4, 1366, 4), (12, 1366, 6), (12, 1920, 6)):
        if bays > 1:  # else the page before, of two
            names = [f"bay{n}" for n in range(1, bays + 1)]
            client.session["bays"] = names
            page = operator(live([state(name) for name in names]), width_px=wide)
        else:
            page.get_by_label("find a bay by name").fill("bay2")
        expect(page.locator(".tile")).to_have_count(bays)
        tiles, room = page.locator(".tile").evaluate_all(BOXES), page.locator(".tiles").evaluate_all(BOXES)[0]
        assert len({left for left, _ in tiles}) == columns, bays
        assert max(right for _, right in tiles) == pytest.approx(room[1], abs=1), bays
        judgements.no_sideways_scroll(page)
        page.set_viewport_size({"width": wide, "height": 768})
        until(page, lambda page=page: max(page.locator(".tile").evaluate_all(ENDS)) < 768)  # type: ignore[misc]


TO_GO = {"name": "FORWARD", "code": 1, "amount_mm": None, "closing_mm_s": None, "offset_u_px": None}
TO_GO |= {"offset_v_px": None, "offset_mm": None, "text": ""}
ENDS = "(all) => all.map((each) => each.getBoundingClientRect().bottom)"
HEIGHT = "(box) => box.getBoundingClientRect().height"
BOXES = "(all) => all.map((each) => each.getBoundingClientRect()).map((box) => [box.left, box.right])"
HERE = {"d": True, "stop": True, "may_move": False, "in_place": True, "phase": "IN_PLACE", "in_place_ms": 125_000.0}
SCALE = {"px_mm": 56_000.0, "spread": 0.012, "visits": 12, "newest_ms": 1_794_000_000_000, "jump": None}


def fact(page: Page, name: str) -> str:
    text: str = (
        page.locator(".facts-grid > div, .learned", has=page.get_by_text(name, exact=True)).locator("dd").inner_text()
    )
    return " ".join(text.split())


# Of each list of facts, how many lines its labels and its values stand on.
LINES = """() => [...document.querySelectorAll('dl.facts-grid')].map((list) => ['dt', 'dd'].map((part) =>
  new Set([...list.querySelectorAll(part)].map((at) => {
    const { top, bottom } = at.getBoundingClientRect();
    return Math.round(part === 'dt' ? bottom : top);
  })).size))"""


def test_facts_stand_in_lines_and_no_word_of_them_is_cut(operator: Open) -> None:
    page = operator(live([state("bay1", **HERE, scale=SCALE)]))
    for change, shown in (
        ({**HERE, "scale": SCALE}, ("In place", "yes, seen 2 min 5 s")),  # which takes two lines
        ({"phase": "APPROACHING"}, ("Visit", "approaching")),
    ):
        say(page, live([state("bay1", **change)]))
        for width_px, lines in ((390, [[4, 4], [2, 2]]), (1366, [[3, 3], [2, 2]]), (1920, [[3, 3], [2, 2]])):
            page.set_viewport_size({"width": width_px, "height": 900})
            until(page, lambda shown=shown: fact(page, shown[0]) == shown[1])  # type: ignore[misc]
            assert page.evaluate(LINES) == lines, (width_px, shown)
            judgements.no_word_is_cut(page)


@pytest.mark.long
def test_how_worn_the_markers_are_stands_beside_the_picture(operator: Open) -> None:
    def rows() -> list[str]:
        part = page.locator("[aria-labelledby=health-title] .parts > li", has=page.get_by_text("Picture", exact=True))
        return [" ".join(row.split()) for row in part.locator("dl > div").all_inner_texts()][6:]

    wear = {"visible": 0.824, "visible_a_day": -0.0152, "contrast": 1.2, "contrast_a_day": None, "days_left": 14.2}
    page = operator(live([state("bay1", marker={**wear, "worn": False})]))
    until(page, lambda: rows() == ["rim seen 82 %, −1.5 % a day", "rim contrast 1.20", "below its limit in 14 d"])
    steady = {"visible_a_day": None, "days_left": None, "worn": False}
    say(page, live([state("bay1", marker={**wear, **steady})]))
    until(page, lambda: rows() == ["rim seen 82 %", "rim contrast 1.20"])
    say(page, live([state("bay1", marker=None)]))
    until(page, lambda: rows() == [])


@pytest.mark.long
def test_a_relay_that_is_not_reported_keeps_its_row(operator: Open) -> None:
    def says(configured: bool, relay: dict[str, Any] | None = None) -> Any:
        message = live([state("bay1", relay=relay)])
        message["bays"][0]["relay"] = configured
        return message

    shown = {"commanded": "MAY_MOVE", "in_place": False, "may_move": True, "fault": False}
    page = operator(says(True, shown))
    health = page.locator("[aria-labelledby=health-title]")
    row = health.locator("dl > div", has=page.get_by_text("relay", exact=True)).locator("dd")
    for width_px in (390, 1366, 1920):
        page.set_viewport_size({"width": width_px, "height": 900})
        say(page, says(True, shown))
        expect(row).to_have_text("may move")
        height = health.evaluate(HEIGHT)
        say(page, says(True))
        expect(row).to_have_text("–")
        assert health.evaluate(HEIGHT) == height, width_px
        say(page, says(False))
        expect(row).to_have_count(0)


def test_drive_and_pose_are_told_where_they_are_configured(operator: Open) -> None:
    def says(drive: dict[str, Any] | None, pose: dict[str, Any] | None, *, placed: bool) -> Any:
        message = live([state("bay1", drive=drive, pose=pose)])
        message["bays"][0]["pose"] = placed
        return message

    def rows() -> list[str]:
        return [" ".join(row.split()) for row in part.locator("dl > div").all_inner_texts()]

    drive = {"enable": True, "state": "APPROACH", "speed_setpoint_mm_s": 139.2, "stopping_mm": 256.4}
    pose = {"x_mm": -24.12, "y_mm": 0.04, "z_mm": 312.0, "x_sd_mm": 0.94, "y_sd_mm": 0.5, "z_sd_mm": 2.68}
    page = operator(says(drive, pose, placed=True))
    part = page.locator("[aria-labelledby=health-title] .parts > li", has=page.get_by_text(re.compile("^(Drive|Posi)")))
    told = ["enabled yes", "setpoint 139 mm/s", "stopping distance 256 mm"]
    until(
        page,
        lambda: rows() == [*told, "to the right −24.1 ± 0.9 mm", "downwards 0.0 ± 0.5 mm", "to go +312 ± 3 mm"],
    )
    expect(part).to_contain_text("on its way")
    for width_px in (390, 1366, 1920):
        page.set_viewport_size({"width": width_px, "height": 900})
        judgements.no_word_is_cut(page)
    stands = {"enable": False, "state": "INHIBITED", "speed_setpoint_mm_s": 0.0, "stopping_mm": None}
    none = ["to the right –", "downwards –", "to go –"]
    say(page, says(stands, None, placed=True))
    until(page, lambda: rows() == ["enabled no", "setpoint 0 mm/s", "stopping distance –", *none])
    say(page, says(None, None, placed=True))
    until(page, lambda: rows() == none)
    say(page, says(stands, None, placed=False))
    until(page, lambda: rows() == ["enabled no", "setpoint 0 mm/s", "stopping distance –"])
    say(page, says(None, None, placed=False))
    expect(part).to_have_count(0)


@pytest.mark.long
def test_on_a_telephone_the_page_begins_high(operator: Open) -> None:
    page = operator(live([state("bay1")]), width_px=390)
    expect(page.locator(".alarmbar")).to_have_text("No alarm.")
    # One row of them says that the clocks differ.
    assert page.locator("main").evaluate("(main) => main.getBoundingClientRect().top") < 145


def test_the_visit_of_a_truck(operator: Open) -> None:
    page = operator(live([state("bay1", **HERE, scale=SCALE)]))
    expect(page.locator(".decision .word")).to_have_text("IN PLACE")
    expect(page.locator(".decision .why")).to_have_text("Loading may start.")
    assert [fact(page, name) for name in ("Stop", "May move", "In place", "Moved since", "Visit", "D")] == [
        *("on", "no", "yes, seen 2 min 5 s", "no", "in place", "1")
    ]
    assert re.fullmatch(r"56 000 px mm spread 1\.2 %, 12 visits, newest 2026-11-0[67]", fact(page, "R × Z learned")), (
        fact(page, "R × Z learned")
    )
    held = {**HERE, "d": None, "held": True, "held_ms": 35_000.0, "phase": "HELD", "radius_px": None}
    say(page, live([state("bay1", **held, scale={**SCALE, "jump": -0.125})]))
    expect(page.locator(".decision .why")).to_contain_text("In place: loading may go on. The marker is covered;")
    assert (fact(page, "In place"), fact(page, "D")) == ("yes, held 35.0 s", "unknowable")
    assert fact(page, "R × Z learned").endswith("newest differs by −13 %")
    judgements.accessible(page)
    moved = {**held, "in_place": False, "held": False, "in_place_ms": None, "held_ms": None, "moved": "DISTANCE"}
    say(page, live([state("bay1", **moved)]))
    expect(page.locator(".decision .word")).to_have_text("STOP")
    expect(page.locator(".decision .why")).not_to_contain_text("In place")
    assert (fact(page, "In place"), fact(page, "Moved since")) == ("no", "yes, by distance")
    for width_px in (360, 768, 1366):
        page.set_viewport_size({"width": width_px, "height": 900})
        judgements.no_sideways_scroll(page)


def chosen(page: Page, what: str, value: str) -> None:
    """In the menu of the page's top; the page is loaded anew."""
    page.locator(".viewing > button").click()
    with page.expect_navigation():
        page.get_by_label(what, exact=True).select_option(value)


@pytest.mark.long
def test_the_viewer_chooses_inches_once_for_all_pages(operator: Open, client: StandInServer) -> None:
    """As the language: remembered by the browser, and an address may say otherwise."""
    near = {"name": "FORWARD", "code": 1, "amount_mm": 508.0, "to_go_mm": 508.0, "closing_mm_s": 127.0}
    near |= {"offset_u_px": 4.0, "offset_v_px": None, "offset_mm": -25.4, "text": ""}
    seen = live([state("bay1", distance_mm=812.8, guidance=near, scale=SCALE)])
    page = operator(seen)
    expect(page.locator(".bar .big")).to_have_text(["180.4\u202fpx", "813\u202fmm"])
    chosen(page, "units", "imperial")
    say(page, seen)
    expect(page.locator(".bar .big")).to_have_text(["180.4\u202fpx", "32.0\u202fin"])
    expect(page.locator(".bar").nth(1)).to_contain_text("Z_th 11.8\u202fin")
    assert page.locator(".bar").nth(1).locator(".scale span").all_inner_texts() == ["0", "20", "40", "60", "80"]
    assert [fact(page, name) for name in ("To go", "Closing", "Off to the side")] == [
        *("20.0 in", "+5.0 in/s", "+4 px · −1.0 in")
    ]
    assert fact(page, "R × Z learned").startswith("2205 px in")
    expect(page.locator(".trend header")).to_contain_text("Z 32.0\u202fin")
    client.session["bays"] = ["bay1", "bay2"]
    page.goto(f"http://{HOST}/")
    say(page, live([state("bay1", guidance=near), state("bay2")]))
    expect(page.locator(".tile").first).to_contain_text("to go 20.0\u202fin")
    page.goto(f"http://{HOST}/?units=metric")
    say(page, live([state("bay1", guidance=near), state("bay2")]))
    expect(page.locator(".tile").first).to_contain_text("to go 508\u202fmm")
    chosen(page, "units", "metric")
    assert page.evaluate("() => [location.search, localStorage.getItem('gateway.units')]") == ["", "metric"]


@pytest.mark.long
def test_the_bar_at_the_top_is_one_row_on_a_small_desk(operator: Open, client: StandInServer) -> None:
    """With the longest of what stands there: all pages, and somebody with a name."""
    client.session |= {"name": "schichtleiter", "role": "technician"}
    seen = live([state("bay1")]) | {"server_time_ms": round(1000 * time.time())}
    page = operator(seen)
    for language in ("de", "es", "tr"):
        page.goto(f"http://{HOST}/?lang={language}")
        say(page, seen)
        expect(page.locator("html")).to_have_attribute("lang", language)
        expect(page.locator(".decision .word")).to_be_visible()
        nav = page.locator(".top nav").bounding_box()
        facts = page.locator(".top .facts").bounding_box()
        assert nav is not None
        assert facts is not None
        assert abs(nav["y"] + nav["height"] / 2 - facts["y"] - facts["height"] / 2) < 4, language
        assert nav["height"] < 50, language


@pytest.mark.long
def test_a_driver_who_is_stopped_before_the_bit_is_said_to_be_early(operator: Open) -> None:
    told = STATE["guidance"] | {"name": "STOP", "amount_mm": None}
    page = operator(live([state("bay1", guidance=told)]))
    expect(page.locator(".instruction")).to_contain_text("early: a driver needs time to react")
    say(page, live([state("bay1", guidance=told, stop=True, may_move=False)]))
    expect(page.locator(".instruction")).to_have_text(re.compile(r"Driver is told\s*STOP$"))


def test_what_the_driver_is_told_is_the_word_of_the_drivers_display(operator: Open) -> None:
    page = operator(live([state("bay1")]))
    words = {"de": {"BRAKE": "BREMSEN", "TOO_FAR": "ZU WEIT"}, "es": {"BACK": "RETROCEDA"}, "tr": {"BRAKE": "FREN"}}
    for language, each in words.items():
        page.goto(f"http://{HOST}/?lang={language}")
        for code, word in each.items():
            told = STATE["guidance"] | {"name": code, "amount_mm": None}
            say(page, live([state("bay1", guidance=told, stop=True, may_move=False)]))
            expect(page.locator(".instruction .said")).to_have_text(word)


@pytest.mark.long
def test_a_kiosk_has_no_link_that_leads_away(operator: Open, client: StandInServer) -> None:
    """On a wall nobody clicks; what can be touched stays on this page."""
    client.session["bays"] = ["bay1", "bay2"]
    client.alarms = (alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),)
    page = operator(live([broken("bay1"), state("bay2")], client.alarms), "/?kiosk=1")
    expect(page.locator(".tile")).to_have_count(2)
    expect(page.locator(".alarmbar")).to_contain_text("Camera down")
    links = page.locator("a[href]").evaluate_all("(all) => all.map((one) => one.href)")
    assert [link for link in links if not link.startswith(f"http://{HOST}/?kiosk=1#")] == []
    expect(page.locator(".viewing, .top nav")).to_have_count(0)
    expect(page.locator("body")).to_have_class("idle")
    assert page.locator("main").evaluate("(main) => getComputedStyle(main).cursor") == "none"
    page.locator(".tile").first.click()
    expect(page.locator(".decision .word")).to_have_text("STOP")
    judgements.no_sideways_scroll(page)


def test_in_place_has_a_sign_of_its_own(operator: Open) -> None:
    """Neither that of a stop, nor that of a truck that may move; with no colour of a fault."""
    page = operator(live([state("bay1", **HERE)]))
    sign = page.locator(".decision svg").first
    expect(page.locator(".decision .word")).to_have_text("IN PLACE")
    signs = [sign.inner_html()]
    for change in ({**HERE, "in_place": False, "phase": "AT_MARK"}, {}):
        say(page, live([state("bay1", **change)]))
        expect(page.locator(".decision .word")).to_have_text("STOP" if change else "MAY MOVE")
        signs.append(sign.inner_html())
    assert len(set(signs)) == 3
    assert "red" not in signs[0]


DIALECT = re.compile(r"D = |R x Z|R and Z|ECHO pin|deadline|quality|protocol|may_move|in_place|_")


@pytest.mark.parametrize("bays", [("bay1",), pytest.param(("bay1", "bay2"), marks=pytest.mark.long)])
def test_every_reason_is_in_words_that_a_person_would_use(
    operator: Open, client: StandInServer, bays: tuple[str, ...]
) -> None:
    """Each reason of a stop has a sentence on the bay's page and some words on its tile, and no two have the same."""
    client.session["bays"] = list(bays)
    page = operator(live([state(bay) for bay in bays]))
    place = page.locator(".decision .why" if len(bays) == 1 else ".tile .why").first
    said = set()
    for reason in set(Reason) - {Reason.NONE}:
        why = {"name": reason.name, "code": int(reason), "text": "the gateway's own words"}
        stopped = {"stop": True, "may_move": False, "reason": why, "phase": "UNKNOWN", "in_place": False}
        before = place.inner_text()
        say(page, live([state(bay, **stopped) for bay in bays]))
        expect(place).not_to_have_text(before)
        text = place.inner_text()
        assert not DIALECT.search(text)
        assert "own words" not in text
        said.add(text)
    assert len(said) == len(Reason) - 1


def test_what_a_person_reads_is_said_plainly(operator: Open, client: StandInServer) -> None:
    """Another day has its date; beside an active alarm nothing is called good; one task; no gateway, no blame."""
    client.alarms = (alarm("bay1", "plc_lost", AlarmState.ACKNOWLEDGED),)
    message = live([state("bay1", ne107={"name": "GOOD", "code": 0, "active": []})], client.alarms)
    task = {"name": "mqtt", "running": False, "restarts": 3, "last_error": "refused"}
    message["links"]["tasks"] = [task]
    page = operator(message)
    raised = page.evaluate("() => new Date(1795000000000).toLocaleDateString('sv')")
    expect(page.locator(".alarms li")).to_contain_text(raised)
    expect(page.locator(".panel", has=page.locator("#decision-title")).locator("header")).to_contain_text(
        "alarm active"
    )
    expect(page.locator(".parts")).to_contain_text("1 task does not run")
    assert fact(page, "Stop latched") == "no"
    say(page, None)  # a gateway that says nothing any more, though its port is open
    client.gone = True
    expect(page.locator(".no-picture")).to_contain_text("no connection to the gateway")


@pytest.mark.long
def test_the_overview_has_pictures_and_lists_all_alarms(operator: Open, client: StandInServer) -> None:
    client.session["bays"] = names = ["bay1", "bay2", "bay3"]
    kinds = ("camera_down", "camera_stale", "ranger_down", "ranger_stale", "plc_lost", "maintenance")
    client.alarms = tuple(alarm("bay2", kind, AlarmState.UNACKNOWLEDGED) for kind in kinds)
    page = operator(live([state(name) for name in names], client.alarms))
    expect(page.get_by_label(re.compile("^live picture of bay"))).to_have_count(3)
    listed = page.locator(".alarms > ul")
    assert listed.evaluate("(list) => list.scrollHeight - list.clientHeight") <= 1
    expect(page.locator(".tile .no-picture")).to_have_count(0)
    page.get_by_role("checkbox", name="pictures").uncheck()
    expect(page.locator(".thumbnail")).to_have_count(0)


def test_a_tile_without_a_picture_says_why_and_keeps_its_size(operator: Open, client: StandInServer) -> None:
    client.session["bays"] = ["bay1", "bay2", "bay3"]
    page = operator(live([state("bay1"), state("bay2"), state("bay3")]))
    expect(page.get_by_label(re.compile("^live picture of bay"))).to_have_count(3)
    say(page, live([broken("bay1"), state("bay2"), state("bay3")]))  # while pictures still come
    expect(page.locator(".tile .no-picture")).to_have_text(["link down"], timeout=1500)
    expect(page.get_by_label("no live picture of bay1")).to_have_class("old")
    box = page.locator(".tile .thumbnail").first.bounding_box()
    client.gone = True
    page.reload()
    say(page, live([broken("bay1"), state("bay2")]))
    expect(page.locator(".tile .no-picture")).to_have_text(["nothing known", "link down", "no picture yet"])
    assert page.locator(".tile .thumbnail").first.bounding_box() == box


def test_an_old_frame_is_no_live_picture_of_a_tile(operator: Open, client: StandInServer) -> None:
    client.session["bays"] = ["bay1", "bay2"]
    page = operator(live([state("bay1"), state("bay2")]))
    expect(page.get_by_label(re.compile("^live picture of bay"))).to_have_count(2)
    until(page, lambda: any("after=7&" in path for path in client.asked))
    client.frame_age_ms = 60_000.0
    expect(page.locator(".tile .no-picture")).to_have_text(["no new picture", "no new picture"], timeout=6000)


SHOWN = """async () => {
  location.hash = 'bay_without_picture';
  const shown = [];
  for (let n = 0; n < 60; n += 1) {
    await new Promise(requestAnimationFrame);
    const of = document.querySelector('.picture canvas').getAttribute('aria-label');
    shown.push(`${of}: ${document.querySelector('.picture .tag').textContent}`);
  }
  return shown;
}"""


def test_the_picture_of_another_bay_is_never_shown_as_live(operator: Open, client: StandInServer) -> None:
    client.session["bays"] = ["bay1", "bay_without_picture"]
    page = operator(live([state("bay1"), state("bay_without_picture")]), "/#bay1")
    expect(page.locator(".picture .tag")).to_have_text("LIVE")
    shown = page.evaluate(SHOWN)
    assert shown[-1] == "No live picture of bay_without_picture: NOT LIVE"
    assert [each for each in shown if each.endswith(": LIVE") and "bay1" not in each] == []


def test_the_overview_counts_trucks_in_place(operator: Open, client: StandInServer) -> None:
    client.session["bays"] = ["bay1", "bay2", "bay3"]
    held = {**HERE, "held": True, "held_ms": 1000.0}
    page = operator(live([state("bay1", **HERE), state("bay2", **held), state("bay3")]))
    page.get_by_role("button", name="in place 2").click()
    expect(page.locator(".tile .why")).to_have_text(["Loading may start.", re.compile("^In place: loading may go on")])
    expect(page.locator(".tile .state b")).to_have_text(["IN PLACE", "IN PLACE"])


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


def test_a_tab_that_comes_back_shows_nothing_old_in_its_first_frame(operator: Open) -> None:
    """Its timers did not run meanwhile."""
    page = operator(live([state("bay1")]))
    expect(page.locator(".decision .word")).to_have_text("MAY MOVE")
    say(page, None)
    word = page.evaluate("""async () => {
      const [steady, wall] = [performance.now.bind(performance), Date.now];
      performance.now = () => steady() + 60_000;
      Date.now = () => wall() + 60_000;
      document.dispatchEvent(new Event('visibilitychange'));
      await new Promise(requestAnimationFrame);
      return document.querySelector('.decision .word').textContent;
    }""")
    assert word == "NOT KNOWN"


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


@pytest.mark.long
def test_a_broken_address_shows_all_bays(operator: Open, client: StandInServer) -> None:
    client.session["bays"] = ["bay1", "bay2"]
    page = operator(live([state("bay1"), state("bay2")]), "/#100%")
    expect(page.locator(".tile")).to_have_count(2)


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


@pytest.mark.long
def test_the_focus_stays_with_the_alarms_when_the_button_is_gone(operator: Open, client: StandInServer) -> None:
    client.alarms = (alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),)
    page = operator(live([broken("bay1")], client.alarms))

    def acknowledged(route: Route) -> None:
        client.alarms = (alarm("bay1", "camera_down", AlarmState.ACKNOWLEDGED),)
        route.fulfill(json={})

    page.route("**/acknowledge", acknowledged)
    button = page.get_by_role("button", name="Acknowledge Camera down")
    button.press("Enter")
    expect(button).to_have_count(0)
    expect(page.locator("#alarms")).to_be_focused()


def test_alarms_are_reset_shelved_removed_and_brought_back(operator: Open, client: StandInServer) -> None:
    client.alarms = (
        alarm("bay1", "camera_down", AlarmState.ACKNOWLEDGED),
        alarm("bay1", "task_crashed", AlarmState.LATCHED_ACKNOWLEDGED),
        alarm("bay1", "ranger_stale", AlarmState.SHELVED),
        alarm("bay1", "plc_lost", AlarmState.OUT_OF_SERVICE),
        alarm("bay1", "ranger_down", AlarmState.SUPPRESSED),
    )
    page = operator(live([state("bay1")], client.alarms))
    page.get_by_role("button", name="Reset Software fault").click()
    page.get_by_text("3 hidden: shelved, suppressed or out of service").click()
    expect(page.locator(".hidden-alarms button")).to_have_count(2)  # what is suppressed by design ends by itself
    page.get_by_role("button", name="Show again Ranger silent").click()
    page.get_by_role("button", name="Back into service PLC heartbeat lost").click()
    down = page.locator(".alarms li").filter(has_text="Camera down")
    down.get_by_text("Hide it").click()
    down.get_by_label("for how long").select_option("240")
    down.get_by_label("why").fill("new camera on Monday")
    down.get_by_role("button", name="Shelve").click()
    down.get_by_role("button", name="Out of service").click()
    until(page, lambda: len(client.posts) == 5)
    note = {"note": "new camera on Monday"}
    assert client.posts == [
        ("/api/alarms/bay1.task_crashed/reset", "token", {"occurrence": 3}),
        ("/api/alarms/bay1.ranger_stale/unshelve", "token", {"occurrence": 3}),
        ("/api/alarms/bay1.plc_lost/restore", "token", {"occurrence": 3}),
        ("/api/alarms/bay1.camera_down/shelve", "token", {"occurrence": 3, **note, "minutes": 240}),
        ("/api/alarms/bay1.camera_down/remove", "token", {"occurrence": 3, **note}),
    ]
    judgements.accessible(page)


def test_an_operator_resets_and_hides_nothing(operator: Open, client: StandInServer) -> None:
    client.session |= {"role": "viewer", "name": "anna"}
    client.alarms = (
        alarm("bay1", "task_crashed", AlarmState.LATCHED_ACKNOWLEDGED),
        alarm("bay1", "ranger_stale", AlarmState.SHELVED),
    )
    page = operator(live([state("bay1")], client.alarms))
    expect(page.get_by_role("button", name="Reset Software fault")).to_be_enabled()
    page.get_by_text("1 hidden").click()
    expect(page.get_by_role("button", name="Show again Ranger silent")).to_be_disabled()
    expect(page.get_by_text("Hide it")).to_have_count(0)


STRIPE = "(li) => getComputedStyle(li).borderLeftColor"


@pytest.mark.long
def test_a_stripe_has_the_colour_of_its_priority(operator: Open, client: StandInServer) -> None:
    client.alarms = (
        alarm("bay1", "camera_down", AlarmState.RETURNED),
        alarm("bay1", "in_place_lost", AlarmState.UNACKNOWLEDGED),
        alarm("bay1", "maintenance", AlarmState.UNACKNOWLEDGED),
        alarm("bay1", "ranger_stale", AlarmState.ACKNOWLEDGED),
    )
    page = operator(live([state("bay1")], client.alarms))
    expect(page.locator(".alarms li")).to_have_count(4)
    stripes = [page.locator(".alarms li").nth(n).evaluate(STRIPE) for n in range(4)]
    assert stripes == ["rgb(176, 0, 22)", "rgb(242, 194, 0)", "rgb(11, 95, 174)", "rgb(111, 120, 126)"]


def test_all_that_are_shown_are_acknowledged_at_once(operator: Open, client: StandInServer) -> None:
    client.session["bays"] = ["bay1", "bay2"]
    client.alarms = (
        alarm("bay1", "camera_down", AlarmState.RETURNED),
        alarm("bay2", "camera_down", AlarmState.UNACKNOWLEDGED),
        alarm("bay1", "maintenance", AlarmState.UNACKNOWLEDGED),
        alarm("bay1", "ranger_stale", AlarmState.ACKNOWLEDGED),
    )
    page = operator(live([state("bay1"), state("bay2")], client.alarms), "/#bay1")
    page.get_by_role("button", name="Acknowledge all 2 shown").click()
    until(page, lambda: len(client.posts) == 2)
    assert [path for path, _, _ in client.posts] == [
        "/api/alarms/bay1.camera_down/acknowledge",
        "/api/alarms/bay1.maintenance/acknowledge",
    ]


SOUNDS = """
window.__tones = [];
window.AudioContext = class extends EventTarget {
  state = 'suspended';
  currentTime = 0;
  resume() {
    if (window.__blocked) return Promise.reject(new Error('no click yet'));
    this.state = 'running';
    this.dispatchEvent(new Event('statechange'));
    return Promise.resolve();
  }
  close() { return Promise.resolve(); }
  destination = {};
  createOscillator() {
    const start = () => window.__tones.push(tone.frequency.value);
    const tone = { frequency: {}, connect: (to) => to, start, stop: () => {} };
    return tone;
  }
  createGain() { return { gain: {}, connect: (to) => to }; }
};
"""


def test_the_alarm_to_see_first_is_at_the_top_of_the_page(operator: Open, client: StandInServer) -> None:
    client.alarms = (
        alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),
        alarm("bay1", "maintenance", AlarmState.ACKNOWLEDGED),
    )
    page = operator(live([broken("bay1")], client.alarms))
    bar = page.locator(".alarmbar")
    for width_px, height_px in ((360, 640), (1280, 720), (1366, 768), (3840, 2160)):
        page.set_viewport_size({"width": width_px, "height": height_px})
        page.evaluate("() => { scrollTo(0, 0); document.activeElement?.blur(); }")
        say(page, live([broken("bay1")], client.alarms))
        expect(bar).to_contain_text("Camera down")
        expect(bar).to_contain_text("2 alarms, 1 not acknowledged")
        box = bar.bounding_box()
        assert box is not None
        assert box["y"] + box["height"] < height_px / 2
        assert page.title() == "(2) bay1"
        say(page, live([broken("bay1")]))
        expect(bar).to_have_text("No alarm.")
        assert bar.bounding_box() == {**box, "height": pytest.approx(box["height"], abs=1 if width_px > 700 else 60)}
        assert page.title() == "bay1"
        say(page, live([broken("bay1")], client.alarms))
        judgements.no_sideways_scroll(page)
        bar.get_by_role("link").click()
        expect(page.locator("#alarms")).to_be_focused()
        expect(page.locator("#alarms li").first).to_be_in_viewport()


@pytest.mark.long
def test_a_sound_that_the_browser_blocks_waits_for_a_click_and_comes_once(
    operator: Open, client: StandInServer
) -> None:
    client.alarms = (alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),)
    page = operator(live([broken("bay1")], client.alarms))
    page.evaluate("() => { window.__blocked = true;" + SOUNDS + "}")
    page.get_by_label("sound").check()
    expect(page.get_by_label("sound, after a click")).to_be_checked()
    for n in range(3):  # other alarms meanwhile
        client.alarms = (*client.alarms, alarm("bay1", "maintenance", AlarmState.UNACKNOWLEDGED))
        say(page, live([broken("bay1")], client.alarms))
        expect(page.locator(".alarmbar")).to_contain_text(f"{n + 2} not acknowledged")
    assert page.evaluate("() => window.__tones") == []
    page.evaluate("() => { window.__blocked = false; }")
    page.get_by_role("heading", name="Alarms").click()
    expect(page.get_by_label("sound", exact=True)).to_be_checked()
    assert page.evaluate("() => window.__tones") == [880, 880, 880]


def test_a_sound_for_alarms_is_off_until_it_is_switched_on(operator: Open, client: StandInServer) -> None:
    client.alarms = (alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),)
    page = operator(live([broken("bay1")], client.alarms))
    page.evaluate("() => {" + SOUNDS + "}")
    expect(page.locator(".alarmbar")).to_contain_text("Camera down")
    assert page.evaluate("() => window.__tones") == []
    page.get_by_label("sound").check()
    until(page, lambda: page.evaluate("() => window.__tones") == [880, 880, 880])
    client.alarms = (alarm("bay1", "camera_down", AlarmState.ACKNOWLEDGED),)
    say(page, live([broken("bay1")], client.alarms))
    expect(page.locator(".alarmbar")).to_contain_text("active, acknowledged")
    assert page.evaluate("() => window.__tones.length") == 3


LAYOUT = """() => {
  const box = (at) => {
    const r = document.querySelector(at).getBoundingClientRect();
    return { y: r.y, w: r.width, h: r.height, end: r.bottom };
  };
  const list = box('.events .scroll');
  const rows = [...document.querySelectorAll('.events tbody tr')].map((row) => row.getBoundingClientRect());
  const ends = [...document.querySelectorAll('.column')].map((column) => column.lastElementChild);
  const columns = ends.map((panel) => panel.getBoundingClientRect().bottom);
  return { picture: box('.view'), word: box('.decision .word'), below: box('.below'), header: box('.events > header'),
    list, rows: rows.filter((row) => row.height > 4 && row.bottom <= list.end + 1).length,
    inSight: rows.filter((row) => row.height > 4 && row.bottom <= Math.min(list.end + 1, innerHeight)).length,
    columns };
}"""


def settled(page: Page, frame: tuple[int, int]) -> bool:
    """Is the layout that of the picture, and of this size of the screen?"""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    picture = page.evaluate(LAYOUT)["picture"]
    size = page.viewport_size
    fits = size is not None and picture["h"] <= 0.6 * size["height"]
    return fits and abs(picture["w"] / picture["h"] - frame[0] / frame[1]) < 0.02 * frame[0] / frame[1]


SIZES = ((360, 740), (768, 1024), (1280, 720), (1366, 768), (1920, 1080), (3840, 2160))


@pytest.mark.mostly_long
@pytest.mark.parametrize("frame", [(640, 480), (1280, 720), (720, 720), (720, 1280)], ids=lambda frame: f"{frame}")
def test_no_shape_of_the_picture_collapses_the_page(
    operator: Open, client: StandInServer, frame: tuple[int, int]
) -> None:
    """With faults, which need room: the picture fits the screen, events are seen, nothing overlaps, a large screen is
    filled."""
    client.frame = frame
    kinds = ("camera_down", "ranger_stale", "in_place_lost")
    client.alarms = tuple(alarm("bay1", kind, AlarmState.UNACKNOWLEDGED) for kind in kinds)
    client.events = [{"number": n, "event": {**EVENT, "bay": "bay1", "id": f"{n}"}} for n in range(1, 41)]
    page = operator(live([broken("bay1")], client.alarms, events=40))
    expect(page.locator(".events tbody tr")).to_have_count(40)
    for width_px, height_px in SIZES:
        page.set_viewport_size({"width": width_px, "height": height_px})
        until(page, lambda: settled(page, frame))
        expect(page.locator(".events tbody tr")).to_have_count(40)  # asked for anew where they change their place
        at = page.evaluate(LAYOUT)
        size = f"{width_px} x {height_px}: {at}"
        assert at["picture"]["w"] / at["picture"]["h"] == pytest.approx(frame[0] / frame[1], rel=0.02), size
        assert at["picture"]["h"] > 150, size
        assert at["word"]["end"] < height_px, size
        assert at["rows"] >= 3, size
        assert at["header"]["end"] <= at["list"]["y"] + 1, size
        judgements.no_sideways_scroll(page)
        if width_px >= 1200:
            assert at["inSight"] >= 3, size
        if width_px >= 1700:
            assert at["below"]["end"] > 0.98 * height_px, size
            assert max(at["columns"][:2]) - min(at["columns"][:2]) < 2, size


@pytest.mark.mostly_long
@pytest.mark.parametrize("bays", [1, 12])
def test_the_last_trucks_are_seen_without_scrolling(operator: Open, client: StandInServer, bays: int) -> None:
    """On a small desk, beside the verdict, its reason and the picture."""
    client.session["bays"] = [f"bay{n}" for n in range(1, bays + 1)]
    truck = {"last_seen_ms": 1_795_000_000_000, "in_place_s": 412.0, "unintended": False, "faults": [], "end": "CLEAR"}
    client.trucks = [{**truck, "begun_ms": 1_795_000_000_000 - n * 1_500_000} for n in range(6)]
    client.alarms = (alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),)
    page = operator(live([broken("bay1")], client.alarms), "/#bay1")
    page.set_viewport_size({"width": 1366, "height": 768})
    expect(page.locator(".trucks a")).to_have_count(6)
    for what in (".trucks", ".decision", ".decision .why", ".view"):
        until(page, lambda what=what: page.locator(what).evaluate_all(ENDS)[0] <= 768)  # type: ignore[misc]


def test_a_moment_is_marked_with_a_note(operator: Open, client: StandInServer) -> None:
    page = operator(live([state("bay1")]))
    page.get_by_role("button", name="Mark this moment").click()
    page.get_by_label("note for the mark").fill("driver complains")
    page.get_by_role("button", name="Mark", exact=True).click()
    until(page, lambda: client.posts)
    assert client.posts == [("/api/bays/bay1/mark", "token", {"note": "driver complains"})]
    expect(page.get_by_role("button", name="Mark this moment")).to_be_visible()


@pytest.mark.long
def test_the_focus_goes_to_the_note_of_a_mark_and_back(operator: Open, client: StandInServer) -> None:
    page = operator(live([state("bay1")]))
    mark, note = page.get_by_role("button", name="Mark this moment"), page.get_by_label("note for the mark")
    for _ in range(2):
        mark.press("Enter")
        expect(note).to_be_focused()
        page.get_by_role("button", name="Cancel").press("Enter")
        expect(mark).to_be_focused()
    mark.press("Enter")
    note.press("Enter")
    until(page, lambda: client.posts)
    expect(mark).to_be_focused()


@pytest.mark.long
def test_an_event_of_another_day_has_its_date(operator: Open, client: StandInServer) -> None:
    now_ms = round(1000 * time.time())
    times = (now_ms - 3 * 86_400_000, now_ms)
    client.events = [
        {"number": n, "event": {**EVENT, "bay": "bay1", "id": f"{n}", "timestamp_ms": t}}
        for n, t in enumerate(times, 1)
    ]
    page = operator(live([state("bay1")], events=2))
    when = page.locator(".events tbody tr td:first-child")
    expect(when).to_have_text(
        [re.compile(r"^\d\d:\d\d:\d\d\.\d{3}$"), re.compile(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}$")]
    )


def test_a_visitor_without_a_name_cannot_acknowledge_and_sees_no_tuning(operator: Open, client: StandInServer) -> None:
    client.session["role"] = "viewer"
    client.alarms = (alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),)
    page = operator(live([broken("bay1")], client.alarms))
    expect(page.get_by_role("button", name="Acknowledge Camera down")).to_be_disabled()
    expect(page.get_by_role("button", name="Mark this moment")).to_have_count(0)
    expect(page.get_by_role("link", name="Set up")).to_have_count(0)
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
