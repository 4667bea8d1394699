"""Every row of docs/visit.md and of what goes wrong in it, on the real step in virtual time."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import groupby, pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import FusionConfig, GatewayConfig, GuidanceConfig, VisitConfig
from gateway.core import interlock, visit
from gateway.core.detection import Circle
from gateway.core.events import EventKind
from gateway.core.plc import Control, PlcWrite, ResetVerdict
from gateway.core.readings import DEAD, Quality, RangeReading, VisionReading
from gateway.core.retained import RetainedState, RetainedTruck
from gateway.core.scale import ScaleSample
from gateway.core.state import (
    FunctionCheck,
    Fused,
    GuidanceCode,
    Moved,
    Reason,
    Tick,
    TruckPosition,
    Visit,
    VisitPhase,
)
from gateway.sim.scenario import Scenario
from tests.examples import examples
from tests.visit_bench import MOMENTS_HZ, PLC, Bench, Levels, gateway, truck
from tests.visit_judge import Row, complaints

pytestmark = pytest.mark.one_interpreter

CROSS_CHECK = {"focal_px": 600.0, "marker_radius_mm": 90.0}
LEAVE: Mapping[str, Any] = {"distance_cm": 150, "speed_cm_s": 30, "hold_s": 30}
DEAD_ONES = sorted(DEAD)
NO_DISTANCE = (Quality.NO_ECHO, Quality.TOO_NEAR, Quality.TOO_FAR, Quality.UNSTABLE)
NEARER = {
    GuidanceCode.FORWARD,
    GuidanceCode.SLOW,
    GuidanceCode.LEFT,
    GuidanceCode.RIGHT,
    GuidanceCode.DRIVE_UP,
}


def stands(*legs: Mapping[str, Any], at_cm: float = 28.0, for_s: float = 60.0, **more: Any) -> Scenario:
    """A truck that stands at the mark for this time, and what comes then."""
    stay = {"distance_cm": at_cm, "hold_s": for_s}
    return truck(stay, *legs, **({"start": {"distance_cm": at_cm}} | more))


def spout(at_s: float = 1.0, for_s: float = 40.0) -> dict[str, Any]:
    return {"kind": "spout_down", "at_s": at_s, "for_s": for_s}


def in_place(scenario: Scenario | None = None, config: GatewayConfig | None = None) -> Bench:
    """Seen in place at world time 0."""
    bench = Bench(scenario or stands(), config)
    bench.run(0)
    assert bench.state.in_place
    return bench


def held(scenario: Scenario | None = None, config: GatewayConfig | None = None) -> Bench:
    bench = in_place(scenario or stands(faults=(spout(),)), config)
    bench.run_until(lambda state: state.visit.phase is VisitPhase.HELD, 5)
    return bench


def release_at(bench: Bench, t_s: float) -> Levels:
    """A living PLC that sets its release bit then."""
    plc = Levels(bench)
    bench.run(t_s)
    plc.release()
    return plc


def ever_in_place(bench: Bench) -> bool:
    return any(moment.state.in_place for moment in bench.moments)


def ever_released(bench: Bench) -> bool:
    return any(moment.state.visit.released for moment in bench.moments)


def phases(bench: Bench) -> list[VisitPhase]:
    """In the order in which they came."""
    seen = [moment.state.visit.phase for moment in bench.moments]
    return [phase for n, phase in enumerate(seen) if n == 0 or phase is not seen[n - 1]]


def complained(bench: Bench) -> list[str]:
    return complaints([Row.of(moment.state, moment.truth, moment.heard_mm) for moment in bench.moments], bench.config)


def events(bench: Bench, *kinds: EventKind) -> list[tuple[EventKind, str]]:
    return [(event.kind, event.detail) for event in bench.events if event.kind in kinds]


# In place: by both sensors only.


def test_a_complete_visit_has_its_phases_in_order() -> None:
    legs = ({"distance_cm": 28, "speed_cm_s": 20, "hold_s": 12}, LEAVE)
    bench = Bench(truck(*legs, faults=(spout(9, 6),)))
    release_at(bench, 16)
    bench.run(30)

    assert phases(bench) == [
        VisitPhase.APPROACHING,
        VisitPhase.AT_MARK,
        VisitPhase.IN_PLACE,
        VisitPhase.HELD,
        VisitPhase.IN_PLACE,
        VisitPhase.RELEASED,
        VisitPhase.LEAVING,  # also where it stands at 1.5 m, in sight of both sensors
    ]
    story = {EventKind.TARGET_FOUND, EventKind.TARGET_LOST, EventKind.PLC_RETURNED}
    assert [event.kind for event in bench.events if event.kind not in story] == [
        EventKind.STOP_CLEARED,
        EventKind.STOP_RAISED,
        EventKind.IN_PLACE,
        EventKind.IN_PLACE_ENDED,
        EventKind.RELEASED,
        EventKind.STOP_CLEARED,
        EventKind.VISIT_ENDED,
    ]


def test_it_is_in_place_settle_s_after_it_stands() -> None:
    for settle_s in (0.5, 3.0):
        bench = Bench(stands(), gateway(visit={"settle_s": settle_s}))
        at_mark = bench.run_until(lambda state: state.visit.candidate is not None)
        stood_ns = at_mark.t_ns
        assert bench.run_until(lambda state: state.in_place).t_ns - stood_ns == pytest.approx(settle_s * 1e9, abs=2e7)


@pytest.mark.parametrize(
    ("sensor", "quality"),
    [("vision", quality) for quality in (Quality.NO_TARGET, Quality.COASTED, *DEAD_ONES)]
    + [("range", quality) for quality in (*NO_DISTANCE, *DEAD_ONES)],
)
def test_without_a_measured_marker_and_a_distance_it_is_never_in_place(sensor: str, quality: Quality) -> None:
    bench = Bench(stands())
    setattr(bench, f"{sensor}_fault", quality)
    bench.run(4)
    assert not ever_in_place(bench)


def test_a_truck_that_rolls_through_the_mark_is_not_in_place() -> None:
    """3 cm a second is faster than still_mm_s."""
    bench = Bench(truck({"distance_cm": 20, "speed_cm_s": 3}, start={"distance_cm": 33}))
    bench.run(3.4)
    assert bench.state.d is True
    assert not ever_in_place(bench)


def test_a_truck_that_slides_to_the_side_at_the_same_distance_is_not_in_place() -> None:
    """5 cm a second are 102 px: more than 0.35 of R within settle_s."""
    slides = truck(
        {"distance_cm": 29.5, "lateral_mm": 130, "speed_cm_s": 5}, start={"distance_cm": 29.5, "lateral_mm": -60}
    )
    bench = Bench(slides)
    bench.vision_fault = Quality.NO_TARGET
    bench.run(0.5)
    bench.vision_fault = None
    bench.run(2.6)
    assert bench.state.d is True
    assert bench.state.visit.candidate is not None
    assert not ever_in_place(bench)


@pytest.mark.failure_mode("T4")
def test_a_truck_that_stands_askew_is_not_in_place() -> None:
    """30 mm at 28 cm are 64 px."""
    config = gateway(guidance={"aim_u_px": 319.5, "tolerance_px": 20.0, "marker_radius_mm": 90.0})
    askew = stands(start={"distance_cm": 28, "lateral_mm": 30}, for_s=0.0)
    askew = askew.model_copy(update={"legs": ()})
    bench = Bench(askew, config)
    bench.run(4)

    assert bench.state.d is True
    assert not bench.state.in_place
    assert bench.state.guidance.code is GuidanceCode.STOP
    assert bench.state.guidance.offset_mm == pytest.approx(30, abs=1)
    assert in_place(askew).state.in_place, "where no aim is set, nothing is askew"


@pytest.mark.failure_mode("T4")
def test_a_truck_too_far_in_must_go_back_and_is_not_in_place() -> None:
    bench = Bench(stands(at_cm=23.5), gateway(guidance={"overshoot_mm": 50.0}))
    bench.run(4)
    assert (bench.state.in_place, bench.state.guidance.code) == (False, GuidanceCode.BACK)


def test_d_that_is_held_at_a_red_lamp_makes_no_place_of_it() -> None:
    """Even where R x Z is not checked at all."""
    lamp = {"kind": "red_lamp", "at_s": 2, "for_s": 30}
    bench = held(stands(faults=(spout(), lamp)), gateway(fusion={"scale_tolerance": 0}))
    bench.run_until(lambda state: not state.in_place, 5)
    bench.run(bench.t_s + 5)
    assert (bench.state.d, bench.state.stop, bench.state.in_place) == (True, True, False)


def test_d_that_was_held_before_it_was_ever_in_place_makes_no_place_of_a_lamp() -> None:
    faults = (spout(0, 60), {"kind": "red_lamp", "at_s": 2, "for_s": 50})
    bench = Bench(stands(faults=faults), gateway(fusion={"scale_tolerance": 0}, visit={"settle_s": 6.0}))
    bench.run(12)
    assert (bench.state.d, bench.state.range.quality) == (True, Quality.GOOD)
    assert bench.state.guidance.closing_mm_s == pytest.approx(0, abs=5)
    assert not ever_in_place(bench)


def test_d_that_is_held_at_an_echo_from_behind_makes_no_place_of_it() -> None:
    """R says that it stands at the mark, Z says 5 cm short of it: D = 1 is held, but both sensors must say so."""
    rules = interlock.Rules.of(gateway(writes=False).bays[0])
    state = interlock.initial("bay1", 0, rules)
    for n in range(1, 300):
        now_ns = n * 20_000_000
        for observation in (
            VisionReading(now_ns, Quality.GOOD, Circle(320, 240, 186)),
            RangeReading(now_ns, Quality.GOOD, 290.0 if n < 10 else 340.0),
            Tick(),
        ):
            state = interlock.step(state, observation, now_ns, rules)
    assert (state.d, state.memory.disagree_since_ns, state.in_place) == (True, None, False)


# Arriving from beyond the ranger's range.

FAR = {"start": {"distance_cm": 480}}
LEARNED = RetainedState(scale_samples=tuple(ScaleSample(0, 193.0, 280.0) for _ in range(3)))


def arriving(*, learned: bool = True, deaf: bool = False, **keys: Any) -> Bench:
    faults = ({"kind": "ranger_no_echo", "at_s": 0, "for_s": 60},) if deaf else ()
    bench = Bench(truck({"distance_cm": 28, "speed_cm_s": 60, "hold_s": 9}, faults=faults, **FAR), gateway(fusion=keys))
    bench.power_on(LEARNED if learned else None)
    return bench


@pytest.mark.parametrize("learned", [True, False])
def test_a_truck_beyond_the_ranger_drives_up(learned: bool) -> None:
    bench = arriving(learned=learned)
    bench.run(0)
    assert bench.state.range.quality in (Quality.TOO_FAR, Quality.NO_ECHO)
    assert (bench.state.visit.phase, bench.state.stop, bench.state.may_move) == (VisitPhase.ARRIVING, False, True)
    assert (bench.state.guidance.code, bench.state.d, bench.state.in_place) == (GuidanceCode.DRIVE_UP, False, False)
    bench.run(14)
    assert bench.state.in_place
    assert complained(bench) == []
    assert {moment.state.guidance.code for moment in bench.moments if 0 < moment.t_s < 3} <= NEARER, "and never WAIT"


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"arrive_by_camera": False}, "switched off"),
        ({"radius_threshold_px": 120.0}, "nothing learned, and larger than a marker for these thresholds"),
        ({"cross_check": CROSS_CHECK | {"camera_offset_mm": 1300.0}}, "within the ranger's range, by the lens"),
    ],
)
def test_otherwise_it_waits_until_the_ranger_hears_it(keys: dict[str, Any], why: str) -> None:
    bench = arriving(learned=False, **keys)
    bench.run(0.5)
    assert (bench.state.visit.phase, bench.state.stop) == (VisitPhase.ARRIVING, True), why
    assert bench.state.guidance.code is GuidanceCode.WAIT


def test_a_truck_in_the_bay_is_not_one_that_arrives() -> None:
    """In place before the restart, its marker covered, the ranger silent: something red far off permits nothing."""
    rules = interlock.Rules.of(gateway(writes=False).bays[0])
    stood = RetainedState(truck=RetainedTruck(TruckPosition(280.0, Circle(320, 240, 193))))
    for retained, stop in ((None, False), (stood, True)):
        state = interlock.initial("bay1", 0, rules, retained)
        for n in range(1, 200):
            now_ns = n * 20_000_000
            far = VisionReading(now_ns, Quality.GOOD, Circle(400, 200, 12))
            for observation in (far, RangeReading(now_ns, Quality.NO_ECHO), Tick()):
                state = interlock.step(state, observation, now_ns, rules)
        assert (state.stop, state.may_move) == (stop, not stop)
        assert state.visit.phase is (VisitPhase.UNKNOWN if stop else VisitPhase.ARRIVING)


OUT = ({"distance_cm": 28, "hold_s": 4}, {"distance_cm": 480, "speed_cm_s": 30, "hold_s": 4})
COVERED = {"kind": "marker_hidden", "at_s": 0.5, "for_s": 1.5}  # as by the spout: loading has begun


@pytest.mark.mostly_long
@pytest.mark.parametrize("writes", [True, False])
def test_a_loaded_truck_that_backs_off_is_told_to_leave_until_it_is_out_of_sight(writes: bool) -> None:
    """From the first moment at which it may move; beyond the end of its visit and the ranger's range."""
    bench = in_place(stands(*OUT, for_s=0, at_cm=28, faults=(COVERED,)), gateway(writes=writes))
    if writes:
        release_at(bench, 3)
    bench.run_until(lambda state: state.may_move, 8)
    bench.run(24)
    assert bench.world.truth(bench.t_s).distance_mm == pytest.approx(4800, abs=1)
    guided = {moment.state.guidance.code for moment in bench.moments if moment.state.may_move}
    assert guided == {GuidanceCode.LEAVE}
    assert bench.state.visit.phase is VisitPhase.LEAVING
    assert complained(bench) == []


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    ("to_cm", "hidden", "code"),
    [
        (36.0, False, GuidanceCode.SLOW),  # 6 cm short of the mark
        (36.0, True, GuidanceCode.LEAVE),
        (90.0, False, GuidanceCode.LEAVE),  # farther out than slow_mm: it drives off
        (15.0, False, GuidanceCode.BACK),  # too near for the camera
        (15.0, True, GuidanceCode.WAIT),  # the spout may be down
    ],
)
def test_a_truck_that_rolls_off_before_it_is_loaded_is_guided_back(
    to_cm: float, hidden: bool, code: GuidanceCode
) -> None:
    away = {"distance_cm": to_cm, "speed_cm_s": 6, "hold_s": 30}
    bench = in_place(stands(away, for_s=3.0, faults=(COVERED,) if hidden else ()), gateway(writes=False))
    bench.run(3 + abs(to_cm - 28) / 6 + 3)
    assert bench.state.visit.moved is Moved.DISTANCE
    assert (bench.state.guidance.code, bench.state.in_place) == (code, False)
    # Never nearer while stop is on, and never back under a spout that came down while the truck stood.
    assert not any(m.state.stop and m.state.guidance.code in NEARER for m in bench.moments)


