"""What the driver is advice, in numbers and in one word."""

import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import CrossCheck, FusionConfig, GuidanceConfig
from gateway.core import guidance
from gateway.core.detection import Circle
from gateway.core.guidance import TRACK_MAX, closing_mm_s, to_go_mm, tracked
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import (
    FunctionCheck,
    FusionMemory,
    Guidance,
    GuidanceCode,
    StateVector,
    TruckPosition,
    Visit,
    VisitPhase,
)

MS = 1_000_000
S = 1000 * MS
T0 = 100 * S
PAPER = FusionConfig()  # R_th 180 px, Z_th 300 mm
AIM = GuidanceConfig(aim_u_px=320.0, aim_v_px=240.0, marker_radius_mm=100.0)


def advise(
    radius_px: float | None = 60.0,
    distance_mm: float | None = 900.0,
    *,
    u_px: float = 320.0,
    vision: Quality = Quality.GOOD,
    rng: Quality = Quality.GOOD,
    d: bool | None = False,
    stop: bool = False,
    memory: FusionMemory | None = None,
    visit: Visit | None = None,
    before: GuidanceCode = GuidanceCode.WAIT,
    may_move: bool = False,
    check: FunctionCheck = FunctionCheck.OFF,
    config: GuidanceConfig = AIM,
    fusion: FusionConfig = PAPER,
    **how: Any,
) -> Guidance:
    circle = Circle(u_px, 250.0, radius_px) if radius_px is not None and vision is Quality.GOOD else None
    state = StateVector(
        "bay1",
        vision=VisionReading(T0, vision, circle),
        range=RangeReading(T0, rng, distance_mm if rng is Quality.GOOD else None),
        d=d if vision is rng is Quality.GOOD else None,
        stop=stop or vision is not Quality.GOOD or rng is not Quality.GOOD,
        may_move=may_move,
        memory=memory or FusionMemory(),
        visit=visit or Visit(),
        guidance=Guidance(before),
        function_check=check,
    )
    return guidance.advise(state, fusion, config, **({"in_use": True, "broken": False, "speed": 0.0} | how))


def test_on_the_way() -> None:
    advice = advise()
    # Z_th: 900 - 300 = 600 mm; R_th at 900 * 60 / 180 = 300 mm, which is 600 mm away, too.
    assert advice == Guidance(GuidanceCode.FORWARD, 600.0, 0.0, 10.0, 0.0, 0.0, 600.0)


def test_to_go_is_where_the_later_of_both_conditions_comes_true() -> None:
    assert to_go_mm(60.0, 900.0, PAPER) == pytest.approx(600.0)
    assert to_go_mm(30.0, 900.0, PAPER) == pytest.approx(750.0), "a small marker: R_th comes at 150 mm"
    assert to_go_mm(200.0, 900.0, PAPER) == pytest.approx(600.0)
    assert to_go_mm(200.0, 200.0, PAPER) == pytest.approx(-22.22, abs=0.01), "R_th was reached last, 22 mm ago"


@given(st.floats(1, 2000), st.floats(10, 4000))
def test_to_go_is_nothing_exactly_where_d_turns(radius_px: float, distance_mm: float) -> None:
    """Drive on by to_go: an exact pinhole is at the threshold then."""
    go = to_go_mm(radius_px, distance_mm, PAPER)
    there_mm = distance_mm - go
    there_px = radius_px * distance_mm / there_mm
    assert there_mm <= PAPER.distance_threshold_mm * (1 + 1e-9)
    assert there_px >= PAPER.radius_threshold_px * (1 - 1e-9)
    assert there_mm == pytest.approx(PAPER.distance_threshold_mm) or there_px == pytest.approx(
        PAPER.radius_threshold_px
    )


