"""Time is an argument, so staleness needs no sleeping; the state machine at the end tries what nobody thought of."""

import math
from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from gateway.config import CrossCheck, FusionConfig
from gateway.core.agreement import LARGEST
from gateway.core.detection import Circle
from gateway.core.fusion import RANGE_REASON, VISION_REASON, Observation, forced_stop, initial
from gateway.core.readings import AgeProof, Quality, RangeReading, RangeStats, VisionReading, VisionStats
from gateway.core.retained import RetainedState
from gateway.core.scale import ScaleSample, learned
from gateway.core.state import (
    Guidance,
    GuidanceCode,
    Moved,
    Reason,
    StateVector,
    Tick,
    TruckPosition,
    Visit,
    VisitPhase,
)
from tests.examples import examples
from tests.fused import step

MS = 1_000_000
S = 1_000 * MS
T0 = 50 * S
TICK = Tick()
NAN, INF = math.nan, math.inf


def plain(**keys: Any) -> FusionConfig:
    """Equation 14 by itself at every step."""
    return FusionConfig(decision="plain", recovery_s=0, **keys)


def cross_checked(**keys: Any) -> FusionConfig:
    """f r / R = 600 * 90 / R, tolerance 50 mm + 10 % of Z, lasting 1 s."""
    return plain(cross_check=CrossCheck(**({"focal_px": 600, "marker_radius_mm": 90} | keys)))


PAPER = plain()
CHECKED = cross_checked()
FAULTS = [quality for quality in Quality if quality is not Quality.GOOD]


def seen(t_ns: int, radius_px: float = 200.0, *, frame_id: int = 0) -> VisionReading:
    return VisionReading(t_ns, Quality.GOOD, Circle(320.0, 240.0, radius_px), frame_id=frame_id)


def heard(t_ns: int, distance_mm: float = 250.0) -> RangeReading:
    return RangeReading(t_ns, Quality.GOOD, distance_mm)


def after(
    *observations: VisionReading | RangeReading | Tick, config: FusionConfig = PAPER, start: StateVector | None = None
) -> StateVector:
    """Every reading is stepped in at its own time stamp."""
    state = initial("bay1", T0) if start is None else start
    for observation in observations:
        now_ns = state.t_ns if isinstance(observation, Tick) else observation.t_ns
        state = step(state, observation, now_ns, config)
    return state


def both(radius_px: float, distance_mm: float, config: FusionConfig = PAPER, t_ns: int = T0) -> StateVector:
    return after(seen(t_ns, radius_px), heard(t_ns, distance_mm), config=config)


# Equation 14.


@pytest.mark.parametrize(
    ("radius_px", "distance_mm", "d"),
    [
        (180.0, 300.0, True),  # both thresholds belong to the stop side
        (179.999, 300.0, False),
        (180.0, 300.001, False),
        (500.0, 20.0, True),
        (500.0, 4000.0, False),  # large, but far: the lateral criterion alone stops nothing
        (20.0, 20.0, False),  # near, but small
        (0.0, 5.0, False),
    ],
)
def test_default_decision_is_equation_14(radius_px: float, distance_mm: float, d: bool) -> None:
    state = both(radius_px, distance_mm)

    assert (state.d, state.stop, state.may_move) == (d, d, not d)
    assert state.reason is (Reason.TARGET_REACHED if d else Reason.NONE)


@pytest.mark.parametrize(("radius_px", "distance_mm"), [(180.0, 300.0), (180.0, 250.0), (200.0, 300.0)])
def test_d_that_became_1_exactly_at_a_threshold_is_held_against_a_false_circle(
    radius_px: float, distance_mm: float
) -> None:
    held = FusionConfig()
    state = after(seen(T0, radius_px), heard(T0, distance_mm), seen(T0 + 33_000_000, 49.0), config=held)
    assert state.d is True


def test_thresholds_are_configurable() -> None:
    config = plain(radius_threshold_px=90.0, distance_threshold_mm=500.0)

    assert both(90.0, 500.0, config).d is True
    assert both(89.9, 500.0, config).d is False
    assert both(90.0, 500.1, config).d is False


@pytest.mark.one_interpreter
@given(
    st.floats(0, 20_000, exclude_min=True),
    st.floats(0, 4000, exclude_min=True),
    st.floats(0, 1e6),
    st.floats(1e-3, 1e6),
)
@settings(max_examples=examples(60), deadline=None)
def test_any_thresholds_decide_as_equation_14(r_th: float, z_th: float, radius_px: float, distance_mm: float) -> None:
    config = plain(radius_threshold_px=r_th, distance_threshold_mm=z_th)

    assert both(radius_px, distance_mm, config).d is (radius_px >= r_th and distance_mm <= z_th)


# The start.


def test_initial_state_is_stop_and_knows_nothing() -> None:
    state = initial("bay7", T0)

    assert (state.bay, state.t_ns, state.seq, state.heartbeat) == ("bay7", T0, 0, 0)
    assert (state.d, state.stop, state.may_move, state.reason) == (None, True, False, Reason.STARTING)
    assert (state.vision.quality, state.range.quality) == (Quality.WAITING, Quality.WAITING)
    assert (state.vision.t_ns, state.range.t_ns) == (T0, T0)


def test_one_sensor_alone_stays_starting() -> None:
    for state in (after(seen(T0)), after(heard(T0))):
        assert (state.d, state.stop, state.reason) == (None, True, Reason.STARTING)


def test_waiting_becomes_a_fault_after_the_grace() -> None:
    grace_ns = int(PAPER.start_grace_s * S)
    state = step(initial("bay1", T0), TICK, T0 + grace_ns, PAPER)
    assert (state.vision.quality, state.range.quality, state.reason) == (
        Quality.WAITING,
        Quality.WAITING,
        Reason.STARTING,
    )

    late = step(state, TICK, T0 + grace_ns + 1, PAPER)
    assert (late.vision.quality, late.range.quality, late.reason) == (
        Quality.STALE,
        Quality.STALE,
        Reason.VISION_STALE,
    )
    assert "5 s" in late.vision.detail
    assert "5 s" in late.range.detail