def test_a_truck_that_rolls_in_out_of_the_cameras_view_is_told_to_brake_until_it_stands() -> None:
    bench = in_place(stands({"distance_cm": 15, "speed_cm_s": 6, "hold_s": 30}, for_s=3.0), gateway(writes=True))
    bench.run(12)
    guided = [(moment.state.guidance.code, moment.state.visit.rolling) for moment in bench.moments]
    assert [key for key, _ in groupby(guided)] == [
        (GuidanceCode.OK, False),
        (GuidanceCode.BRAKE, True),
        (GuidanceCode.BACK, False),
    ]


def test_a_truck_that_goes_back_as_it_is_told_is_not_told_to_brake() -> None:
    """It rolled in until the camera lost its marker, stood, and goes back to the mark."""
    legs = ({"distance_cm": 15, "speed_cm_s": 6, "hold_s": 5}, {"distance_cm": 27, "speed_cm_s": 6, "hold_s": 20})
    bench = in_place(stands(*legs, for_s=3.0), gateway(writes=True))
    bench.run(20)
    codes = [code for code, _ in groupby(moment.state.guidance.code for moment in bench.moments)]
    assert codes[:3] == [GuidanceCode.OK, GuidanceCode.BRAKE, GuidanceCode.BACK]
    assert GuidanceCode.BRAKE not in codes[2:]
    assert codes[-1] is GuidanceCode.OK