@pytest.mark.parametrize(
    ("u_px", "mirrored", "code"),
    [
        (341.0, False, GuidanceCode.LEFT),
        (299.0, False, GuidanceCode.RIGHT),
        (341.0, True, GuidanceCode.RIGHT),
        (299.0, True, GuidanceCode.LEFT),
        (340.0, False, GuidanceCode.FORWARD),
        (300.0, True, GuidanceCode.FORWARD),
    ],
)
def test_to_the_side(u_px: float, mirrored: bool, code: GuidanceCode) -> None:
    advice = advise(u_px=u_px, config=AIM.model_copy(update={"mirrored": mirrored}))
    assert advice.code is code
    assert advice.offset_mm == pytest.approx((u_px - 320) * 100 / 60)
    if code is not GuidanceCode.FORWARD:
        assert advice.amount_mm == pytest.approx(21 * 100 / 60)


def test_a_marker_of_no_size_has_pixels_to_the_side_and_no_mm() -> None:
    point, dot = advise(0.0, u_px=400.0), advise(1.0, u_px=400.0)
    assert (point.offset_u_px, point.offset_mm) == (80.0, None)
    assert (dot.offset_u_px, dot.offset_mm) == (80.0, 8000.0)


def test_to_the_side_by_less_than_a_pixel() -> None:
    narrow = AIM.model_copy(update={"tolerance_px": 0.5})
    assert advise(u_px=320.75, config=narrow).code is GuidanceCode.LEFT
    assert advise(u_px=319.25, config=narrow).code is GuidanceCode.RIGHT


def test_mm_to_the_side_need_the_markers_size() -> None:
    bare = GuidanceConfig(aim_u_px=320.0)
    assert (advise(u_px=400.0, config=bare).amount_mm, advise(u_px=400.0, config=bare).offset_u_px) == (None, 80.0)
    checked = FusionConfig(cross_check=CrossCheck(focal_px=900, marker_radius_mm=60))
    assert advise(u_px=400.0, config=bare, fusion=checked).amount_mm == pytest.approx(80.0)
    none = advise(u_px=5000.0, config=GuidanceConfig())
    assert (none.code, none.offset_u_px) == (GuidanceCode.FORWARD, None)


@pytest.mark.parametrize(
    ("distance_mm", "speed", "code"),
    [
        (801.0, 0.0, GuidanceCode.FORWARD),
        (800.0, 0.0, GuidanceCode.SLOW),  # 500 mm to go
        (1300.0, 166.0, GuidanceCode.FORWARD),
        (1300.0, 167.0, GuidanceCode.SLOW),  # 1000 mm to go within 6 s
        (1300.0, -20.0, GuidanceCode.FORWARD),  # still_mm_s is not yet driving away
        (1300.0, -20.5, GuidanceCode.STOP),
        (500.0, -20.5, GuidanceCode.STOP),
        (1300.0, None, GuidanceCode.FORWARD),
    ],
)
def test_slow(distance_mm: float, speed: float | None, code: GuidanceCode) -> None:
    assert advise(180.0, distance_mm, speed=speed).code is code


def test_slow_for_a_truck_that_creeps() -> None:
    near = AIM.model_copy(update={"slow_mm": 0.0})  # so that only the time to go counts
    assert advise(180.0, 301.0, speed=0.25, config=near).code is GuidanceCode.SLOW, "1 mm within 6 s"
    assert advise(180.0, 302.0, speed=0.25, config=near).code is GuidanceCode.FORWARD


@pytest.mark.parametrize(
    ("distance_mm", "u_px", "speed", "code", "amount"),
    [
        (280.0, 320.0, 0.0, GuidanceCode.STOP, None),  # at the mark; in place only when it has settled
        (280.0, 320.0, 60.0, GuidanceCode.STOP, None),
        (280.0, 320.0, None, GuidanceCode.STOP, None),  # not known to stand
        (280.0, 345.0, 0.0, GuidanceCode.STOP, None),  # in place, but to the side of the aim
        (150.0, 320.0, 60.0, GuidanceCode.TOO_FAR, 150.0),
        (150.0, 320.0, None, GuidanceCode.TOO_FAR, 150.0),
        (150.0, 320.0, 19.9, GuidanceCode.BACK, 150.0),
        (150.0, 320.0, 20.0, GuidanceCode.TOO_FAR, 150.0),  # still_mm_s is not standing still any more
        (200.0, 320.0, 5.0, GuidanceCode.STOP, None),  # exactly overshoot_mm is still fine
    ],
)
def test_at_the_mark_and_past_it(
    distance_mm: float, u_px: float, speed: float | None, code: GuidanceCode, amount: float | None
) -> None:
    advice = advise(900.0, distance_mm, u_px=u_px, d=True, stop=True, speed=speed)
    assert (advice.code, advice.amount_mm) == (code, amount)