def test_the_grace_is_no_deadline_for_values() -> None:
    """A deadline longer than the grace does not lengthen the grace, nor the other way round."""
    config = plain(vision_deadline_s=10, range_deadline_s=10)
    state = after(seen(T0), heard(T0), config=config)

    assert step(state, TICK, T0 + 10 * S, config).d is True
    assert step(initial("bay1", T0), TICK, T0 + 5 * S + 1, config).vision.quality is Quality.STALE


# Ages.


@pytest.mark.parametrize(("vision_s", "range_s"), [(0.3, 0.3), (0.02, 0.5), (0.7, 0.02)])
def test_values_fall_at_their_own_deadline(vision_s: float, range_s: float) -> None:
    config = plain(vision_deadline_s=vision_s, range_deadline_s=range_s)
    state = after(seen(T0), heard(T0), config=config)

    for deadline_s in (vision_s, range_s):
        now_ns = T0 + round(deadline_s * S)
        at, over = step(state, TICK, now_ns, config), step(state, TICK, now_ns + 1, config)
        assert (at.vision.quality is Quality.GOOD) is (deadline_s <= vision_s)
        assert (at.range.quality is Quality.GOOD) is (deadline_s <= range_s)
        assert (over.vision.quality is Quality.GOOD) is (deadline_s < vision_s)
        assert (over.range.quality is Quality.GOOD) is (deadline_s < range_s)
        assert over.d is None


def test_a_stale_value_is_withdrawn_but_its_time_stays() -> None:
    reading = replace(seen(T0, frame_id=7), x_n=0.1, y_n=-0.2, stats=VisionStats(frames=9))
    state = after(reading, replace(heard(T0), seq=5, stats=RangeStats(lines=4)))

    stale = step(state, TICK, T0 + 400 * MS + 1, PAPER)

    assert stale.vision == VisionReading(
        T0, Quality.STALE, None, 7, None, None, "no result for 0.3 s", VisionStats(frames=9)
    )
    assert stale.range == RangeReading(T0, Quality.STALE, None, 5, "no reading for 0.4 s", RangeStats(lines=4))
    assert (stale.d, stale.stop, stale.may_move, stale.reason) == (None, True, False, Reason.VISION_STALE)


def test_the_single_echo_goes_with_its_distance() -> None:
    state = after(seen(T0), replace(heard(T0), echo_mm=251.0))
    assert state.range.echo_mm == 251.0
    assert step(state, Tick(), T0 + 10 * 1_000_000_000, PAPER).range.echo_mm is None, "stale"
    assert forced_stop(state, Reason.GATEWAY_FAULT, T0).range.echo_mm is None
    for odd_mm in (math.nan, math.inf, -1.0, 0.0):
        reading = after(replace(heard(T0), echo_mm=odd_mm)).range
        assert (reading.distance_mm, reading.echo_mm) == (250.0, None)
    faulty = RangeReading(T0, Quality.NO_ECHO, echo_mm=251.0)
    assert after(faulty).range.echo_mm is None


def test_a_value_that_arrives_too_late_never_counts() -> None:
    state = after(heard(T0))
    late = step(state, seen(T0 + 1), T0 + 1 + 300 * MS + 1, PAPER)

    assert (late.vision.quality, late.vision.circle, late.d) == (Quality.STALE, None, None)


@pytest.mark.parametrize("quality", [q for q in Quality if q not in (Quality.GOOD, Quality.WAITING)])
def test_what_ages_and_what_stays(quality: Quality) -> None:
    """A complaint that needs a living source ages like a value; a lost link stays lost until a reading arrives."""
    state = after(VisionReading(T0, quality), RangeReading(T0, quality))
    later = step(state, TICK, T0 + 500 * MS, PAPER)

    vision_ages = quality in (Quality.NO_TARGET, Quality.COASTED)
    range_stays = quality in (Quality.LINK_DOWN, Quality.WRONG_VERSION)
    assert later.vision.quality is (Quality.STALE if vision_ages else quality)
    assert later.range.quality is (quality if range_stays else Quality.STALE)


# Order.


def test_an_older_reading_never_replaces_a_newer_one() -> None:
    state = after(seen(T0 + 10, 200.0), heard(T0 + 10, 250.0))
    state = step(state, replace(seen(T0 + 9, 10.0), stats=VisionStats(skipped=3)), T0 + 11, PAPER)
    state = step(state, replace(heard(T0 + 9, 4000.0), stats=RangeStats(gaps=2)), T0 + 12, PAPER)

    assert state.vision.circle == Circle(320.0, 240.0, 200.0)
    assert (state.vision.t_ns, state.range.t_ns, state.range.distance_mm) == (T0 + 10, T0 + 10, 250.0)
    assert (state.vision.stats.skipped, state.range.stats.gaps) == (3, 2)  # counters are kept all the same


def test_an_old_value_does_not_lift_a_newer_fault() -> None:
    state = after(seen(T0), heard(T0), VisionReading(T0 + 5, Quality.LINK_DOWN), RangeReading(T0 + 5, Quality.STUCK))
    for late in (seen(T0 + 4), heard(T0 + 4)):
        state = step(state, late, T0 + 6, PAPER)

    assert (state.vision.quality, state.range.quality, state.d) == (Quality.LINK_DOWN, Quality.STUCK, None)


@pytest.mark.parametrize("fault", sorted(set(Quality) - {Quality.GOOD, Quality.WAITING}))
def test_a_port_that_opens_again_lifts_no_fault(fault: Quality) -> None:
    """A serial server that is busy accepts every connection and closes it: nothing has recovered in between."""
    state = after(seen(T0, 100.0), RangeReading(T0, fault), RangeReading(T0 + 9 * MS, Quality.WAITING))
    assert (state.range.quality, state.range.t_ns) == (fault, T0)
    assert after(heard(T0 + 10 * MS, 900.0), start=state).may_move