def test_the_next_truck_is_not_told_to_leave() -> None:
    back = {"distance_cm": 100, "speed_cm_s": 40, "hold_s": 4}
    bench = in_place(stands(*OUT, back, for_s=0, at_cm=28), gateway(writes=False))
    bench.run(24)
    assert bench.state.guidance.code is GuidanceCode.LEAVE
    codes: list[GuidanceCode] = []
    while bench.t_s < 36:
        bench.run(bench.t_s + 0.2)
        codes += [bench.state.guidance.code] if bench.state.guidance.code not in codes[-1:] else []
    assert codes == [
        GuidanceCode.LEAVE,
        GuidanceCode.DRIVE_UP,
        GuidanceCode.FORWARD,
        GuidanceCode.SLOW,  # and stays: a truck that waits there is near
    ]


def test_a_deaf_ranger_stops_a_truck_that_drives_up_where_it_should_have_been_heard() -> None:
    """3.6 m: a tenth less than the ranger's range."""
    bench = arriving(deaf=True)
    bench.run_until(lambda state: state.may_move, 5)
    stopped = bench.run_until(lambda state: state.stop, 10)
    assert stopped.reason is Reason.NO_ECHO
    assert bench.world.truth(bench.t_s).distance_mm == pytest.approx(3600, abs=100)
    bench.run(14)
    assert bench.state.stop


# Held by the ranger alone.


def test_the_spout_covers_the_marker_and_in_place_is_held_and_stop_stays_on() -> None:
    bench = in_place(stands(faults=(spout(1, 600), {"kind": "dust_cloud", "at_s": 3, "for_s": 590})))
    bench.run(120)

    assert all(moment.state.in_place and moment.state.stop for moment in bench.moments)
    assert not any(moment.state.may_move for moment in bench.moments)
    assert {moment.state.guidance.code for moment in bench.moments} == {GuidanceCode.OK}
    covered_ns = bench.state.visit.covered_since_ns
    assert covered_ns is not None
    assert (bench.now_ns - covered_ns) / 1e9 == pytest.approx(118, abs=1)
    assert bench.state.visit.phase is VisitPhase.HELD


def test_with_no_hold_at_all_a_covered_marker_ends_it_at_once() -> None:
    bench = in_place(stands(faults=(spout(),)), gateway(visit={"hold_limit_s": 0.0}))
    bench.run_until(lambda state: state.vision.circle is None, 5)
    assert not bench.state.in_place


def test_in_place_keeps_stop_on_even_where_a_blind_gateway_does_not_say_stop() -> None:
    bench = held(config=gateway(fusion={"fail_safe": False}))
    assert (bench.state.d, bench.state.in_place, bench.state.stop) == (None, True, True)
    assert bench.state.reason is Reason.TARGET_REACHED


@pytest.mark.parametrize("quality", NO_DISTANCE)
def test_a_live_ranger_without_a_distance_ends_it_after_the_grace(quality: Quality) -> None:
    bench = held()
    bench.range_fault = quality
    assert bench.run(bench.t_s + 0.45).in_place
    ended = bench.run(bench.t_s + 0.2)
    assert (ended.in_place, ended.visit.ended) == (False, "no distance")
    bench.range_fault = None
    later = bench.run(bench.t_s + 3)
    assert not later.in_place, "with the marker covered it can't be earned again"
    assert later.stop


# Sensors die in each phase.


def approaching() -> Bench:
    bench = Bench(truck({"distance_cm": 60, "speed_cm_s": 20, "hold_s": 60}))
    bench.run(6)
    assert bench.state.visit.phase is VisitPhase.APPROACHING
    assert bench.state.may_move
    return bench


def at_mark() -> Bench:
    bench = Bench(stands(), gateway(visit={"settle_s": 60.0}))
    bench.run(0)
    assert bench.state.visit.phase is VisitPhase.AT_MARK
    return bench


def levels(bench: Bench) -> Levels:
    assert isinstance(bench.plc, Levels)
    return bench.plc


def released() -> Bench:
    bench = held(stands(faults=(spout(1, 60),)))
    release_at(bench, bench.t_s + 0.3)
    bench.run_until(lambda state: not state.stop, 1)
    assert bench.state.visit.phase is VisitPhase.RELEASED
    assert bench.state.may_move
    return bench


def leaving() -> Bench:
    bench = in_place(stands({"distance_cm": 60, "speed_cm_s": 30, "hold_s": 30}, for_s=2.0))
    release_at(bench, 1)
    bench.run_until(lambda state: state.visit.off_mark, 5)
    assert bench.state.visit.phase is VisitPhase.LEAVING
    assert bench.state.may_move
    return bench


PHASES: Mapping[str, Callable[[], Bench]] = {
    "approaching": approaching,
    "at_mark": at_mark,
    "in_place": in_place,
    "held": held,
    "released": released,
    "leaving": leaving,
}
in_each_phase = pytest.mark.parametrize("phase", PHASES)


@in_each_phase
@pytest.mark.parametrize("sensor", ["vision", "range"])
def test_a_sensor_that_dies_ends_everything_good_at_once(phase: str, sensor: str) -> None:
    bench = PHASES[phase]()
    reading: Any = VisionReading if sensor == "vision" else RangeReading
    for quality in DEAD_ONES:
        state = interlock.step(bench.state, reading(bench.now_ns, quality), bench.now_ns, bench.rules)
        assert (state.stop, state.may_move, state.in_place) == (True, False, False), quality
        assert state.guidance.code is GuidanceCode.FAULT
        if phase in ("in_place", "held"):
            assert state.visit.ended == {"vision": "camera dead", "range": "ranger dead"}[sensor]
        if phase == "released":
            assert not state.visit.released


@in_each_phase
@pytest.mark.parametrize("sensor", ["vision", "range"])
def test_after_a_sensor_was_dead_in_place_must_be_earned_by_both(phase: str, sensor: str) -> None:
    bench = PHASES[phase]()
    setattr(bench, f"{sensor}_fault", Quality.STALE)
    bench.run(bench.t_s + 0.5)
    setattr(bench, f"{sensor}_fault", None)
    back_s = bench.t_s
    bench.run(bench.t_s + 4)
    placed = [moment.t_s for moment in bench.moments if moment.t_s > back_s and moment.state.in_place]
    if phase == "in_place":
        assert placed[0] - back_s > 1.0 + 1.0 - 0.1, "recovery_s and settle_s"
    else:
        assert placed == []