@pytest.mark.parametrize(
    ("distance_mm", "before", "speed", "code"),
    [
        (205.0, GuidanceCode.BACK, 0.0, GuidanceCode.BACK),  # 95 mm past: noise at the edge of 100 mm
        (205.0, GuidanceCode.STOP, 0.0, GuidanceCode.STOP),
        (205.0, GuidanceCode.BACK, 20.0, GuidanceCode.STOP),  # it comes nearer again
        (205.0, GuidanceCode.BACK, None, GuidanceCode.STOP),
        (251.0, GuidanceCode.BACK, 0.0, GuidanceCode.STOP),  # beyond the middle
        (205.0, GuidanceCode.BACK, -44.0, GuidanceCode.BACK),
        (205.0, GuidanceCode.BACK, -46.0, GuidanceCode.STOP),  # there within stop_lead_s
    ],
)
def test_back_stays_until_the_middle(
    distance_mm: float, before: GuidanceCode, speed: float | None, code: GuidanceCode
) -> None:
    assert advise(900.0, distance_mm, d=True, stop=True, before=before, speed=speed).code is code


@pytest.mark.parametrize(
    ("speed", "code", "amount"),
    [
        (0.0, GuidanceCode.BACK, 150.0),
        (30.0, GuidanceCode.TOO_FAR, 150.0),
        (-30.0, GuidanceCode.BACK, 150.0),
        (-300.0, GuidanceCode.STOP, None),  # it comes to the middle of the tolerance while the driver reacts
    ],
)
def test_past_the_mark_and_too_near_for_the_camera(speed: float, code: GuidanceCode, amount: float | None) -> None:
    advice = advise(None, 150.0, vision=Quality.NO_TARGET, memory=FusionMemory(d=True), speed=speed)
    assert (advice.code, advice.amount_mm, advice.to_go_mm) == (code, amount, -150.0)


def test_past_the_mark_is_stop_while_d_is_0() -> None:
    assert advise(900.0, 150.0, d=False, stop=True).code is GuidanceCode.STOP


@pytest.mark.parametrize(
    ("phase", "released", "speed", "code"),
    [
        (VisitPhase.ARRIVING, False, 0.0, GuidanceCode.DRIVE_UP),
        (VisitPhase.APPROACHING, False, -20.0, GuidanceCode.FORWARD),
        (VisitPhase.APPROACHING, False, -100.0, GuidanceCode.STOP),
        (VisitPhase.APPROACHING, True, 0.0, GuidanceCode.FORWARD),
        (VisitPhase.RELEASED, True, 0.0, GuidanceCode.LEAVE),
        (VisitPhase.RELEASED, False, None, GuidanceCode.LEAVE),
        (VisitPhase.LEAVING, True, 0.0, GuidanceCode.LEAVE),
        (VisitPhase.LEAVING, True, None, GuidanceCode.LEAVE),
        (VisitPhase.LEAVING, True, 60.0, GuidanceCode.LEAVE),
        (VisitPhase.LEAVING, False, -100.0, GuidanceCode.LEAVE),
        (VisitPhase.LEAVING, False, None, GuidanceCode.LEAVE),
        (VisitPhase.LEAVING, False, 20.0, GuidanceCode.LEAVE),  # still_mm_s is not yet driving
        (VisitPhase.LEAVING, False, 20.5, GuidanceCode.FORWARD),  # it drives back to the mark
    ],
)
def test_a_truck_that_may_move_is_directed_by_its_visit(
    phase: VisitPhase, released: bool, speed: float | None, code: GuidanceCode
) -> None:
    visit = Visit(phase=phase, released=released)
    assert advise(visit=visit, may_move=True, speed=speed).code is code
    if code is not GuidanceCode.FORWARD:
        withheld = advise(visit=visit, may_move=False, speed=speed).code
        assert withheld is (GuidanceCode.STOP if speed == -100.0 else GuidanceCode.FORWARD), "it may not move"


