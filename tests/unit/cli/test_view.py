"""The terminal view at the sizes that terminals have. What matters must be seen: stops, and the newest events."""

import io
from dataclasses import replace
from datetime import datetime

import pytest
from rich.console import Console, RenderableType

from gateway import config
from gateway.cli import view
from gateway.core import fusion
from gateway.core.detection import Circle, Ellipse, Tracking
from gateway.core.events import Event, EventKind
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector
from gateway.hub import Hub
from tests import fused
from tests.virtual_time import LoopClock, run

MS = 1_000_000


def good(bay: str = "bay1", radius_px: float = 120.0, distance_mm: float = 450.0) -> StateVector:
    state = fusion.initial(bay, 0)
    settings = config.FusionConfig(decision="plain")
    state = fused.step(state, VisionReading(0, Quality.GOOD, Circle(320, 240, radius_px)), 0, settings)
    return fused.step(state, RangeReading(0, Quality.GOOD, distance_mm), 0, settings)


def lost(bay: str) -> StateVector:
    down = VisionReading(0, Quality.LINK_DOWN, detail="unplugged")
    return fused.step(good(bay), down, 0, config.FusionConfig())


def drawn(part: RenderableType, width: int = 120, height: int = 40) -> list[str]:
    console = Console(width=width, height=height, file=io.StringIO(), force_terminal=True, color_system=None)
    with console.capture() as capture:
        console.print(part)
    return [line.rstrip() for line in capture.get().splitlines()]


def picture(states: list[StateVector], events: list[Event], width: int, height: int) -> list[str]:
    async def main() -> list[str]:
        names = [state.bay for state in states]
        hub = Hub(names)
        console = Console(width=width, height=height, file=io.StringIO(), force_terminal=True, color_system=None)
        bays = [{"name": name, "unit_id": n} for n, name in enumerate(names, 1)]
        settings = config.parse({"bays": bays})
        clock = LoopClock()
        screen = view.TerminalView(settings, hub, clock, console, lambda: "header")
        for state in states:
            now_ns = clock.now_ns() + state.t_ns
            now = replace(state, t_ns=now_ns, valid_until_ns=now_ns + 250 * MS)
            hub.publish(now, [event for event in events if event.bay == state.bay])
        return drawn(screen.picture(), width, height)

    return run(main())


def test_a_bay_whose_control_task_is_dead_is_not_drawn_as_good() -> None:
    fine = "\n".join(picture([good()], [], 120, 40))
    assert "APPROACH" in fine
    assert "may move yes" in fine
    dead = "\n".join(picture([replace(good(), t_ns=-251 * MS)], [], 120, 40))
    assert "STOP" in dead
    assert "may move no" in dead
    assert "the gateway's own control task does not run" in dead
    assert "120.0 px" not in dead


def raised(bay: str, n: int) -> Event:
    return Event(EventKind.SENSOR_FAULT, bay, n, good(bay), "vision", Quality.LINK_DOWN, f"number {n}")


@pytest.mark.parametrize("width", [60, 70, 80, 130])
def test_a_bar_keeps_its_threshold_mark_or_is_not_there(width: int) -> None:
    lines = drawn(view.bay_panel(config.BayConfig(), good(), 5 * MS, width), width)
    (radius,) = [line for line in lines if "120.0 px" in line]
    assert ("┃" in radius) == (width >= view.BESIDE_BAR + view.MIN_BAR_CELLS)
    assert "< 180" in radius
    assert "good" in radius


def test_stop_is_shown_in_words() -> None:
    assert any("APPROACH" in line for line in drawn(view.bay_panel(config.BayConfig(), good(), 0)))
    near = drawn(view.bay_panel(config.BayConfig(), good(radius_px=200, distance_mm=280), 0))
    assert any("STOP" in line for line in near)
    assert any("D = 1" in line for line in near)


def test_four_bays_on_a_small_terminal_are_all_seen_with_the_newest_events() -> None:
    states = [good("bay1"), lost("bay2"), good("bay3"), lost("bay4")]
    lines = picture(states, [raised("bay1", n) for n in range(20)], 80, 24)
    assert len(lines) < 24
    for name, word in (("bay1", "approach"), ("bay2", "STOP"), ("bay3", "approach"), ("bay4", "STOP")):
        assert any(line.startswith(name) and word in line for line in lines)
    assert "number 19" in "\n".join(lines)


def test_where_not_all_bays_fit_those_in_trouble_come_first_and_the_rest_is_counted() -> None:
    states = [good(f"bay{n}") for n in range(60)] + [lost("last")]
    lines = picture(states, [], 80, 20)
    assert len(lines) < 20
    (row,) = [line for line in lines if line.startswith("last")]
    assert "STOP" in row
    shown = sum(line.startswith(("bay", "last")) for line in lines)
    assert any(line.startswith(f"… {61 - shown} more") for line in lines)


def test_one_bay_on_a_large_terminal_has_its_panel_and_eight_events() -> None:
    lines = picture([good()], [raised("bay1", n) for n in range(20)], 120, 40)
    text = "\n".join(lines)
    assert "heartbeat" in text
    assert [n for n in range(20) if f"number {n}" in text and f"number {n}0" not in text][-8:] == list(range(12, 20))


def test_a_recovery_does_not_borrow_the_reason_of_a_stop() -> None:
    state = replace(good(), stop=True, reason=Reason.VISION_STALE)
    recovered = Event(EventKind.SENSOR_RECOVERED, "bay1", 0, state, "range")
    stopped = Event(EventKind.STOP_RAISED, "bay1", 0, state)
    when = datetime(2026, 1, 2, 3, 4, 5, 678_900)
    assert view.event_line(when, recovered) == "03:04:05.678  bay1  sensor recovered range"
    assert (
        view.event_line(when, stopped) == "03:04:05.678  bay1  stop raised  the newest frame is older than its deadline"
    )


def test_how_the_marker_was_seen() -> None:
    seen = VisionReading(
        0,
        Quality.GOOD,
        Circle(320, 240, 120),
        ellipse=Ellipse(320, 240, 120, 103.92, 0),
        confidence=0.987,
        visible=0.75,
        tracking=Tracking.MEASURED,
    )
    state = fused.step(good(), seen, 0, config.FusionConfig())
    assert view.sight(state) == "marker: measured · confidence 99 % · 75 % of the rim seen · tilt 30°"
    assert any("confidence 99 %" in line for line in drawn(view.bay_panel(config.BayConfig(), state, 0)))
    assert view.sight(good()) == ""  # a method that tells nothing more
    assert view.sight(lost("bay1")) == ""

    hidden = VisionReading(0, Quality.COASTED, tracking=Tracking.COASTED, predicted=Circle(322.4, 240, 121.5))
    state = fused.step(state, hidden, 0, config.FusionConfig())
    lines = drawn(view.bay_panel(config.BayConfig(), state, 0))
    assert any("should be at (322, 240) px with R 122: predicted, not measured" in line for line in lines)
    assert any("STOP" in line for line in lines)
    assert any("centre –" in line for line in lines)  # no prediction where a measurement stands