@in_each_phase
@pytest.mark.failure_mode("G4")
def test_power_returns_and_nothing_is_remembered_as_good(phase: str) -> None:
    bench = PHASES[phase]()
    bench.plc = None
    bench.power_on()
    assert (bench.state.stop, bench.state.may_move, bench.state.in_place) == (True, False, False)
    assert bench.state.visit.place is None
    begun_s = bench.t_s
    bench.run(bench.t_s + 4)
    after = [moment for moment in bench.moments if moment.t_s > begun_s]
    assert all(moment.state.stop or moment.state.d is False for moment in after)
    placed = [moment.t_s for moment in after if moment.state.in_place]
    assert (placed[0] - begun_s > 1.0) if phase == "in_place" else (placed == [])


@pytest.mark.parametrize("check", [{}, {"cross_check": CROSS_CHECK}], ids=["learned", "cross-check"])
def test_power_returns_while_a_red_lamp_is_lit_before_the_covered_marker(check: dict[str, Any]) -> None:
    """Nothing is remembered of R, and D = 0 by it: the camera must not be believed against the ranger."""
    lamp = {"kind": "red_lamp", "at_s": 3, "for_s": 60}
    bench = held(stands(faults=(spout(1, 60), lamp)), gateway(fusion=check))
    bench.run(4)
    bench.power_on()
    begun_s = bench.t_s
    bench.run(bench.t_s + 6)
    after = [moment.state for moment in bench.moments if moment.t_s > begun_s]
    assert any(state.vision.circle is not None and state.range.distance_mm is not None for state in after)
    assert all(state.stop and not state.may_move and not state.in_place for state in after)
    assert bench.state.reason is Reason.SENSORS_DISAGREE


# It has moved.


@pytest.mark.failure_mode("T1")
def test_a_truck_that_rolls_under_the_spout_is_reported() -> None:
    bench = held(stands({"distance_cm": 34, "speed_cm_s": 2, "hold_s": 20}, for_s=6.0, faults=(spout(1, 60),)))
    bench.run(8)
    bench.run_until(lambda state: state.visit.moved is not Moved.NO, 5)
    truth = bench.moments[-1].truth

    assert 310 < truth.distance_mm < 340, "the band is 40 mm"
    assert (bench.state.visit.moved, bench.state.in_place, bench.state.stop) == (Moved.DISTANCE, False, True)
    ((_, detail),) = events(bench, EventKind.MOVED)
    assert detail.startswith("the distance left its band: Z 28")
    assert detail.endswith("mm, marker not seen")
    assert events(bench, EventKind.IN_PLACE_ENDED) == [(EventKind.IN_PLACE_ENDED, "moved")]
    bench.run(bench.t_s + 10)
    assert bench.state.visit.moved is Moved.DISTANCE, "until the bay is clear, or a truck is in place"


def rolled_out(*, writes: bool) -> Bench:
    """In place, then 40 cm away without release."""
    scenario = stands({"distance_cm": 40, "speed_cm_s": 10, "hold_s": 60}, for_s=1.0)
    bench = in_place(scenario, gateway(writes=writes))
    bench.run_until(lambda state: state.d is False, 6)
    return bench


def test_a_truck_that_moved_without_release_is_stopped_until_it_has_left_or_a_reset() -> None:
    bench = rolled_out(writes=True)
    bench.write()
    bench.vision_fault = Quality.LINK_DOWN
    bench.run(bench.t_s + 0.2)
    bench.write(Control.RESET)
    assert bench.state.plc.reset_verdict is ResetVerdict.CAUSE_STANDS, "D can't be known now"
    bench.vision_fault = None
    bench.run(bench.t_s + 3)
    state = bench.state
    assert (state.d, state.stop, state.may_move, state.reason) == (False, True, False, Reason.MOVED)
    bench.write()
    bench.write(Control.RESET)
    bench.run(bench.t_s + 0.5)
    state = bench.state
    assert (state.stop, state.may_move, state.visit.moved, state.visit.place) == (False, True, Moved.NO, None)
    assert state.plc.reset_verdict is ResetVerdict.DONE


@pytest.mark.parametrize("decision", ["held", "plain"])
def test_a_reset_while_the_sensors_do_not_fit_each_other_ends_no_watch_of_the_place(decision: str) -> None:
    """Not even before that is a fault: found by random walks of bench/exhaustive.py."""
    bench = in_place(config=gateway(fusion={"cross_check": CROSS_CHECK, "decision": decision}))
    bench.write()
    bench.step(RangeReading(bench.now_ns, Quality.GOOD, 340.0))
    bench.step(VisionReading(bench.now_ns, Quality.GOOD, Circle(320, 240, 159.0)))
    verdicts = []
    for radius_px in (49.0, 159.0):  # 159 px fit 340 mm
        state = bench.step(VisionReading(bench.now_ns, Quality.GOOD, Circle(320, 240, radius_px)))
        assert (state.d, state.visit.moved, state.memory.disagree) == (False, Moved.DISTANCE, False)
        state = bench.write(Control.RESET)
        verdicts.append((state.plc.reset_verdict, state.visit.moved, state.visit.place is not None))
        bench.write()
    refused = (ResetVerdict.CAUSE_STANDS, Moved.DISTANCE, True)
    assert verdicts == [refused, (ResetVerdict.DONE, Moved.NO, False)]


def test_where_nobody_can_release_a_departure_is_a_move_that_stops_nobody() -> None:
    bench = rolled_out(writes=False)
    bench.run(bench.t_s + 1)
    state = bench.state
    assert (state.visit.moved, state.stop, state.may_move) == (Moved.DISTANCE, False, True)


@pytest.mark.parametrize("to_cm", [22.0, 36.0])
def test_either_way_out_of_the_band_is_a_move(to_cm: float) -> None:
    bench = in_place(stands({"distance_cm": to_cm, "speed_cm_s": 5, "hold_s": 20}, for_s=1.0))
    bench.run(4)
    assert bench.state.visit.moved is Moved.DISTANCE
    assert not any(m.state.in_place for m in bench.moments if abs(m.truth.distance_mm - 280) > 40 + 17 + 15)


def test_a_marker_seen_to_the_side_at_the_same_size_is_a_move() -> None:
    """35 mm are more than 0.35 of R; the distance stays."""
    bench = in_place(stands({"distance_cm": 28, "lateral_mm": 45, "speed_cm_s": 5, "hold_s": 20}, for_s=1.0))
    state = bench.run_until(lambda state: not state.in_place, 4)
    assert (state.visit.moved, state.visit.ended, state.stop) == (Moved.MARKER, "moved", True)


def test_a_marker_that_is_covered_from_one_side_has_not_moved() -> None:
    """The paper's circle round what is left of the disc: its centre moves, and r^2 + shift^2 = R^2."""
    bench = in_place()
    circle = bench.state.vision.circle
    assert circle is not None
    for share in (0.2, 0.4, 0.6, 0.8):
        left = Circle(circle.u_px, circle.v_px + share * circle.radius_px, circle.radius_px * (1 - share**2) ** 0.5)
        bench.step(VisionReading(bench.now_ns, Quality.GOOD, left))
        assert (bench.state.visit.moved, bench.state.in_place) == (Moved.NO, True), share
    bench.vision_fault = Quality.NO_TARGET
    bench.run(bench.t_s + 2)
    assert bench.state.visit.held


