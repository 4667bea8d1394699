"""The other pages for desks without a gateway: what only an answer that comes late, or never, shows."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from gateway.alarms.states import AlarmState
from gateway.web.server import models
from tests.browser.alone import HOST, SOCKET, from_disk, say
from tests.browser.chromium import Watch, until
from tests.browser.test_operator_alone import alarm, broken, live, state, summary

HOUR_MS = 3_600_000
LAST_MS = 1_795_000_020_000  # a full minute
Answers = dict[str, Any]
Open = Callable[..., Page]


@pytest.fixture
def answers() -> Answers:
    """What is answered, by the path without its query: JSON, or a function that gets the route. 404 else."""
    nothing = {"recorded": False, "why": "", "first_ms": None, "last_ms": None, "pictures": "shown"}
    return {
        "/api/session": {"name": None, "role": "technician", "can_login": True, "csrf": "token", "bays": ["bay1"]},
        "/api/bays/bay1/records": {"bay": "bay1", **nothing},
        "/api/bays/bay1/calibration": {"phase": "none"},
    }


@pytest.fixture
def desk(browser: Browser, answers: Answers) -> Iterator[Open]:
    watch = Watch(HOST)
    context = browser.new_context(viewport={"width": 1366, "height": 900})

    def answer(route: Route) -> None:
        found = answers.get(route.request.url.removeprefix(f"http://{HOST}").partition("?")[0])
        if callable(found):
            found(route)
        elif found is None:
            route.fulfill(status=404)
        else:
            route.fulfill(json=found)

    def opened(path: str, excused: str | None = None) -> Page:
        watch.excused = None if excused is None else re.compile(excused)
        watch.over(context)
        context.add_init_script(SOCKET)
        context.route("**/*", from_disk)
        context.route("**/api/**", answer)
        context.route("**/api/languages**", from_disk)
        context.route("**/api/pages", from_disk)
        page = context.new_page()
        page.goto(f"http://{HOST}{path}")
        return page

    yield opened
    context.close()
    assert watch.complaints == []


@pytest.mark.parametrize(("path", "about"), [("/history", "History of bay1"), ("/calibrate/bay1", "Calibration bay1")])
def test_every_page_has_the_alarm_to_see_first_and_their_number(
    desk: Open, answers: Answers, path: str, about: str
) -> None:
    listed = (
        alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),
        alarm("bay1", "maintenance", AlarmState.ACKNOWLEDGED),
    )
    page = desk(path)
    say(page, models.AlarmsLiveView(alarms=summary(listed)).model_dump(mode="json"))
    bar = page.locator(".alarmbar")
    expect(bar).to_contain_text("Camera down")
    expect(bar).to_contain_text("active, not acknowledged")
    badge = bar.get_by_role("link", name="2 alarms, 1 not acknowledged")
    expect(badge).to_have_attribute("href", "/#bay1")
    expect(page).to_have_title(f"(2) {about}")
    say(page, "nonsense")
    expect(bar).to_contain_text("The alarms are not known")
    expect(page).to_have_title(about)  # nor is their number


def test_no_alarm_is_not_said_where_alarms_are_suppressed_and_sensors_missing(desk: Open) -> None:
    page = desk("/history")
    counts = {"suppressed": 20, "shelved": 1, "out_of_service": 2, "silent_sensors": 2, "function_checks": 1}
    say(page, models.AlarmsLiveView(alarms=summary(()).model_copy(update=counts)).model_dump(mode="json"))
    expect(page.locator(".alarmbar")).to_have_text(
        "No alarm is shown. Suppressed: 20. Shelved: 1. Out of service: 2. Function checks that are on: 1."
        " Cameras and rangers that deliver nothing: 2."
    )
    say(page, models.AlarmsLiveView(alarms=summary(())).model_dump(mode="json"))
    expect(page.locator(".alarmbar")).to_have_text("No alarm.")


def test_a_bay_is_set_up_only_when_its_camera_and_its_ranger_are_seen_working(desk: Open, answers: Answers) -> None:
    """And what was seen does not stay when the gateway says no more."""
    (fine, dead) = live([state("bay1"), broken("bay1")])["bays"]
    answers["/api/bays/bay1/state"] = dead
    page = desk("/setup/new-bay?started=bay1", excused="status of 404")
    heading, missing = page.locator("#step-title"), page.locator(".step [role=alert] li")
    expect(heading).to_have_text("bay1 is not set up yet")
    expect(missing).to_have_text(["camera: link down; connection refused"])
    answers["/api/bays/bay1/state"] = fine
    expect(heading).to_have_text("bay1 is set up")
    expect(page.locator("[data-started]")).to_contain_text("MAY MOVE")
    answers["/api/bays/bay1/state"] = lambda _: None  # no answer to the end of the test
    expect(heading).to_have_text("bay1 is not set up yet")
    expect(missing).to_have_text(["camera: not known", "ranger: not known"])
    expect(page.locator("[data-started]")).to_contain_text("NOT KNOWN")


@pytest.mark.long
def test_a_login_that_has_ended_leads_to_the_login(desk: Open, answers: Answers) -> None:
    page = desk("/history", excused="status of 401")
    bar = page.locator(".alarmbar")
    say(page, models.AlarmsLiveView(alarms=summary(())).model_dump(mode="json"))
    expect(bar).to_have_text("No alarm.")
    page.evaluate("() => window.__socket.close()")
    expect(bar).to_contain_text("The alarms are not known")
    expect(bar).to_have_text("No alarm.")  # connected again
    say(page, None)  # no place for one more page: asked for over HTTP, again and again
    one = summary((alarm("bay1", "camera_down", AlarmState.UNACKNOWLEDGED),))
    answers["/api/alarms"] = {"summary": one.model_dump(mode="json")}
    page.evaluate("() => window.__socket.close()")
    expect(bar).to_contain_text("The alarms are not known")
    expect(bar).to_contain_text("Camera down")  # the next connection was silent, too
    answers["/api/alarms"] = lambda route: route.fulfill(status=401, json={})
    page.evaluate("() => window.__socket.close()")
    page.wait_for_url("**/login?**")


PICTURE = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
BOARD = {"kind": "checkerboard", "columns": 9, "rows": 6, "pitch_mm": 25.0, "distortion": "auto"}


def test_a_number_that_is_deleted_is_none_and_not_zero(desk: Open, answers: Answers) -> None:
    page = desk("/calibrate/bay1")
    field = page.get_by_label("inner corners in a row")
    field.press("Control+a")
    field.press("Backspace")
    expect(field).to_have_value("")
    expect(field).to_have_attribute("aria-invalid", "true")
    field.press_sequentially("11")
    expect(field).to_have_value("11")
    expect(page.get_by_role("button", name="Begin")).to_be_enabled()

    answers["/api/state"] = []
    answers["/api/setup/settings"] = {
        "values": {"bays": {}, "modbus": {"host": "127.0.0.1"}}, "written": {}, "faults": [], "waiting": [],
        "command_line": [], "why_not": "", "file": "plant.toml", "digest": "0", "restart_s": 10,
    }  # fmt: skip
    page.goto(f"http://{HOST}/setup/new-bay")
    field = page.get_by_label("Modbus unit id")
    field.press("Control+a")
    field.press("Backspace")
    expect(field).to_have_value("")
    expect(page.get_by_text("a whole number from 1 to 247")).to_be_visible()
    field.press_sequentially("12")
    expect(field).to_have_value("12")


@pytest.mark.parametrize(("units", "shown"), [("metric", "1234\u202fmm"), ("imperial", "48.6\u202fin")])
def test_the_distance_of_a_view_is_in_the_viewers_units(desk: Open, answers: Answers, units: str, shown: str) -> None:
    view = {
        "number": 1, "name": "view-1.png", "taken_ms": LAST_MS, "outline": [[0, 0], [9, 0], [9, 9], [0, 9]],
        "size_share": 0.2, "right_deg": 0.0, "bottom_deg": 0.0,
    }  # fmt: skip
    fit = {
        "name": "view-1.png", "rms_px": 0.2, "largest_px": 0.5, "tilt_deg": 10.0, "distance_mm": 1234.0, "used": True,
    }  # fmt: skip
    answers["/api/bays/bay1/calibration"] = {
        "phase": "running", "who": "anna", "mine": True, "board": BOARD, "width_px": 640, "height_px": 480,
        "revision": 1, "views": [view], "coverage": [[1]], "covered": 1.0, "distances": 1.0, "missing": [],
        "wanted": 10, "most": 40,
    }  # fmt: skip
    answers["/api/bays/bay1/calibration/result"] = {
        "why": "", "revision": 1, "parameters": [], "rms_px": 0.2, "views": [fit], "worst": None, "warnings": [],
        "toml": "", "command": "", "changes": [],
    }  # fmt: skip
    answers["/api/bays/bay1/calibration/look"] = lambda _: None  # no answer to the end of the test
    answers["/api/bays/bay1/calibration/views/1/picture"] = lambda route: route.fulfill(body=PICTURE)
    page = desk(f"/calibrate/bay1?units={units}")
    expect(page.locator("[data-view='1']")).to_contain_text(f"rms 0.200\u202fpx · {shown} · 10°")


def bucket(t_ms: int) -> dict[str, Any]:
    """A minute of which all was recorded."""
    return {
        "t_ms": t_ms, "recorded_s": 60.0, "may_move_s": 60.0, "in_place_s": 0.0, "stop_s": {}, "frames": 600,
        "faults": 0, "r_min": 90.0, "r_mean": 95.0, "r_max": 99.0, "z_min": 800.0, "z_mean": 900.0, "z_max": 950.0,
    }  # fmt: skip


# Painted pixels in the row "in place" of the timeline: where all was recorded a surface, where nothing was a hatching.
PAINTED = """(canvas) => {
  const { width, height } = canvas;
  const [left, top] = [Math.round(0.3 * width), Math.round(0.35 * height)];
  const { data } = canvas.getContext('2d').getImageData(left, top, Math.round(0.6 * width), Math.round(0.08 * height));
  let count = 0;
  for (let at = 3; at < data.length; at += 4) count += data[at] > 0;
  return count;
}"""


def test_a_stretch_that_is_not_here_yet_is_not_shown_as_one_of_which_nothing_was_recorded(
    desk: Open, answers: Answers
) -> None:
    minutes = [bucket(LAST_MS - n * 60_000) for n in range(70, 0, -1)]
    held: list[Route] = []
    records = {"first_ms": LAST_MS - 48 * HOUR_MS, "last_ms": LAST_MS}
    answers["/api/bays/bay1/records"] |= {"recorded": True, "alarms": {}, **records}
    answers["/api/bays/bay1/trend"] = {"bay": "bay1", "bucket_ms": 60_000, "buckets": minutes}
    answers["/api/bays/bay1/history-events"] = {"bay": "bay1", "events": []}
    answers["/api/bays/bay1/visits"] = {"bay": "bay1", "visits": [], "more": False}
    page = desk(f"/history#bay1/{LAST_MS - HOUR_MS // 2}/hour")
    read, strip = page.locator(".past .read"), page.locator(".past .strip")
    expect(read).to_contain_text("mean 95")
    until(page, lambda: strip.evaluate(PAINTED) > 1000)
    answers["/api/bays/bay1/trend"] = held.append
    page.get_by_role("button", name="Earlier").click()
    page.get_by_role("button", name="Earlier").click()
    until(page, lambda: held)
    page.locator(".past .u-over").first.hover()
    expect(read).to_contain_text("Loading.")
    expect(read).not_to_contain_text("nothing recorded")
    until(page, lambda: strip.evaluate(PAINTED) == 0)
    held[-1].fulfill(json={"bay": "bay1", "bucket_ms": 60_000, "buckets": []})
    expect(read).to_contain_text("nothing recorded")
    until(page, lambda: strip.evaluate(PAINTED) > 100)