def test_a_silence_while_it_recovers_begins_the_recovery_anew() -> None:
    """Dead; alive for 0.9 of the second that it takes; silent for longer than its deadline; alive again."""
    config = plain(cross_check=None).model_copy(update={"recovery_s": 1.0})
    state = after(seen(T0, 100.0), heard(T0, 900.0), RangeReading(T0, Quality.LINK_DOWN), config=config)

    def heard_until(last_ms: int, first_ms: int) -> Quality:
        nonlocal state
        for t_ms in range(first_ms, last_ms + 1, 100):
            state = step(state, heard(T0 + t_ms * MS, 900.0), T0 + t_ms * MS, config)
        return state.range.quality

    assert heard_until(1000, 100) is Quality.LINK_DOWN
    silent_ms = 1000 + round(1000 * config.range_deadline_s) + 1
    state = step(state, TICK, T0 + silent_ms * MS, config)
    assert heard_until(silent_ms + 999, silent_ms) is Quality.LINK_DOWN
    assert heard_until(silent_ms + 1000, silent_ms + 1000) is Quality.GOOD


def test_a_new_connection_withdraws_the_value_of_the_old_one() -> None:
    state = after(heard(T0), RangeReading(T0 + MS, Quality.WAITING))
    assert (state.range.quality, state.range.distance_mm) == (Quality.WAITING, None)


def test_an_old_fault_does_not_take_a_newer_value() -> None:
    state = after(seen(T0 + 5), heard(T0 + 5))
    for late in (VisionReading(T0 + 4, Quality.PROCESS_FAULT), RangeReading(T0 + 4, Quality.NO_ECHO)):
        state = step(state, late, T0 + 6, PAPER)

    assert state.d is True


def test_of_two_readings_with_one_stamp_the_later_one_counts() -> None:
    state = after(seen(T0, 10.0), heard(T0, 4000.0), seen(T0, 200.0), heard(T0, 250.0))

    assert state.d is True


def test_a_reading_from_before_the_start_is_ignored() -> None:
    state = step(initial("bay1", T0), seen(T0 - 1), T0, PAPER)

    assert state.vision.quality is Quality.WAITING


def test_a_stamp_from_the_future_is_dated_to_now() -> None:
    """Else a broken clock would keep a value fresh for ever, and lock every later reading out."""
    state = step(initial("bay1", T0), seen(T0 + 3600 * S), T0, PAPER)
    state = step(state, heard(T0 + 3600 * S), T0, PAPER)
    assert (state.vision.t_ns, state.range.t_ns, state.d) == (T0, T0, True)

    newer = after(seen(T0 + 1, 10.0), start=state)
    assert newer.d is False
    assert step(state, TICK, T0 + 300 * MS + 1, PAPER).d is None


# Damaged values.

BAD_NUMBERS = [NAN, INF, -INF, 1e300, -1e300, 10**400, 2 * LARGEST]


@pytest.mark.parametrize("bad", [*BAD_NUMBERS, -0.001, -180.0])
def test_a_radius_that_cannot_be_is_a_fault(bad: float) -> None:
    state = after(seen(T0), heard(T0), seen(T0 + 1, bad))

    assert (state.vision.quality, state.vision.circle) == (Quality.PROCESS_FAULT, None)
    assert (state.d, state.stop, state.may_move, state.reason) == (None, True, False, Reason.VISION_FAULT)
    assert state.vision.detail == "detection without a usable circle"


@pytest.mark.parametrize("bad", BAD_NUMBERS)
@pytest.mark.parametrize("axis", ["u_px", "v_px"])
def test_a_centre_that_cannot_be_is_a_fault(axis: str, bad: float) -> None:
    reading = VisionReading(T0, Quality.GOOD, replace(Circle(1.0, 2.0, 200.0), **{axis: bad}))
    state = after(heard(T0), reading)

    assert (state.vision.quality, state.d, state.may_move) == (Quality.PROCESS_FAULT, None, False)


def test_the_largest_number_that_can_be() -> None:
    assert LARGEST == 1e9  # px, mm: every register type holds it
    at, over = 1e9, math.nextafter(1e9, math.inf)

    for sign in (1, -1):
        reading = VisionReading(T0, Quality.GOOD, Circle(sign * at, sign * at, at))
        assert after(reading).vision == reading
        damaged = VisionReading(T0, Quality.GOOD, Circle(sign * over, 0.0, 1.0))
        assert after(damaged).vision.quality is Quality.PROCESS_FAULT
    assert after(heard(T0, at)).range.distance_mm == at
    assert after(heard(T0, over)).range.quality is Quality.UNSTABLE


def test_a_centre_outside_the_picture_is_accepted() -> None:
    state = after(heard(T0), VisionReading(T0, Quality.GOOD, Circle(-50.0, -1.5, 200.0)))

    assert state.d is True


@pytest.mark.parametrize("bad", [*BAD_NUMBERS, 0.0, -0.0, -250.0])
def test_a_distance_that_cannot_be_is_a_fault(bad: float) -> None:
    """Above all: no echo that arrives as 0 mm is nearness."""
    state = after(seen(T0), heard(T0), heard(T0 + 1, bad))

    assert (state.range.quality, state.range.distance_mm) == (Quality.UNSTABLE, None)
    assert (state.d, state.stop, state.may_move, state.reason) == (None, True, False, Reason.RANGE_UNSTABLE)
    assert state.range.detail == "reading without a usable distance"


def test_good_without_a_value_is_a_fault() -> None:
    state = after(VisionReading(T0, Quality.GOOD), RangeReading(T0, Quality.GOOD))

    assert (state.vision.quality, state.range.quality) == (Quality.PROCESS_FAULT, Quality.UNSTABLE)


@pytest.mark.parametrize("quality", FAULTS)
def test_a_value_that_is_not_good_is_not_shown(quality: Quality) -> None:
    circle = Circle(1.0, 2.0, 300.0)
    state = after(VisionReading(T0, quality, circle, x_n=0.5, y_n=0.5), RangeReading(T0, quality, 100.0))

    assert (state.vision.circle, state.vision.x_n, state.vision.y_n) == (None, None, None)
    assert (state.range.distance_mm, state.d, state.may_move) == (None, None, False)


def test_coordinates_without_a_circle_are_not_shown() -> None:
    state = after(VisionReading(T0, Quality.NO_TARGET, None, x_n=0.5, y_n=0.5))

    assert (state.vision.x_n, state.vision.y_n) == (None, None)