def test_a_truck_that_drives_off_is_reported_though_the_ranger_was_dead_meanwhile() -> None:
    bench = in_place(stands({"distance_cm": 60, "speed_cm_s": 30, "hold_s": 30}, for_s=1.0))
    bench.range_fault = Quality.LINK_DOWN
    assert bench.run(4).visit.moved is Moved.NO
    bench.range_fault = None
    assert bench.run(7).visit.moved is Moved.DISTANCE


@pytest.mark.failure_mode("T3")
def test_the_next_truck_in_place_ends_the_report_of_the_one_before() -> None:
    legs = (
        {"distance_cm": 70, "speed_cm_s": 40},
        {"distance_cm": 60, "another_truck": True},
        {"distance_cm": 26, "speed_cm_s": 20, "hold_s": 9},
    )
    bench = in_place(stands(*legs, for_s=1.0))
    bench.run_until(lambda state: state.visit.moved is Moved.DISTANCE, 5)
    state = bench.run_until(lambda state: state.in_place, 10)
    assert state.visit.moved is Moved.NO
    assert state.visit.place is not None
    assert state.visit.place.distance_mm == pytest.approx(260, abs=17)


def test_a_truck_that_rolled_and_stands_again_must_earn_it_where_it_stands() -> None:
    bench = in_place(stands({"distance_cm": 23, "speed_cm_s": 10, "hold_s": 20}, for_s=1.0))
    bench.run(7)
    said = events(bench, EventKind.IN_PLACE, EventKind.MOVED, EventKind.IN_PLACE_ENDED)
    kinds = [kind for kind, _ in said]
    assert kinds == [EventKind.IN_PLACE, EventKind.MOVED, EventKind.IN_PLACE_ENDED, EventKind.IN_PLACE]
    assert bench.state.visit.moved is Moved.NO


# The sensors contradict each other.


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    "keys",
    [{}, {"cross_check": CROSS_CHECK}, {"cross_check": {**CROSS_CHECK, "lasting_s": 60.0}}, {"scale_tolerance": 0}],
    ids=["learned", "cross-check", "late cross-check", "none"],
)
@pytest.mark.failure_mode("M2")
def test_a_red_lamp_for_the_covered_marker_never_ends_a_stop(keys: dict[str, Any]) -> None:
    lamp = {"kind": "red_lamp", "at_s": 5, "for_s": 10}
    bench = in_place(stands(faults=(spout(1, 20), lamp)), gateway(fusion=keys))
    bench.run(20)
    lit = [m.state for m in bench.moments if m.state.vision.circle and m.state.vision.circle.radius_px < 25]
    assert len(lit) > 9 * MOMENTS_HZ
    assert all(moment.state.stop and not moment.state.may_move for moment in bench.moments)
    assert all(not state.in_place for state in lit[MOMENTS_HZ:]), "after the grace"


def test_a_lamp_has_its_own_reason() -> None:
    lamp = {"kind": "red_lamp", "at_s": 5, "for_s": 10}
    bench = in_place(stands(faults=(spout(1, 20), lamp)))
    bench.run(10)
    assert (bench.state.reason, bench.state.visit.ended) == (Reason.SENSORS_DISAGREE, "contradiction")
    bench.run(26)
    assert (bench.state.in_place, bench.state.reason) == (True, Reason.TARGET_REACHED), "the marker is seen again"


def test_a_disc_that_the_search_refuses_by_its_size_is_doubted_at_once() -> None:
    bench = held()
    begun_s = bench.t_s
    while bench.state.in_place and bench.t_s < begun_s + 2:
        refused = VisionReading(bench.now_ns, Quality.NO_TARGET, wrong_size=Circle(410, 180, 20))
        bench.step(refused)
        bench.run(bench.t_s + 0.01)
    assert bench.t_s - begun_s == pytest.approx(0.5, abs=0.05), "hold_grace_s"
    assert bench.state.visit.ended == "contradiction"


@pytest.mark.parametrize("echo_cm", [3, 10, 20, 22])
@pytest.mark.failure_mode("R9")
def test_an_echo_beside_a_seen_marker_is_a_contradiction_and_no_move(echo_cm: float) -> None:
    echo = {"kind": "ranger_echo", "distance_cm": echo_cm, "at_s": 2, "for_s": 5}
    bench = in_place(stands(faults=(echo,)))
    bench.run(6)
    assert not bench.state.in_place
    assert bench.state.visit.moved is Moved.NO
    assert bench.state.stop
    bench.run(10)
    assert bench.state.in_place


@pytest.mark.parametrize(
    "faults",
    [
        (spout(), {"kind": "ranger_no_echo", "at_s": 4, "for_s": 0.13}),
        ({"kind": "ranger_echo", "at_s": 2, "for_s": 0.3},),
    ],
    ids=["a lost echo with the marker covered", "an echo of something else, shorter than the grace"],
)
def test_what_is_shorter_than_the_grace_ends_nothing(faults: tuple[Mapping[str, Any], ...]) -> None:
    bench = in_place(stands(faults=faults))
    bench.run(8)
    assert all(moment.state.in_place for moment in bench.moments)


def test_an_echo_with_the_marker_covered_can_only_be_taken_for_a_move() -> None:
    bench = held(stands(faults=(spout(1, 30), {"kind": "ranger_echo", "at_s": 5, "for_s": 5})))
    bench.run(7)
    assert (bench.state.in_place, bench.state.visit.moved, bench.state.stop) == (False, Moved.DISTANCE, True)
    bench.run(20)
    assert not bench.state.in_place, "with the marker covered it can't be earned again"


def test_an_echo_of_the_spout_within_the_band_hides_a_truck_that_goes() -> None:
    """Limits (docs/visit.md): the marker covered, and an echo from where the truck stood. stop stays."""
    echo = {"kind": "ranger_echo", "distance_cm": 27, "at_s": 4, "for_s": 20}
    away = {"distance_cm": 60, "speed_cm_s": 30, "hold_s": 60}
    bench = held(stands(away, for_s=6.0, faults=(spout(1, 30), echo)))
    bench.run(12)
    assert (bench.state.in_place, bench.state.stop, bench.state.may_move) == (True, True, False)
    assert complained(bench) == []
    bench.run(26)
    assert (bench.state.in_place, bench.state.visit.moved) == (False, Moved.DISTANCE)


@pytest.mark.failure_mode("R9")
def test_a_person_before_the_ranger_stops_the_truck_with_that_reason() -> None:
    waits = truck({"distance_cm": 90, "speed_cm_s": 20, "hold_s": 60}, faults=(
        {"kind": "ranger_echo", "distance_cm": 45, "at_s": 5, "for_s": 0.05},
        {"kind": "ranger_echo", "distance_cm": 45, "at_s": 8, "for_s": 3},
    ))  # fmt: skip
    bench = Bench(waits)
    bench.run(8)
    assert all(moment.state.may_move for moment in bench.moments), "one short echo is a glitch"
    bench.run(10)
    assert (bench.state.stop, bench.state.reason) == (True, Reason.SENSORS_DISAGREE)
    bench.run(13)
    assert (bench.state.stop, bench.state.may_move) == (False, True)
    stops = [event.t_ns for event in bench.events if event.kind in (EventKind.STOP_RAISED, EventKind.STOP_CLEARED)]
    assert len(stops) == 3, "cleared at the start, raised and cleared once"