@pytest.mark.parametrize(("speed", "code"), [(-20.0, GuidanceCode.SLOW), (-20.5, GuidanceCode.STOP)])
def test_a_truck_that_backs_out_is_told_no_arrow_towards_the_mark(speed: float, code: GuidanceCode) -> None:
    """It has left its place before it was loaded; beside the aim as well."""
    place = TruckPosition(280.0, Circle(320, 240, 190.0))
    visit = Visit(phase=VisitPhase.LEAVING, place=place, seen_moving=True)
    assert advise(150.0, 350.0, visit=visit, may_move=True, speed=speed).code is code
    aside = advise(150.0, 350.0, u_px=100.0, visit=visit, may_move=True, speed=speed).code
    assert aside is (GuidanceCode.RIGHT if speed == -20.0 else GuidanceCode.STOP)
    assert advise(u_px=100.0, speed=-20.5).code is GuidanceCode.STOP


@pytest.mark.parametrize("in_place", [True, False])
def test_a_fault_and_a_function_check_precede_the_visit(in_place: bool) -> None:
    visit = Visit(phase=VisitPhase.IN_PLACE if in_place else VisitPhase.RELEASED, in_place=in_place)
    well = GuidanceCode.OK if in_place else GuidanceCode.LEAVE
    assert advise(visit=visit, may_move=True, in_use=False).code is well
    assert advise(visit=visit, may_move=True, broken=True).code is GuidanceCode.FAULT
    for check in (FunctionCheck.MAY_MOVE_OFF, FunctionCheck.MAY_MOVE_KEPT):
        assert advise(visit=visit, may_move=True, in_use=False, check=check).code is GuidanceCode.WAIT


@pytest.mark.parametrize(
    ("vision", "rng", "code"),
    [
        (Quality.WAITING, Quality.GOOD, GuidanceCode.WAIT),
        (Quality.NO_TARGET, Quality.NO_ECHO, GuidanceCode.WAIT),
        (Quality.NO_TARGET, Quality.TOO_FAR, GuidanceCode.WAIT),
        (Quality.GOOD, Quality.TOO_FAR, GuidanceCode.WAIT),
        (Quality.COASTED, Quality.GOOD, GuidanceCode.STOP),
        (Quality.GOOD, Quality.TOO_NEAR, GuidanceCode.STOP),
        (Quality.NO_TARGET, Quality.UNSTABLE, GuidanceCode.STOP),
        (Quality.NO_TARGET, Quality.LINK_DOWN, GuidanceCode.FAULT),
        (Quality.STALE, Quality.TOO_NEAR, GuidanceCode.FAULT),
        (Quality.PROCESS_FAULT, Quality.GOOD, GuidanceCode.FAULT),
        (Quality.GOOD, Quality.STUCK, GuidanceCode.FAULT),
        (Quality.GOOD, Quality.WRONG_VERSION, GuidanceCode.FAULT),
    ],
)
def test_without_a_good_sensor(vision: Quality, rng: Quality, code: GuidanceCode) -> None:
    advice = advise(vision=vision, rng=rng)
    assert (advice.code, advice.amount_mm, advice.to_go_mm) == (code, None, None)


def test_what_else_holds_a_truck_back() -> None:
    assert advise(broken=True).code is GuidanceCode.FAULT
    assert advise(memory=FusionMemory(disagree=True)).code is GuidanceCode.FAULT
    assert advise(in_use=False).code is GuidanceCode.WAIT
    assert advise(memory=FusionMemory(latched=True), stop=True).code is GuidanceCode.STOP
    assert advise(memory=FusionMemory(latched=True), in_use=False).code is GuidanceCode.STOP
    assert advise(900.0, 280.0, memory=FusionMemory(latched=True), d=True, stop=True).code is GuidanceCode.STOP
    assert advise(stop=True).code is GuidanceCode.STOP