@pytest.mark.parametrize(("x_n", "y_n"), [(NAN, 0.1), (0.1, INF), (0.1, 1e300)])
def test_normalised_coordinates_that_cannot_be_are_dropped_and_the_circle_stays(x_n: float, y_n: float) -> None:
    state = after(heard(T0), replace(seen(T0), x_n=x_n, y_n=y_n))

    assert (state.vision.x_n, state.vision.y_n, state.d) == (None, None, True)


def test_normalised_coordinates_pass_through() -> None:
    state = after(replace(seen(T0), x_n=-0.25, y_n=0.5))

    assert (state.vision.x_n, state.vision.y_n) == (-0.25, 0.5)


def test_a_measurement_carries_no_prediction() -> None:
    place = Circle(1.0, 2.0, 3.0)
    for quality in Quality:
        state = after(replace(seen(T0), quality=quality, predicted=place))
        assert state.vision.predicted == (place if quality is Quality.COASTED else None)


# Faults and their reasons.


VISION_FAULTS = {
    Quality.WAITING: Reason.STARTING,
    Quality.STALE: Reason.VISION_STALE,
    Quality.LINK_DOWN: Reason.CAMERA_DOWN,
    Quality.NO_TARGET: Reason.NO_TARGET,
    Quality.COASTED: Reason.TARGET_COASTED,
}
RANGE_FAULTS = {
    Quality.WAITING: Reason.STARTING,
    Quality.STALE: Reason.RANGE_STALE,
    Quality.NO_ECHO: Reason.NO_ECHO,
    Quality.TOO_NEAR: Reason.RANGE_TOO_NEAR,
    Quality.TOO_FAR: Reason.RANGE_TOO_FAR,
    Quality.STUCK: Reason.RANGER_STUCK,
    Quality.UNSTABLE: Reason.RANGE_UNSTABLE,
    Quality.WRONG_VERSION: Reason.RANGER_VERSION,
}


@pytest.mark.parametrize("quality", FAULTS)
def test_every_fault_of_a_sensor_stops_with_its_reason(quality: Quality) -> None:
    for fault, reason in (
        (VisionReading(T0 + 1, quality), VISION_FAULTS.get(quality, Reason.VISION_FAULT)),
        (RangeReading(T0 + 1, quality), RANGE_FAULTS.get(quality, Reason.RANGER_DOWN)),
    ):
        state = after(seen(T0, 27.0), heard(T0, 2000.0), fault)
        assert (state.d, state.stop, state.may_move, state.reason) == (None, True, False, reason)


def test_a_frame_refused_for_its_unproven_age_has_its_own_reason() -> None:
    """While such frames arrive; where they stop, or were accepted and have aged since, it is a stale picture."""
    refused = VisionReading(T0 + 1, Quality.STALE, age_proof=AgeProof.UNPROVEN)
    state = after(seen(T0, 27.0), heard(T0, 2000.0), refused)
    assert (state.d, state.stop, state.reason) == (None, True, Reason.VISION_AGE_UNPROVEN)
    state = after(seen(T0, 27.0), heard(T0, 2000.0), refused, heard(T0 + 2 * S, 2000.0))
    assert (state.stop, state.vision.quality, state.vision_age_unproven) == (True, Quality.STALE, False)
    assert state.reason is Reason.VISION_STALE
    accepted = replace(seen(T0, 27.0), age_proof=AgeProof.UNPROVEN)
    state = after(accepted, heard(T0, 2000.0))
    assert (state.vision.quality, state.vision_age_unproven) == (Quality.GOOD, True)
    state = after(accepted, heard(T0, 2000.0), heard(T0 + 2 * S, 2000.0))
    assert (state.vision.quality, state.vision_age_unproven) == (Quality.STALE, False)
    assert state.reason is Reason.VISION_STALE


def test_no_table_of_reasons_has_a_good_value() -> None:
    assert Quality.GOOD not in VISION_REASON
    assert Quality.GOOD not in RANGE_REASON
    assert Reason.NONE not in {*VISION_REASON.values(), *RANGE_REASON.values()}


@pytest.mark.parametrize(
    ("vision", "rng", "reason"),
    [
        (Quality.LINK_DOWN, Quality.LINK_DOWN, Reason.CAMERA_DOWN),  # of two repairs the camera's is named
        (Quality.NO_TARGET, Quality.STUCK, Reason.RANGER_STUCK),  # a repair before an empty bay
        (Quality.NO_TARGET, Quality.WAITING, Reason.STARTING),
        (Quality.WAITING, Quality.NO_ECHO, Reason.NO_ECHO),
        (Quality.WAITING, Quality.WAITING, Reason.STARTING),
        (Quality.NO_TARGET, Quality.GOOD, Reason.NO_TARGET),
    ],
)
def test_what_needs_a_repair_is_reported_first(vision: Quality, rng: Quality, reason: Reason) -> None:
    state = after(
        VisionReading(T0, vision), RangeReading(T0, rng, 100.0) if rng is Quality.GOOD else RangeReading(T0, rng)
    )

    assert state.reason is reason


def test_without_fail_safe_only_the_decision_stops() -> None:
    config = plain(fail_safe=False)
    faulty = after(seen(T0, 10.0), RangeReading(T0, Quality.LINK_DOWN), config=config)
    assert (faulty.d, faulty.stop, faulty.may_move, faulty.reason) == (None, False, False, Reason.NONE)

    reached = both(200.0, 250.0, config)
    assert (reached.d, reached.stop, reached.may_move, reached.reason) == (True, True, False, Reason.TARGET_REACHED)

    stale = step(reached, TICK, T0 + S, config)  # a blind gateway does not report stop, but permits nothing either
    assert (stale.d, stale.stop, stale.may_move, stale.reason) == (None, False, False, Reason.NONE)