@pytest.mark.failure_mode("M3")
def test_a_lamp_taken_for_the_marker_all_the_way_in_is_found_out_by_r_that_does_not_follow() -> None:
    """The marker is covered from the start: R stays at 20 px while Z falls from 1.2 m. D = 1 would never come."""
    faults = ({"kind": "marker_hidden", "at_s": 0, "for_s": 60}, {"kind": "red_lamp", "at_s": 0, "for_s": 60})
    bench = Bench(truck({"distance_cm": 24, "speed_cm_s": 20, "hold_s": 20}, faults=faults))
    bench.run(0.6)
    bench.power_on()  # nothing is known of the marker
    bench.run_until(lambda state: state.may_move, 3)
    stopped = bench.run_until(lambda state: state.stop, 6)
    assert stopped.reason is Reason.SENSORS_DISAGREE
    assert bench.moments[-1].truth.distance_mm > 500
    bench.run(15)
    assert bench.state.stop


# Release.


def test_a_released_truck_may_leave_although_d_is_1_and_although_it_is_unknown() -> None:
    for bench, d in ((in_place(), True), (held(), None)):
        release_at(bench, bench.t_s + 0.5)
        bench.run(bench.t_s + 1)
        state = bench.state
        assert (state.d, state.stop, state.may_move, state.in_place) == (d, False, True, False)
        assert (state.visit.phase, state.guidance.code) == (VisitPhase.RELEASED, GuidanceCode.LEAVE)
        assert state.visit.ended == "released"
        assert events(bench, EventKind.MOVED) == []


def test_only_a_truck_that_was_in_place_is_let_go() -> None:
    bench = at_mark()
    release_at(bench, 0.5)
    bench.run(3)
    assert (bench.state.stop, bench.state.visit.released) == (True, False)


def test_a_truck_that_rolled_and_can_not_be_in_place_again_is_let_go() -> None:
    bench = held(stands({"distance_cm": 21, "speed_cm_s": 5, "hold_s": 60}, for_s=6.0, faults=(spout(1, 60),)))
    release_at(bench, 12)
    assert bench.state.visit.moved is Moved.DISTANCE
    bench.run(13)
    assert (bench.state.stop, bench.state.visit.moved) == (False, Moved.NO)


@pytest.mark.failure_mode("P10")
def test_a_release_bit_that_is_on_all_the_time_lets_nobody_go() -> None:
    """Only its edge counts: not a bit that was on at the first write, and not one that was on before in place."""
    bench = Bench(stands())
    Levels(bench).release()
    bench.run(6)
    assert bench.state.in_place
    assert not ever_released(bench)


@pytest.mark.parametrize("end", ["bit back to 0", "heartbeat lost"])
def test_a_release_that_is_taken_back_brings_the_stop_back(end: str) -> None:
    bench = released()
    plc = levels(bench)
    if end == "heartbeat lost":
        plc.alive = False
    else:
        plc.release(False)
    stopped = bench.run_until(lambda state: state.stop, 2)
    assert not stopped.visit.released
    assert stopped.visit.place is not None
    plc.alive = True
    bench.run(bench.t_s + 0.5)
    assert bench.state.stop, "the same bit is no new edge"
    plc.release(False)
    bench.run(bench.t_s + 0.5)
    plc.release()
    bench.run(bench.t_s + 0.5)
    assert not bench.state.stop


@pytest.mark.parametrize("end", ["bit back to 0", "nearer again"])
def test_a_release_that_ends_before_d_was_0_for_long_brings_the_stop_back(end: str) -> None:
    """D is 0 by now, but not for clear_hold_s, and the truck is not off the mark: found by bench/exhaustive.py."""
    bench = released()
    now_ns = bench.now_ns
    bench.step(VisionReading(now_ns, Quality.GOOD, Circle(320, 240, 159)))
    left = bench.step(RangeReading(now_ns, Quality.GOOD, 340.0))
    assert (left.d, left.stop, left.may_move, left.visit.released) == (False, False, True, True)
    ended = bench.write() if end == "bit back to 0" else bench.step(RangeReading(now_ns, Quality.GOOD, 282.0))
    assert (ended.d, ended.visit.released) == (False, False)
    reason = Reason.MOVED if end == "bit back to 0" else Reason.STOP_LATCHED  # beyond its band, or within
    assert (ended.stop, ended.may_move, ended.reason) == (True, False, reason)


def lost_and_seen_again() -> Bench:
    """Was in place until its echo was lost; has stood before both sensors again for 0.5 s of settle_s."""
    bench = in_place()
    Levels(bench)
    bench.range_fault = Quality.NO_ECHO
    bench.run(bench.t_s + 0.7)
    assert bench.state.visit.ended == "no distance"
    bench.range_fault = None
    bench.run_until(lambda state: state.visit.still_since_ns is not None, 3)
    bench.run(bench.t_s + 0.5)
    assert bench.state.visit.still_since_ns is not None
    assert not bench.state.in_place
    return bench


def test_a_truck_whose_release_ends_is_in_place_only_when_it_has_stood_for_settle_s_after_it() -> None:
    """What it stood before the release does not count: found by random walks of bench/exhaustive.py."""
    bench = lost_and_seen_again()
    levels(bench).release()
    bench.run(bench.t_s + 5)
    assert bench.state.visit.released
    levels(bench).release(False)
    ended_ns = bench.run_until(lambda state: not state.visit.released, 1).t_ns
    again = bench.run_until(lambda state: state.in_place, 3)
    assert again.t_ns - ended_ns >= 1e9, "settle_s"


def test_a_release_that_an_echo_ends_leaves_nothing_of_how_long_the_truck_had_stood() -> None:
    bench = lost_and_seen_again()
    levels(bench).release()
    bench.run(bench.t_s + 0.6)
    assert bench.state.visit.released
    for mm in (340.0, 280.0):
        state = bench.step(RangeReading(bench.now_ns, Quality.GOOD, mm))
    assert (state.visit.released, state.in_place) == (False, False)
    ended_ns = state.t_ns
    assert bench.run_until(lambda state: state.in_place, 3).t_ns - ended_ns >= 1e9, "settle_s"


def test_where_it_is_required_a_release_needs_a_spout_that_is_up_and_ends_with_it() -> None:
    handshake = {"spout_up_required": True, "heartbeat_deadline_s": 1.0}
    modbus = {"writes": True, "plc_addresses": [PLC.address], "handshake": handshake}
    bench = Bench(stands({"distance_cm": 60, "speed_cm_s": 30, "hold_s": 30}, for_s=12.0), gateway(modbus=modbus))
    bits: set[Control] = set()

    def released(*now: Control) -> bool:
        bits.clear()
        bits.update(now)
        bench.run(bench.t_s + 0.5)
        assert bench.state.stop is not bench.state.visit.released
        return bench.state.visit.released

    bench.plc = lambda t_s, _: PlcWrite(PLC, round(t_s * 100) & 0xFFFF, sum(1 << bit for bit in bits))
    bench.run_until(lambda state: state.in_place, 10)
    assert not released(Control.RELEASE)
    assert not released(Control.RELEASE, Control.SPOUT_UP), "a spout that goes up releases no truck by itself"
    assert bench.state.in_place
    assert not released(Control.SPOUT_UP)
    assert released(Control.RELEASE, Control.SPOUT_UP)
    assert not released(Control.RELEASE), "it comes down again"
    assert not released(Control.SPOUT_UP)
    assert released(Control.RELEASE, Control.SPOUT_UP)
    bench.run_until(lambda state: state.visit.off_mark, 15)
    assert released(Control.RELEASE), "it has left: the spout is nothing to it any more"


def test_a_release_needs_a_plc_that_is_known_to_live() -> None:
    """The bit may be set by a master without a heartbeat: whether it lives then, nobody can know."""
    bench = in_place()
    for bits in (0, 1 << Control.RELEASE):
        state = bench.step(PlcWrite(PLC, control=bits))
        assert state.stop
        bench.run(bench.t_s + 0.1)
    assert not ever_released(bench)