# The speed.


def approach(speed: float, *, count: int = 16, period_ms: int = 60, noise_mm: float = 0.0) -> list[RangeReading]:
    chance = random.Random(7)
    return [
        RangeReading(
            T0 + n * period_ms * MS,
            Quality.GOOD,
            round(2000 - speed * n * period_ms / 1000 + chance.uniform(-noise_mm, noise_mm)),
        )
        for n in range(count)
    ]


def follow(readings: list[RangeReading]) -> guidance.Track:
    track: guidance.Track = ()
    for reading in readings:
        track = tracked(track, reading, reading.t_ns)
    return track


@pytest.mark.parametrize("speed", [-800.0, -20.0, 0.0, 20.0, 250.0, 1500.0])
def test_speed_of_a_steady_truck(speed: float) -> None:
    assert closing_mm_s(follow(approach(speed, noise_mm=2.0))) == pytest.approx(speed, abs=6.0)


def test_a_quarter_of_wild_readings_does_not_move_the_speed() -> None:
    readings = approach(300.0, noise_mm=2.0)
    for n in (2, 7, 11, 14):
        readings[n] = RangeReading(readings[n].t_ns, Quality.GOOD, 3900.0)
    assert closing_mm_s(follow(readings)) == pytest.approx(300.0, abs=60.0)


def test_too_little_is_no_speed() -> None:
    assert closing_mm_s(()) is None
    assert closing_mm_s(follow(approach(100.0, count=3))) is None
    assert closing_mm_s(follow(approach(100.0, count=10, period_ms=10))) is None, "over 90 ms"
    assert closing_mm_s(follow(approach(100.0, count=4))) == pytest.approx(100.0, abs=15)
    assert closing_mm_s([(T0 + n * 50 * MS, 100.0 - n) for n in range(4)]) == pytest.approx(20.0), "over 150 ms"
    twice = [(0, 0.0), (0, 5.0), (0, 9.0), (200 * MS, 9.0)]
    assert closing_mm_s(twice) == pytest.approx(-20.0), "no speed between two readings of one time"
    stamp = [RangeReading(T0, Quality.GOOD, 5.0)] * 9
    assert closing_mm_s(follow(stamp)) is None


def test_the_track_ends_with_its_sensor_and_forgets() -> None:
    readings = approach(100.0, count=40)
    track = follow(readings)
    assert len(track) == TRACK_MAX
    assert track[-1] == (readings[-1].t_ns, readings[-1].distance_mm)
    later = RangeReading(readings[-1].t_ns + 3 * S, Quality.GOOD, 5.0)
    assert tracked(track, later, later.t_ns) == ((later.t_ns, 5.0),)
    assert tracked(track, RangeReading(later.t_ns, Quality.NO_ECHO), later.t_ns) == ()
    assert tracked(track, readings[-1], readings[-1].t_ns) == track, "the same reading again"
    assert tracked(track, RangeReading(later.t_ns, Quality.GOOD), later.t_ns) == (), "good, and without a value"
    assert tracked(track, RangeReading(later.t_ns, Quality.UNSTABLE, 5.0), later.t_ns) == (), "not good"


def test_a_reading_of_a_second_ago_is_kept_and_older_ones_are_not() -> None:
    track = ((T0 - 1, 9.0), (T0, 8.0), (T0 + 1, 7.0))
    assert tracked(track, RangeReading(T0 + S, Quality.GOOD, 5.0), T0 + S) == (*track[1:], (T0 + S, 5.0))


@given(st.lists(st.tuples(st.integers(0, 10**10), st.floats(-1e9, 1e9)), max_size=16))
def test_any_track_has_a_finite_speed_or_none(points: list[tuple[int, float]]) -> None:
    speed = closing_mm_s(sorted(points))
    assert speed is None or abs(speed) <= 2e9 * 1e9