def test_target_seen_remembers_the_last_frame_that_could_be_judged() -> None:
    state = after(seen(T0))
    assert state.memory.target_seen
    for quality in (Quality.LINK_DOWN, Quality.STALE, Quality.PROCESS_FAULT, Quality.WAITING):
        assert after(VisionReading(T0 + 1, quality), start=state).memory.target_seen
    gone = after(VisionReading(T0 + 1, Quality.NO_TARGET), start=state)
    assert not gone.memory.target_seen
    assert not after(VisionReading(T0 + 2, Quality.LINK_DOWN), start=gone).memory.target_seen


# Hysteresis and debounce.


def test_hysteresis_holds_the_stop_and_only_the_stop() -> None:
    config = plain(radius_hysteresis_px=10, distance_hysteresis_mm=20)
    rows = [  # radius, distance, D
        (179.0, 300.0, False),  # no easier to raise
        (180.0, 301.0, False),
        (180.0, 300.0, True),
        (170.0, 320.0, True),
        (169.9, 320.0, False),
        (170.0, 320.0, False),  # and no memory of having been up
        (180.0, 300.0, True),
        (200.0, 320.1, False),
    ]
    state = initial("bay1", T0)
    for n, (radius_px, distance_mm, d) in enumerate(rows, start=1):
        # One state per row must see both new values: the marker first, out of reach of a decision by itself.
        state = replace(state, range=heard(T0 + n, distance_mm), t_ns=T0 + n)
        state = step(state, seen(T0 + n, radius_px), T0 + n, config)
        assert (state.d, state.stop) == (d, d), rows[n - 1]


def decisions(config: FusionConfig, rows: list[tuple[int, float | None]]) -> list[bool | None]:
    """D after each row (ms, radius px or None for a lost marker); the distance is always short enough."""
    state = after(heard(T0), config=config)
    found: list[bool | None] = []
    for ms, radius_px in rows:
        now_ns = T0 + ms * MS
        frame = VisionReading(now_ns, Quality.NO_TARGET) if radius_px is None else seen(now_ns, radius_px)
        state = step(state, frame, now_ns, config)
        state = step(state, heard(now_ns), now_ns, config)
        found.append(state.d)
    return found


@pytest.mark.parametrize(
    ("keys", "rows", "expected"),
    [
        pytest.param(
            {"raise_debounce_s": 0.2},
            [(0, 100), (100, 200), (200, 200), (299, 200), (300, 200), (310, 100)],
            [False, False, False, False, True, False],
            id="delays a stop",
        ),
        pytest.param(
            {"clear_debounce_s": 0.2},
            [(0, 200), (100, 100), (299, 100), (300, 100), (310, 200)],
            [True, True, True, False, True],
            id="holds a stop",
        ),
        pytest.param(
            {"raise_debounce_s": 0.2},
            [(0, 100), (1, 200), (150, 100), (160, 200), (350, 200), (360, 200)],
            [False, False, False, False, False, True],
            id="a flicker starts it anew",
        ),
        pytest.param(
            {"clear_debounce_s": 0.2},
            [(0, 200), (10, 100), (150, None), (220, 100), (410, 100), (420, 100)],
            [True, True, None, True, True, False],
            id="a gap in the values starts it anew",
        ),
        pytest.param(
            {"raise_debounce_s": 0.2, "fail_safe": False},
            [(0, 200), (150, None), (210, 200), (400, 200), (410, 200)],
            [False, None, False, False, True],
            id="without fail_safe there is no stop of a fault to keep",
        ),
        pytest.param(
            {"raise_debounce_s": 0.2, "clear_debounce_s": 0.1},
            [
                *((0, 100), (150, 200), (250, 200), (349, 200), (350, 200)),
                *((400, 200), (420, 100), (519, 100), (520, 100)),
            ],
            [False, False, False, False, True, True, True, True, False],
            id="each way from the first contrary value",
        ),
    ],
)
def test_debounce(keys: dict[str, Any], rows: list[tuple[int, float | None]], expected: list[bool | None]) -> None:
    assert decisions(plain(**keys), rows) == expected


def test_the_debounce_of_a_stop_ends_no_stop_of_a_fault() -> None:
    """D = 1 all the time, but every third frame is lost: stop stays on, and permit off, throughout."""
    config = plain(raise_debounce_s=0.2)
    state = initial("bay1", T0)
    for n in range(30):
        now_ns = T0 + n * 33 * MS
        state = step(state, heard(now_ns, 200.0), now_ns, config)
        frame = VisionReading(now_ns, Quality.NO_TARGET) if n % 3 == 2 else seen(now_ns, 220.0)
        state = step(state, frame, now_ns, config)
        assert (state.stop, state.may_move) == (True, False)


def test_a_moment_beyond_the_thresholds_before_d_was_1_holds_nothing() -> None:
    """D = 1 is held until the truck has moved away; what was not D = 1 for raise_debounce_s yet is not."""
    config = FusionConfig(raise_debounce_s=0.3, recovery_s=0, clear_hold_s=0)
    state = after(seen(T0, 100.0), heard(T0, 900.0), config=config)
    for n, (radius_px, distance_mm) in enumerate([(181.0, 299.0), *[(179.0, 301.0)] * 9]):
        now_ns = T0 + (n + 1) * 100 * MS
        state = after(seen(now_ns, radius_px), heard(now_ns, distance_mm), start=state, config=config)
        assert state.d is False


@pytest.mark.parametrize(
    ("radius_px", "quality", "moves"),
    [
        (15.0, Quality.TOO_FAR, True),  # at exactly 3.6 m by R Z = 54,000
        (15.0, Quality.NO_ECHO, True),
        (15.01, Quality.TOO_FAR, False),
        (15.0, Quality.TOO_NEAR, False),
        (15.0, Quality.STUCK, False),
    ],
)
def test_a_small_marker_beyond_the_ranger_is_d_0(radius_px: float, quality: Quality, moves: bool) -> None:
    config = plain(radius_threshold_px=90.0)  # which R x Z is not that of the marker
    start = initial("bay1", T0)
    scale = learned((ScaleSample(0, 180.0, 300.0),) * 3, recipe=0)
    start = replace(start, memory=replace(start.memory, scale=scale))
    state = after(seen(T0, radius_px), RangeReading(T0, quality), start=start, config=config)
    assert (state.d, state.stop, state.may_move) == ((False, False, True) if moves else (None, True, False))