@pytest.mark.parametrize(
    ("fault", "from_s", "to_s"),
    [(Quality.STALE, 0.5, 1.5), (Quality.NO_ECHO, 0.5, 0.9)],
    ids=["a dead sensor", "no distance, shorter than the grace"],
)
def test_a_release_asked_without_a_distance_is_not_kept_for_later(fault: Quality, from_s: float, to_s: float) -> None:
    bench = in_place()
    plc = Levels(bench)
    bench.run(from_s)
    bench.range_fault = fault
    bench.run((from_s + to_s) / 2)
    plc.release()
    bench.run(to_s)
    bench.range_fault = None
    bench.run(6)
    assert bench.state.in_place
    assert not ever_released(bench)


def test_a_released_truck_that_is_not_heard_for_longer_than_the_grace_is_released_no_more() -> None:
    bench = released()
    bench.range_fault = Quality.NO_ECHO
    assert bench.run(bench.t_s + 0.4).visit.released
    assert not bench.run(bench.t_s + 0.3).visit.released
    bench.range_fault = None
    assert bench.run(bench.t_s + 2).stop


def test_a_released_truck_that_is_heard_again_is_let_go_when_that_lasts() -> None:
    """What has just come back may be gone in a moment: stop must not flicker."""
    bench = released()
    bench.range_fault = Quality.NO_ECHO
    assert bench.run(bench.t_s + 0.2).stop
    bench.range_fault = None
    heard_s = bench.run_until(lambda state: state.range.distance_mm is not None, 1).t_ns / 1e9
    goes_s = bench.run_until(lambda state: not state.stop, 1).t_ns / 1e9
    assert goes_s - heard_s == pytest.approx(0.3, abs=0.03)


def test_a_truck_that_has_driven_away_can_not_be_released() -> None:
    bench = in_place(stands({"distance_cm": 60, "speed_cm_s": 40, "hold_s": 60}, for_s=1.0))
    plc = Levels(bench)
    bench.run_until(lambda state: state.visit.off_mark, 5)
    bench.run(bench.t_s + 1)
    plc.release()
    bench.run(bench.t_s + 1)
    assert bench.state.visit.place is not None
    assert not bench.state.visit.released
    assert bench.state.visit.moved is Moved.DISTANCE


def test_the_driver_of_the_second_truck_gets_no_order_to_leave() -> None:
    legs = (
        {"distance_cm": 80, "speed_cm_s": 40},
        {"distance_cm": 70, "another_truck": True},
        {"distance_cm": 40, "speed_cm_s": 20, "hold_s": 20},
    )
    bench = in_place(stands(*legs, for_s=2.0))
    release_at(bench, 1)
    bench.run(8)
    assert bench.moments[-1].truth.truck == 1
    assert (bench.state.visit.released, bench.state.visit.phase) == (False, VisitPhase.APPROACHING)
    assert bench.state.guidance.code is GuidanceCode.SLOW


def test_d_ends_a_release_wherever_the_new_recipe_puts_the_mark() -> None:
    """Thresholds may change while a truck leaves: the one it is then in place for has not been released."""
    bench = leaving()
    stay = bench.state.visit
    assert stay.farthest_mm is not None
    limits = visit.VisitLimits(bench.config.bays[0].visit, bench.config.bays[0].fusion, bench.config.bays[0].guidance)
    state = bench.state
    here = Fused(state.t_ns, state.vision, state.range, True, memory=state.memory)
    after = visit.step(stay, here, 0.0, limits, released=True, release=False, function_check=False)
    assert (after.released, after.place) == (False, None)


@pytest.mark.parametrize("covered", [False, True])
def test_a_released_truck_that_comes_nearer_is_stopped(covered: bool) -> None:
    faults = (spout(1, 60),) if covered else ()
    bench = in_place(stands({"distance_cm": 20, "speed_cm_s": 5, "hold_s": 60}, for_s=6.0, faults=faults))
    release_at(bench, 5)
    bench.run_until(lambda state: not state.stop, 1)
    stopped = bench.run_until(lambda state: state.stop, 6)
    assert bench.moments[-1].truth.distance_mm == pytest.approx(280 - 40, abs=25)
    assert not stopped.visit.released
    bench.run(bench.t_s + 3)
    assert bench.state.stop


@pytest.mark.parametrize(
    "back",
    [({"distance_cm": 26, "speed_cm_s": 20, "hold_s": 9},),
     ({"distance_cm": 50, "another_truck": True}, {"distance_cm": 26, "speed_cm_s": 20, "hold_s": 20})],
    ids=["it turns round on its way", "a second truck"],
)  # fmt: skip
def test_a_release_is_for_one_departure(back: tuple[Mapping[str, Any], ...]) -> None:
    bench = in_place(stands({"distance_cm": 60, "speed_cm_s": 30}, *back, for_s=2.0))
    release_at(bench, 1)
    bench.run(9)
    assert complained(bench) == []
    assert (bench.state.in_place, bench.state.visit.released) == (True, False)


def test_trucks_that_change_while_a_sensor_is_dead_inherit_no_release() -> None:
    legs = ({"distance_cm": 29, "another_truck": True, "hold_s": 60},)
    bench = in_place(stands(*legs, for_s=4.0))
    release_at(bench, 1)
    bench.run(3)
    assert not bench.state.stop
    bench.vision_fault = Quality.LINK_DOWN
    bench.run(5)
    bench.vision_fault = None
    bench.run(6.5)
    assert all(m.state.stop for m in bench.moments if m.truth.truck == 1)


def test_the_bit_may_go_back_once_the_truck_has_left_the_mark() -> None:
    bench = leaving()
    plc = levels(bench)
    plc.release(False)
    bench.run(bench.t_s + 2)
    assert bench.state.may_move
    assert bench.state.visit.phase is VisitPhase.LEAVING
    assert events(bench, EventKind.MOVED) == []


def test_a_latched_stop_does_not_hold_a_released_truck() -> None:
    bench = in_place(stands(LEAVE, for_s=4.0), gateway(fusion={"latch_stop": True}))
    release_at(bench, 3)
    bench.run(3.3)
    assert (bench.state.stop, bench.state.memory.latched) == (False, False)
    bench.run(12)
    assert bench.state.may_move


def test_enable_is_asked_of_a_released_truck_as_of_any() -> None:
    config = gateway()
    handshake = config.modbus.handshake.model_copy(update={"enable_required": True})
    config = config.model_copy(update={"modbus": config.modbus.model_copy(update={"handshake": handshake})})
    bench = in_place(config=config)
    plc = release_at(bench, 1)
    bench.run(2)
    assert (bench.state.stop, bench.state.may_move) == (False, False)
    assert bench.state.guidance.code is GuidanceCode.WAIT
    plc.bits |= 1 << Control.ENABLE
    bench.run(3)
    assert bench.state.may_move


# A technician at work.


@in_each_phase
@pytest.mark.parametrize("check", [FunctionCheck.MAY_MOVE_OFF, FunctionCheck.MAY_MOVE_KEPT], ids=lambda c: c.name)
def test_a_function_check_ends_in_place_at_once_and_keeps_it_off(phase: str, check: FunctionCheck) -> None:
    bench = PHASES[phase]()
    bench.check_function(check)
    assert not bench.state.in_place
    if check is FunctionCheck.MAY_MOVE_OFF:
        assert not bench.state.may_move
    if phase in ("in_place", "held"):
        assert bench.state.visit.ended == "function check"
    begun = len(bench.moments)
    bench.run(bench.t_s + 3)
    assert not any(moment.state.in_place for moment in bench.moments[begun:])
    bench.check_function(FunctionCheck.OFF)
    bench.run(bench.t_s + 5)
    assert not bench.state.in_place, "the truck that stands there was not seen to come"


