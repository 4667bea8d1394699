"""What a log or an MQTT subscriber gets, for each pair of states."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import CrossCheck, FusionConfig
from gateway.core.detection import Circle
from gateway.core.events import Event, EventKind, diff
from gateway.core.fusion import initial, step
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FusionMemory, StateVector, Tick
from tests.examples import examples

CALM = StateVector(bay="bay3", t_ns=77, stop=False, may_move=True)


def with_vision(quality: Quality, detail: str = "") -> StateVector:
    return replace(CALM, vision=VisionReading(0, quality, detail=detail))


def with_range(quality: Quality, detail: str = "") -> StateVector:
    return replace(CALM, range=RangeReading(0, quality, detail=detail))


def reported(old: StateVector, new: StateVector) -> list[tuple[str, str, Quality, str]]:
    return [(e.kind.value, e.sensor, e.quality, e.detail) for e in diff(old, new)]


def test_nothing_happened() -> None:
    assert diff(CALM, replace(CALM, t_ns=78, seq=5, heartbeat=9)) == []


def test_an_event_carries_the_new_state_and_its_time() -> None:
    new = replace(CALM, t_ns=99, stop=True)

    assert diff(CALM, new) == [Event(EventKind.STOP_RAISED, "bay3", 99, new)]


def test_stop_and_target_edges() -> None:
    seen = replace(CALM, memory=FusionMemory(target_seen=True))
    stopped = replace(CALM, stop=True)

    assert reported(CALM, stopped) == [("stop_raised", "", Quality.GOOD, "")]
    assert reported(stopped, CALM) == [("stop_cleared", "", Quality.GOOD, "")]
    assert reported(CALM, seen) == [("target_found", "", Quality.GOOD, "")]
    assert reported(seen, CALM) == [("target_lost", "", Quality.GOOD, "")]
    assert reported(seen, seen) == reported(stopped, stopped) == []


FINE_VISION = {Quality.GOOD, Quality.WAITING, Quality.NO_TARGET, Quality.COASTED}
FINE_RANGE = {Quality.GOOD, Quality.WAITING}


@pytest.mark.parametrize("before", Quality)
@pytest.mark.parametrize("now", Quality)
def test_every_change_of_a_sensor(before: Quality, now: Quality) -> None:
    """An empty bay is no fault of the camera; every other complaint is one, and each new one is reported."""
    for name, fine, make in (("vision", FINE_VISION, with_vision), ("range", FINE_RANGE, with_range)):
        if now not in fine and now is not before:
            expected = [("sensor_fault", name, now, "why")]
        elif now in fine and before not in fine:
            expected = [("sensor_recovered", name, now, "")]
        else:
            expected = []
        assert reported(make(before, "old"), make(now, "why")) == expected


def test_a_disagreement_is_a_fault_of_its_own() -> None:
    apart = replace(
        CALM,
        memory=FusionMemory(disagree=True),
        z_vision_mm=600.4,
        range=RangeReading(0, Quality.GOOD, 299.6),
    )
    blind = replace(CALM, memory=FusionMemory(disagree=True), z_vision_mm=600.0)
    deaf = replace(apart, z_vision_mm=None)

    detail = "camera sees 600 mm, ranger 300 mm"
    assert reported(CALM, apart) == [("sensor_fault", "cross_check", Quality.GOOD, detail)]
    assert reported(CALM, blind) == reported(CALM, deaf) == [("sensor_fault", "cross_check", Quality.GOOD, "")]
    assert reported(apart, CALM) == [("sensor_recovered", "cross_check", Quality.GOOD, "")]
    assert reported(apart, replace(apart, memory=FusionMemory())) == reported(apart, CALM)
    assert reported(apart, apart) == []


def test_causes_come_before_consequences() -> None:
    new = StateVector(
        bay="bay3",
        vision=VisionReading(0, Quality.LINK_DOWN),
        range=RangeReading(0, Quality.STUCK),
        memory=FusionMemory(disagree=True, target_seen=True),
        stop=True,
    )

    assert [(e.kind.value, e.sensor) for e in diff(CALM, new)] == [
        ("sensor_fault", "vision"),
        ("sensor_fault", "range"),
        ("sensor_fault", "cross_check"),
        ("target_found", ""),
        ("stop_raised", ""),
    ]


MS = 1_000_000
CONFIG = FusionConfig(cross_check=CrossCheck(focal_px=600, marker_radius_mm=90, lasting_s=0.1))
MOVES = st.lists(
    st.tuples(st.integers(0, 400), st.sampled_from(Quality), st.sampled_from([50.0, 200.0, 400.0]), st.booleans()),
    max_size=60,
)


@given(MOVES)
@settings(max_examples=examples(80), deadline=None)
def test_over_any_time_events_report_every_change(moves: list[tuple[int, Quality, float, bool]]) -> None:
    """Replaying the events alone gives the last state's stop, target, faults and disagreement."""
    state = initial("bay1", 0)
    now_ns = 0
    stop, target, disagree = state.stop, False, False
    faults: dict[str, Quality | None] = {"vision": None, "range": None}
    for ms, quality, value, vision in moves:
        now_ns += ms * MS
        for observation in (
            VisionReading(now_ns, quality, Circle(1, 2, value)) if vision else RangeReading(now_ns, quality, value),
            Tick(),
        ):
            old, state = state, step(state, observation, now_ns, CONFIG)
            for event in diff(old, state):
                assert (event.bay, event.t_ns, event.state) == ("bay1", now_ns, state)
                match event.kind, event.sensor:
                    case EventKind.STOP_RAISED | EventKind.STOP_CLEARED as kind, "":
                        assert stop is (kind is EventKind.STOP_CLEARED)
                        stop = not stop
                    case EventKind.TARGET_FOUND | EventKind.TARGET_LOST as kind, "":
                        assert target is (kind is EventKind.TARGET_LOST)
                        target = not target
                    case EventKind.SENSOR_FAULT | EventKind.SENSOR_RECOVERED as kind, "cross_check":
                        assert disagree is (kind is EventKind.SENSOR_RECOVERED)
                        disagree = not disagree
                    case EventKind.SENSOR_FAULT, sensor:
                        assert faults[sensor] is not event.quality
                        faults[sensor] = event.quality
                    case EventKind.SENSOR_RECOVERED, sensor:
                        assert faults[sensor] is not None
                        faults[sensor] = None
                    case _:
                        raise AssertionError(event)
    assert (stop, target, disagree) == (state.stop, state.memory.target_seen, state.memory.disagree)
    assert faults["vision"] is (None if state.vision.quality in FINE_VISION else state.vision.quality)
    assert faults["range"] is (None if state.range.quality in FINE_RANGE else state.range.quality)