def test_a_turn_of_d_ends_its_wait() -> None:
    config = plain(raise_debounce_s=0.1, clear_debounce_s=0.1)
    state = after(seen(T0, 100.0), heard(T0), seen(T0), config=config)
    assert state.d is False
    state = step(state, TICK, T0 + 100 * MS, config)
    assert state.d is True

    state = step(state, seen(T0 + 101 * MS, 100.0), T0 + 101 * MS, config)
    assert state.d is True
    assert step(state, TICK, T0 + 201 * MS - 1, config).d is True
    assert step(state, TICK, T0 + 201 * MS, config).d is False


def test_debounce_goes_by_time_even_between_readings() -> None:
    config = plain(raise_debounce_s=0.1)
    state = after(seen(T0, 100.0), heard(T0), seen(T0), config=config)
    assert state.d is False

    assert step(state, TICK, T0 + 100 * MS - 1, config).d is False
    assert step(state, TICK, T0 + 100 * MS, config).d is True


@given(
    raise_s=st.sampled_from([0.0, 0.1, 0.25]),
    clear_s=st.sampled_from([0.0, 0.1, 0.25]),
    rows=st.lists(
        st.tuples(st.sampled_from([10, 50, 90, 100]), st.sampled_from([100.0, 200.0, 100.0, 200.0, None])), max_size=40
    ),
)
@settings(max_examples=examples(80), deadline=None)
def test_d_never_turns_before_its_time(raise_s: float, clear_s: float, rows: list[tuple[int, float | None]]) -> None:
    """Each turn of D must be preceded by its debounce time of unbroken contrary evidence, and no longer."""
    config = plain(raise_debounce_s=raise_s, clear_debounce_s=clear_s)
    times: list[int] = []
    for gap_ms, _ in rows:
        times.append((times[-1] if times else 0) + gap_ms)
    found = decisions(config, [(ms, radius) for ms, (_, radius) in zip(times, rows, strict=True)])

    held, blind = False, True
    contrary_since: int | None = None
    for ms, (_, radius), d in zip(times, rows, found, strict=True):
        if radius is None:
            assert d is None
            contrary_since, blind = None, True
            continue
        raw = radius >= 180
        held, blind = held or (raw and blind), False  # stop was on already: there is nothing to delay
        if raw == held:
            contrary_since = None
        elif contrary_since is None:
            contrary_since = ms
        if contrary_since is not None and (ms - contrary_since) * MS >= (raise_s if raw else clear_s) * S:
            held, contrary_since = raw, None
        assert d is held


# Cross-check.


@pytest.mark.parametrize(
    ("radius_px", "distance_mm", "z_vision_mm", "agree"),
    [
        (180.0, 300.0, 300.0, True),
        (180.0, 277.8, 300.0, True),
        (200.0, 200.0, 270.0, True),  # |270 - 200| = 70 = 50 + 0.1 * 200
        (200.0, 199.9, 270.0, False),
        (108.0, 500.0, 500.0, True),
        (90.0, 611.2, 600.0, True),
        (90.0, 500.0, 600.0, True),
        (90.0, 499.0, 600.0, False),
        (90.0, 723.0, 600.0, False),
        (0.5, 500.0, 108_000.0, False),
        (0.0, 500.0, None, False),  # a radius of nothing: infinitely far away
        (5e-324, 500.0, None, False),
    ],
)
def test_cross_check_compares_f_r_over_R(
    radius_px: float, distance_mm: float, z_vision_mm: float | None, agree: bool
) -> None:
    state = both(radius_px, distance_mm, CHECKED)

    assert state.z_vision_mm == z_vision_mm
    assert (state.memory.disagree_since_ns is None) is agree
    assert not state.memory.disagree  # not yet: it must last


def test_cross_check_knows_the_camera_offset() -> None:
    config = cross_checked(camera_offset_mm=120)
    state = both(100.0, 420.0, config)

    assert state.z_vision_mm == 420.0
    assert state.memory.disagree_since_ns is None


def disagreeing(ms: int) -> tuple[VisionReading, RangeReading]:
    return seen(T0 + ms * MS, 90.0), heard(T0 + ms * MS, 300.0)  # 600 mm against 300 mm


def agreeing(ms: int) -> tuple[VisionReading, RangeReading]:
    return seen(T0 + ms * MS, 90.0), heard(T0 + ms * MS, 600.0)


def test_a_lasting_disagreement_is_a_fault_and_agreement_ends_it() -> None:
    state = after(*disagreeing(0), config=CHECKED)
    for ms in range(250, 1000, 250):
        state = after(*disagreeing(ms), config=CHECKED, start=state)
    assert (state.memory.disagree, state.may_move) == (False, True)

    state = step(state, TICK, T0 + 1000 * MS - 1, CHECKED)
    assert not state.memory.disagree
    state = step(state, TICK, T0 + 1000 * MS, CHECKED)
    assert (state.memory.disagree, state.stop, state.may_move) == (True, True, False)
    assert (state.d, state.reason) == (False, Reason.SENSORS_DISAGREE)

    state = after(*agreeing(1100), config=CHECKED, start=state)
    assert (state.memory.disagree, state.memory.disagree_since_ns) == (False, None)
    assert (state.stop, state.may_move, state.reason) == (False, True, Reason.NONE)


def test_agreement_in_between_starts_the_wait_anew() -> None:
    state = after(*disagreeing(0), *disagreeing(900), *agreeing(950), *disagreeing(1000), config=CHECKED)
    state = after(*disagreeing(1900), config=CHECKED, start=state)
    assert not state.memory.disagree
    assert after(*disagreeing(2000), config=CHECKED, start=state).memory.disagree


