"""What a log or an MQTT subscriber gets, for each pair of states."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import CrossCheck, FusionConfig
from gateway.core.detection import Circle
from gateway.core.events import Event, EventKind, diff
from gateway.core.fusion import initial
from gateway.core.plc import Handshake, PlcLink, RecipeVerdict, ResetVerdict, Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FusionMemory, Moved, StateVector, Tick, TruckPosition, Visit
from tests.examples import examples
from tests.fused import step

CALM = StateVector(bay="bay3", t_ns=77, stop=False, may_move=True, valid_until_ns=10**9)


def with_vision(quality: Quality, detail: str = "") -> StateVector:
    return replace(CALM, vision=VisionReading(0, quality, detail=detail))


def with_range(quality: Quality, detail: str = "") -> StateVector:
    return replace(CALM, range=RangeReading(0, quality, detail=detail))


def reported(old: StateVector, new: StateVector) -> list[tuple[str, str, Quality, str]]:
    found = diff(old, new)
    assert all((e.bay, e.t_ns, e.state) == (new.bay, new.t_ns, new) for e in found)
    return [(e.kind.value, e.sensor, e.quality, e.detail) for e in found]


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


def test_without_a_cross_check_both_values_of_a_disagreement_are_reported() -> None:
    lamp = VisionReading(0, Quality.GOOD, Circle(40.4, 399.6, 20.04))
    apart = replace(CALM, memory=FusionMemory(disagree=True), vision=lamp, range=RangeReading(0, Quality.GOOD, 299.6))
    detail = "R x Z is not that of this marker: Z 300 mm, R 20.0 px at (40, 400)"
    assert reported(CALM, apart) == [("sensor_fault", "cross_check", Quality.GOOD, detail)]
    deaf = replace(apart, range=RangeReading(0, Quality.GOOD))
    assert reported(CALM, deaf) == [("sensor_fault", "cross_check", Quality.GOOD, "")]
    assert reported(apart, replace(apart, memory=FusionMemory())) == [
        ("sensor_recovered", "cross_check", Quality.GOOD, "")
    ]


def with_visit(**fields: Any) -> StateVector:
    return replace(CALM, visit=Visit(**fields))


PLACE = TruckPosition(280.4, Circle(320.3, 239.8, 193.04))
AT_PLACE = "Z 280 mm, R 193.0 px at (320, 240)"


def test_a_visit_from_in_place_to_its_end() -> None:
    placed = with_visit(in_place=True, place=PLACE)
    released = with_visit(place=PLACE, released=True, ended="released")
    clear = with_visit(clear_since_ns=70, ended="released")
    assert reported(CALM, placed) == [("in_place", "", Quality.GOOD, AT_PLACE)]
    assert reported(placed, released) == [
        ("in_place_ended", "", Quality.GOOD, "released"),
        ("released", "", Quality.GOOD, "by the PLC"),
    ]
    assert reported(released, clear) == [("visit_ended", "", Quality.GOOD, "the bay is clear")]
    assert reported(placed, placed) == reported(released, released) == reported(clear, clear) == []
    assert reported(placed, CALM) == [("in_place_ended", "", Quality.GOOD, "the gateway can't vouch for it")]
    assert reported(released, CALM) == [], "nothing shows that the bay is clear"


def test_a_move_is_reported_with_the_place_before_and_after() -> None:
    placed = with_visit(in_place=True, place=PLACE)
    moved = with_visit(place=PLACE, moved=Moved.DISTANCE, ended="moved")
    now_at = replace(
        moved,
        vision=VisionReading(0, Quality.GOOD, Circle(300.0, 240.0, 150.0)),
        range=RangeReading(0, Quality.GOOD, 361.5),
    )
    meaning = Moved.DISTANCE.meaning
    assert reported(placed, now_at) == [
        ("moved", "", Quality.GOOD, f"{meaning}: {AT_PLACE} -> Z 362 mm, R 150.0 px at (300, 240)"),
        ("in_place_ended", "", Quality.GOOD, "moved"),
    ]
    assert reported(placed, moved)[0][3] == f"{meaning}: {AT_PLACE} -> Z unknown, marker not seen"
    assert reported(moved, moved) == []
    assert reported(moved, with_visit(place=PLACE)) == [], "a reset ended it"


def with_plc(link: PlcLink = PlcLink.ALIVE, **fields: Any) -> StateVector:
    return replace(CALM, plc=Handshake(link=link, **fields))


def of_plc(old: StateVector, new: StateVector) -> list[tuple[str, str]]:
    return [(kind, detail) for kind, _, _, detail in reported(old, new)]


def test_the_heartbeat_and_the_owner_of_the_handshake_block() -> None:
    waiting, alive = with_plc(PlcLink.WAITING), with_plc(heartbeat=7)
    lost = with_plc(PlcLink.LOST, heartbeat=7)
    assert of_plc(waiting, alive) == of_plc(lost, alive) == [("plc_returned", "plc_heartbeat is 7")]
    assert of_plc(alive, lost) == [("plc_lost", "plc_heartbeat stopped at 7")]
    assert of_plc(alive, waiting) == of_plc(alive, with_plc(heartbeat=8)) == []
    first, second = Writer("10.0.0.9", "plc1", "viewer"), Writer("10.0.0.8")
    assert of_plc(with_plc(), with_plc(owner=first)) == of_plc(with_plc(owner=first), with_plc()) == []
    assert of_plc(with_plc(owner=first), with_plc(owner=replace(first, role="operator"))) == []
    assert of_plc(with_plc(owner=first), with_plc(owner=second)) == [
        ("owner_changed", "10.0.0.9 (plc1, role viewer) -> 10.0.0.8")
    ]


def test_what_became_of_a_recipe() -> None:
    none, seven = with_plc(), with_plc(recipe=7, recipe_asked=7, recipe_verdict=RecipeVerdict.ACTIVE)
    unknown = with_plc(recipe=7, recipe_asked=9, recipe_verdict=RecipeVerdict.UNKNOWN)
    assert of_plc(none, seven) == [("recipe_changed", "recipe 0 -> 7")]
    assert of_plc(seven, unknown) == [("write_refused", "recipe 9: unknown")]
    assert of_plc(unknown, seven) == of_plc(unknown, unknown) == of_plc(seven, seven) == []


def test_the_end_of_a_latched_stop() -> None:
    latched, free = FusionMemory(latched=True), FusionMemory()
    before = replace(with_plc(reset_verdict=ResetVerdict.DONE, writes=4), memory=latched)
    reset = replace(with_plc(reset_verdict=ResetVerdict.DONE, writes=5), memory=free)
    refused = replace(with_plc(reset_verdict=ResetVerdict.CAUSE_STANDS, writes=5), memory=free)
    assert of_plc(before, reset) == [("latch_released", "reset by the PLC")]
    assert of_plc(before, refused) == [("latch_released", "the truck has left")]
    assert of_plc(before, replace(before, memory=free)) == [("latch_released", "the truck has left")]
    assert of_plc(reset, before) == of_plc(before, before) == of_plc(reset, reset) == []


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
    state = replace(initial("bay1", 0), valid_until_ns=10**12)
    now_ns = 0
    stop, target, disagree = state.stop, False, False
    faults: dict[str, Quality | None] = {"vision": None, "range": None}
    for ms, quality, value, vision in moves:
        now_ns += ms * MS
        for observation in (
            VisionReading(now_ns, quality, Circle(1, 2, value)) if vision else RangeReading(now_ns, quality, value),
            Tick(),
        ):
            old, state = state, step(state, observation, now_ns, CONFIG, valid_until_ns=10**12)
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