def test_after_a_function_check_in_place_needs_an_approach_that_was_seen() -> None:
    bench = in_place()
    bench.check_function(FunctionCheck.MAY_MOVE_OFF)
    bench.run(bench.t_s + 1)
    bench.check_function(FunctionCheck.OFF)
    bench.run(bench.t_s + 2)
    assert (bench.state.visit.checked, bench.state.visit.phase.name) == (True, "AT_MARK")
    assert bench.state.visit.withdrawn().checked, "a control task that did not run for a moment forgets nothing"
    now_ns = bench.now_ns
    bench.step(VisionReading(now_ns, Quality.GOOD, Circle(320, 240, 159)))
    away = bench.step(RangeReading(now_ns, Quality.GOOD, 340.0))
    assert (away.d, away.visit.checked) == (False, False)
    assert bench.run_until(lambda state: state.in_place, 8).visit.phase.name == "IN_PLACE"


# Chatter.


def test_a_truck_exactly_at_the_threshold_flips_nothing() -> None:
    """[start] distance_cm = 30.0, seed 8: 415 changes of may_move in 30 s by equation 14 alone."""
    at_threshold = truck(start={"distance_cm": 30.0}, seed=8)
    flips = {}
    for decision in ("plain", "held"):
        bench = Bench(at_threshold, gateway(fusion={"decision": decision}), seed=8)
        bench.run(30)
        said = [(m.state.may_move, m.state.stop) for m in bench.moments]
        flips[decision] = sum(before != after for before, after in pairwise(said))
    assert flips["plain"] > 400
    assert flips["held"] <= 2


def test_a_camera_at_two_pictures_a_second_flips_nothing_after_its_first_loss() -> None:
    """A picture is good for 0.3 s, and the next one comes after 0.5 s."""
    slow = truck({"distance_cm": 60, "speed_cm_s": 20, "hold_s": 60}, camera={"fps": 2})
    flips = {}
    for recovery_s in (0.0, 1.0):
        bench = Bench(slow, gateway(fusion={"recovery_s": recovery_s, "clear_hold_s": 0.0}))
        bench.run(20)
        flips[recovery_s] = sum(a.state.stop != b.state.stop for a, b in pairwise(bench.moments))
    assert flips[0.0] > 40
    assert flips[1.0] == 0
    assert bench.state.reason is Reason.VISION_STALE


OBSERVED = st.one_of(
    st.tuples(
        st.just("vision"),
        st.sampled_from([Quality.GOOD, Quality.GOOD, Quality.GOOD, Quality.NO_TARGET, Quality.STALE]),
        st.floats(5, 400),
    ),
    st.tuples(
        st.just("range"),
        st.sampled_from([Quality.GOOD, Quality.GOOD, Quality.GOOD, Quality.NO_ECHO, Quality.LINK_DOWN]),
        st.floats(30, 1500),
    ),
    st.tuples(st.just("tick"), st.just(Quality.GOOD), st.just(0.0)),
)


@given(st.lists(st.tuples(OBSERVED, st.integers(1, 400)), max_size=120))
@settings(max_examples=examples(150))
def test_stop_never_comes_later_than_by_equation_14_alone(moves: list[tuple[tuple[str, Quality, float], int]]) -> None:
    """At every step: where the plain decision says stop, the held one does."""
    rules = {
        decision: interlock.Rules.of(gateway(writes=False, fusion={"decision": decision}).bays[0])
        for decision in ("plain", "held")
    }
    now_ns = 10**11
    states = {decision: interlock.initial("bay1", now_ns, under) for decision, under in rules.items()}
    for (kind, quality, value), wait_ms in moves:
        now_ns += wait_ms * 1_000_000
        observation: Any = Tick()
        good = quality is Quality.GOOD
        if kind == "vision":
            observation = VisionReading(now_ns, quality, Circle(320, 240, value) if good else None)
        elif kind == "range":
            observation = RangeReading(now_ns, quality, value if good else None)
        for decision, under in rules.items():
            states[decision] = interlock.step(states[decision], observation, now_ns, under)
        assert states["held"].stop or not states["plain"].stop
        assert states["plain"].may_move or not states["held"].may_move
        for state in states.values():
            assert not (state.stop and state.guidance.code in NEARER), "no code to come nearer while stop is on"


def test_the_place_is_where_the_truck_was_when_in_place_began() -> None:
    bench = in_place()
    place = bench.state.visit.place
    assert isinstance(place, TruckPosition)
    assert place.distance_mm == pytest.approx(280, abs=8)
    bench.run(5)
    assert bench.state.visit.place == place


class TestOneStep:
    """The pure step by itself, at its limits. Times from 100 s on."""

    T_NS = 100_000_000_000
    LIMITS = visit.VisitLimits(VisitConfig(), FusionConfig(), GuidanceConfig())
    PLACE = TruckPosition(280.0, Circle(320.0, 240.0, 193.0))

    def state(self, circle: Circle | None, distance_mm: float | None, **more: Any) -> Fused:
        vision = VisionReading(self.T_NS, Quality.NO_TARGET if circle is None else Quality.GOOD, circle)
        range_ = RangeReading(self.T_NS, Quality.NO_ECHO if distance_mm is None else Quality.GOOD, distance_mm)
        return Fused(self.T_NS, vision, range_, **more)

    def step(self, before: Visit, state: Fused, *, release: bool = False) -> Visit:
        return visit.step(before, state, 0.0, self.LIMITS, released=release, release=release, function_check=False)

    def test_a_truck_has_left_only_beyond_the_leave_distance(self) -> None:
        leave_mm = self.LIMITS.leave_mm
        assert leave_mm == 1000.0
        assert not visit.clear(self.state(None, leave_mm), self.LIMITS)
        assert visit.clear(self.state(None, leave_mm + 1), self.LIMITS)

    def test_a_release_permits_nothing_beyond_the_mark(self) -> None:
        usable = Visit(released=True, usable_since_ns=0)
        seen = self.state(self.PLACE.circle, 280.0)
        assert visit.may_leave(usable, seen, self.LIMITS)
        assert not visit.may_leave(replace(usable, off_mark=True), seen, self.LIMITS)

    def test_a_clear_bay_is_empty_and_one_in_which_a_truck_is_watched_is_not(self) -> None:
        assert self.step(Visit(), self.state(None, None)).phase is VisitPhase.EMPTY
        watched = Visit(place=self.PLACE, clear_since_ns=self.T_NS)
        assert self.step(watched, self.state(None, None)).phase is VisitPhase.UNKNOWN

    def test_a_circle_of_half_the_size_where_the_marker_was_is_doubted(self) -> None:
        placed = Visit(in_place=True, place=self.PLACE)
        half = self.step(placed, self.state(Circle(320.0, 240.0, 96.5), 280.0, d=True))
        assert half.in_place
        assert half.unconfirmed_since_ns == self.T_NS
        whole = self.step(placed, self.state(Circle(320.0, 240.0, 190.0), 280.0, d=True))
        assert whole.unconfirmed_since_ns is None

    def test_what_was_covered_before_a_release_does_not_count_after_it(self) -> None:
        covered = Visit(in_place=True, place=self.PLACE, covered_since_ns=1, still_since_ns=1, candidate=self.PLACE)
        released = self.step(covered, self.state(self.PLACE.circle, 280.0, d=True), release=True)
        assert released.released
        assert (released.covered_since_ns, released.still_since_ns, released.candidate) == (None, None, None)