def test_a_disagreement_is_neither_forgotten_nor_forgiven_by_blindness() -> None:
    state = after(*disagreeing(0), *disagreeing(1000), config=CHECKED)
    assert state.memory.disagree

    blind = after(VisionReading(T0 + 1100 * MS, Quality.NO_TARGET), config=CHECKED, start=state)
    assert blind.memory.disagree
    assert (blind.z_vision_mm, blind.reason) == (None, Reason.SENSORS_DISAGREE)
    deaf = after(RangeReading(T0 + 1100 * MS, Quality.NO_ECHO), config=CHECKED, start=state)
    assert deaf.memory.disagree
    assert deaf.z_vision_mm == 600.0
    back = after(*disagreeing(1200), config=CHECKED, start=blind)
    assert (back.memory.disagree, back.may_move) == (True, False)


def test_the_wait_goes_on_while_blind() -> None:
    """A marker that blinks must not keep a disagreement from ever lasting."""
    state = after(*disagreeing(0), VisionReading(T0 + 500 * MS, Quality.NO_TARGET), config=CHECKED)
    state = after(*disagreeing(1000), config=CHECKED, start=state)

    assert state.memory.disagree


def test_a_disagreement_of_no_duration_is_a_fault_at_once() -> None:
    config = cross_checked(lasting_s=0)

    assert after(*disagreeing(0), config=config).reason is Reason.SENSORS_DISAGREE


def test_a_disagreement_outranks_a_reached_target() -> None:
    config = cross_checked(focal_px=6000, lasting_s=0)
    state = both(200.0, 250.0, config)
    assert (state.d, state.stop, state.may_move, state.reason) == (True, True, False, Reason.SENSORS_DISAGREE)

    unsafe = both(200.0, 250.0, config.model_copy(update={"fail_safe": False}))
    assert (unsafe.stop, unsafe.may_move, unsafe.reason) == (True, False, Reason.TARGET_REACHED)


def test_without_the_cross_check_nothing_is_compared() -> None:
    state = both(90.0, 300.0)

    assert (state.z_vision_mm, state.memory.disagree_since_ns) == (None, None)


# Forced stop.


@pytest.mark.parametrize("reason", [Reason.GATEWAY_FAULT, Reason.SHUTDOWN])
def test_forced_stop_withdraws_every_value(reason: Reason) -> None:
    state = after(replace(seen(T0, 90.0, frame_id=4), x_n=0.1, y_n=0.2), heard(T0, 600.0), TICK, config=CHECKED)
    assert state.may_move

    forced = forced_stop(state, reason, T0 + 9)

    assert forced == replace(
        state,
        t_ns=T0 + 9,
        seq=state.seq + 1,
        vision=replace(state.vision, quality=Quality.STALE, circle=None, x_n=None, y_n=None),
        range=replace(state.range, quality=Quality.STALE, distance_mm=None),
        d=None,
        stop=True,
        may_move=False,
        reason=reason,
        z_vision_mm=None,
        plc=state.plc.withdrawn(),
        guidance=Guidance(GuidanceCode.FAULT),
    )


def test_forced_stop_keeps_of_a_visit_what_a_restart_keeps_and_nothing_else() -> None:
    place = TruckPosition(280.0, Circle(320, 240, 190.0))
    for visit, kept in (
        (Visit(VisitPhase.IN_PLACE, in_place=True, place=place, still_since_ns=T0), Visit(place=place, restored=True)),
        (
            Visit(VisitPhase.AT_MARK, place=place, moved=Moved.MARKER, moved_covered=True),
            Visit(place=place, restored=True, moved=Moved.MARKER, moved_covered=True),
        ),
        (Visit(VisitPhase.RELEASED, place=place, released=True), Visit()),
        (Visit(VisitPhase.APPROACHING), Visit()),
    ):
        state = replace(both(90.0, 600.0), visit=visit)
        assert forced_stop(state, Reason.GATEWAY_FAULT, T0).visit == kept == RetainedState.of(state).visit


def test_forced_stop_keeps_the_faults_it_finds() -> None:
    state = after(VisionReading(T0, Quality.LINK_DOWN, detail="no camera"), RangeReading(T0, Quality.NO_ECHO))
    forced = forced_stop(state, Reason.SHUTDOWN, T0)

    assert (forced.vision.quality, forced.vision.detail) == (Quality.LINK_DOWN, "no camera")
    assert forced.range.quality is Quality.NO_ECHO


def test_fusion_recovers_from_a_forced_stop_with_new_readings_only() -> None:
    forced = forced_stop(both(90.0, 600.0), Reason.GATEWAY_FAULT, T0 + 1)
    ticked = step(forced, TICK, T0 + 2, PAPER)
    assert (ticked.d, ticked.stop, ticked.reason) == (None, True, Reason.VISION_STALE)

    again = after(seen(T0 + 3, 90.0), heard(T0 + 3, 600.0), start=ticked)
    assert (again.d, again.stop, again.may_move, again.reason) == (False, False, True, Reason.NONE)


# Anything, in any order.

NUMBERS = st.one_of(st.sampled_from([0.0, 179.9, 180.0, 250.0, 300.0, 300.1, -1.0, NAN, INF, -INF, 1e300]), st.floats())
CIRCLES = st.one_of(
    st.builds(Circle, st.just(320.0), st.just(240.0), st.floats(100, 260)), st.builds(Circle, NUMBERS, NUMBERS, NUMBERS)
)
STAMPS_MS = st.one_of(st.integers(-60, 0), st.integers(-2000, 1000))
CONFIGS = {
    "paper": PAPER,
    "blind": plain(fail_safe=False),
    "checked": cross_checked(lasting_s=0.2),
    "everything": plain(
        radius_hysteresis_px=20,
        distance_hysteresis_mm=30,
        raise_debounce_s=0.05,
        clear_debounce_s=0.1,
        vision_deadline_s=0.1,
        range_deadline_s=0.5,
        cross_check=CrossCheck(focal_px=600, marker_radius_mm=90, lasting_s=0.1),
    ),
}


@dataclass
class Held:
    """What ought to be held of one sensor, told from all that was delivered: the newest stamp, the last of equals."""

    t_ns: int
    quality: Quality
    value: Circle | float | None = None

    def offer(self, t_ns: int, quality: Quality, value: Circle | float | None) -> None:
        if t_ns >= self.t_ns:
            self.t_ns, self.quality, self.value = t_ns, quality, value if quality is Quality.GOOD else None

    def at(self, now_ns: int, deadline_s: float, *, ages: frozenset[Quality]) -> Quality:
        if self.quality is Quality.WAITING:
            deadline_s = PAPER.start_grace_s
        over = self.quality in ages and now_ns - self.t_ns > deadline_s * S
        return Quality.STALE if over else self.quality


VISION_AGES = frozenset({Quality.GOOD, Quality.NO_TARGET, Quality.COASTED, Quality.WAITING})
RANGE_AGES = frozenset(Quality) - {Quality.LINK_DOWN, Quality.WRONG_VERSION, Quality.STALE}


def usable(*numbers: float) -> bool:
    return all(math.isfinite(n) and abs(n) <= LARGEST for n in numbers)


class FusionMachine(RuleBasedStateMachine):
    """Random readings, true and false, in any order, under several configurations; what must hold, holds always."""

    @initialize(name=st.sampled_from(sorted(CONFIGS)))
    def begin(self, name: str) -> None:
        self.name = name
        self.config = CONFIGS[name]
        self.now_ns = T0
        self.state = initial("bay1", T0)
        self.old = self.state
        self.vision = Held(T0, Quality.WAITING)
        self.range = Held(T0, Quality.WAITING)

    def _step(self, observation: Observation) -> None:
        self.old = self.state
        self.state = step(self.old, observation, self.now_ns, self.config)

    @rule(ms=st.one_of(st.integers(0, 60), st.integers(0, 6000)))
    def wait(self, ms: int) -> None:
        self.now_ns += ms * MS
        self._step(TICK)

    @rule(radius_px=st.sampled_from([100.0, 165.0, 180.0, 200.0]), distance_mm=st.sampled_from([200.0, 320.0, 540.0]))
    def both_well(self, radius_px: float, distance_mm: float) -> None:
        self.see(0, Quality.GOOD, Circle(1.0, 2.0, radius_px))
        self.hear(0, Quality.GOOD, distance_mm)

    @rule(ms=STAMPS_MS, quality=st.sampled_from(Quality), circle=st.none() | CIRCLES)
    def see(self, ms: int, quality: Quality, circle: Circle | None) -> None:
        t_ns = self.now_ns + ms * MS
        if quality is Quality.GOOD and not (
            circle and usable(circle.u_px, circle.v_px, circle.radius_px) and circle.radius_px >= 0
        ):
            self.vision.offer(min(t_ns, self.now_ns), Quality.PROCESS_FAULT, None)
        else:
            self.vision.offer(min(t_ns, self.now_ns), quality, circle)
        self._step(VisionReading(t_ns, quality, circle, x_n=NAN, y_n=0.0))

    @rule(ms=STAMPS_MS, quality=st.sampled_from(Quality), distance_mm=st.none() | NUMBERS)
    def hear(self, ms: int, quality: Quality, distance_mm: float | None) -> None:
        t_ns = self.now_ns + ms * MS
        good = distance_mm is not None and usable(distance_mm) and distance_mm > 0
        kept = Quality.UNSTABLE if quality is Quality.GOOD and not good else quality
        if kept is not Quality.WAITING or self.state.range.quality in (Quality.GOOD, Quality.WAITING):
            self.range.offer(min(t_ns, self.now_ns), kept, distance_mm)
        self._step(RangeReading(t_ns, quality, distance_mm))

    @precondition(lambda self: hasattr(self, "state"))
    @invariant()
    def is_as_of_now(self) -> None:
        assert self.state.t_ns == self.now_ns

    @precondition(lambda self: hasattr(self, "state"))
    @invariant()
    def holds_the_newest_and_only_while_fresh(self) -> None:
        state, config = self.state, self.config
        vision = self.vision.at(self.now_ns, config.vision_deadline_s, ages=VISION_AGES)
        rng = self.range.at(self.now_ns, config.range_deadline_s, ages=RANGE_AGES)
        assert (state.vision.quality, state.vision.t_ns) == (vision, self.vision.t_ns)
        assert (state.range.quality, state.range.t_ns) == (rng, self.range.t_ns)
        assert state.vision.circle == (self.vision.value if vision is Quality.GOOD else None)
        assert state.range.distance_mm == (self.range.value if rng is Quality.GOOD else None)
        assert state.vision.x_n is None  # NaN was offered

    @precondition(lambda self: hasattr(self, "state"))
    @invariant()
    def decides_only_on_what_it_knows(self) -> None:
        state = self.state
        circle, distance_mm = state.vision.circle, state.range.distance_mm
        assert (state.d is None) == (circle is None or distance_mm is None)
        if self.name in ("paper", "blind", "checked") and circle is not None and distance_mm is not None:
            assert state.d == (circle.radius_px >= 180 and distance_mm <= 300)
        if state.z_vision_mm is not None:
            assert circle is not None
            assert math.isfinite(state.z_vision_mm)

    @precondition(lambda self: hasattr(self, "state"))
    @invariant()
    def permits_only_what_is_healthy(self) -> None:
        state = self.state
        if state is self.old:  # before the first step: stop, whatever is configured
            assert (state.stop, state.may_move, state.reason) == (True, False, Reason.STARTING)
            return
        healthy = (
            state.vision.quality is Quality.GOOD
            and state.range.quality is Quality.GOOD
            and self.now_ns - state.vision.t_ns <= self.config.vision_deadline_s * S
            and self.now_ns - state.range.t_ns <= self.config.range_deadline_s * S
            and not state.memory.disagree
        )
        assert not (state.may_move and state.stop)
        assert state.may_move == (healthy and state.d is False)
        if self.config.fail_safe:
            assert state.stop == (not healthy or state.d is True)
        else:
            assert state.stop == (state.d is True)
        assert (state.reason is Reason.NONE) == (not state.stop)
        if state.reason in (Reason.TARGET_REACHED, Reason.CLEARING):
            assert state.d is (state.reason is Reason.TARGET_REACHED)
        if state.memory.disagree:
            assert self.config.cross_check is not None


TestFusionMachine = FusionMachine.TestCase
TestFusionMachine.settings = settings(max_examples=examples(150), stateful_step_count=30, deadline=None)
