"""Measured, coasted, lost: what is told of a sequence of frames, and that a prediction never decides anything."""

import math
import random
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import FusionConfig
from gateway.core import fusion
from gateway.core.detection import Circle, Detection, Rejection, Tracking
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector, Tick
from gateway.vision.pixels import Image
from gateway.vision.process.monitor import _quality as quality_of
from gateway.vision.track.follower import Follower
from gateway.vision.track.kalman_filter import Prediction
from tests import fused

MS = 1_000_000
S = 1_000_000_000
PERIOD_NS = 33 * MS
FRAME = np.zeros((480, 640, 3), np.uint8)


@dataclass
class Script:
    """A search that finds what it is told to, and remembers where it was told to look."""

    circle: Circle | None = None
    visible: float | None = None
    expected: list[Prediction | None] = field(default_factory=list)

    def __call__(self, image: Image, t_ns: int, expected: Prediction | None, radii_px: object) -> Detection:
        self.expected.append(expected)
        return Detection(self.circle, visible=self.visible, candidates=3, stage_ns=(("search", 5),))


def at(n: float) -> Circle:
    return Circle(100.0 + 4 * n, 200.0 - n, 60.0 + 0.5 * n)


class Drive:
    """Frames at a steady pace through a Follower."""

    def __init__(self, coast_s: float = 0.3) -> None:
        self.search = Script()
        self.find = Follower(self.search, coast_s)

    def frame(self, n: int, circle: Circle | None, t_ns: int | None = None) -> Detection:
        self.search.circle = circle
        return self.find(FRAME, n * PERIOD_NS if t_ns is None else t_ns)

    def seen(self, first: int, last: int) -> None:
        for n in range(first, last):
            assert self.frame(n, at(n)).tracking is Tracking.MEASURED


def test_a_measurement_is_reported_as_the_search_measured_it() -> None:
    drive = Drive()
    for n in range(50):
        shaken = replace(at(n), u_px=at(n).u_px + 3 * math.sin(1.7 * n))
        found = drive.frame(n, shaken)
        assert found == Detection(
            shaken, candidates=3, stage_ns=(("search", 5),), tracking=Tracking.MEASURED, predicted=None
        )
    assert drive.search.expected[0] is None
    assert all(expected is not None for expected in drive.search.expected[2:])


def test_a_hidden_marker_coasts_where_it_goes_and_is_lost_in_time() -> None:
    drive = Drive(coast_s=0.3)
    drive.seen(0, 30)
    labels = []
    for n in range(30, 60):
        found = drive.frame(n, None)
        labels.append(found.tracking)
        assert found.circle is None
        assert (found.predicted is not None) == (found.tracking is Tracking.COASTED)
        if found.predicted is not None:
            assert found.predicted.u_px == pytest.approx(at(n).u_px, abs=1.0)
            assert found.predicted.v_px == pytest.approx(at(n).v_px, abs=1.0)
            assert found.predicted.radius_px == pytest.approx(at(n).radius_px, abs=1.0)
    # Seen last in frame 29: frame 38 is 0.297 s later, frame 39 0.33 s.
    assert labels == [Tracking.COASTED] * 9 + [Tracking.LOST] * 21
    back = drive.frame(60, at(60))
    assert (back.tracking, back.circle) == (Tracking.MEASURED, at(60))


def test_nothing_is_lost_before_anything_was_found() -> None:
    found = Drive().frame(0, None)
    assert (found.circle, found.tracking, found.predicted) == (None, Tracking.LOST, None)


@pytest.mark.parametrize("seen", [1, 2])
def test_a_flash_of_red_does_not_coast(seen: int) -> None:
    drive = Drive()
    drive.seen(0, seen)
    assert drive.frame(seen, None).tracking is Tracking.LOST


def test_a_marker_that_drives_out_of_the_picture_is_lost_not_coasted() -> None:
    drive = Drive(coast_s=2.0)
    for n in range(20):
        drive.frame(n, Circle(560.0 + 4 * n, 200.0, 60.0))
    labels = [drive.frame(n, None).tracking for n in range(20, 24)]
    assert labels == [Tracking.LOST] * 4  # 640 and more: beyond the right edge


def test_a_prediction_that_is_not_useful_any_more_is_not_reported() -> None:
    drive = Drive(coast_s=10.0)
    drive.seen(0, 30)
    labels = [drive.frame(n, None).tracking for n in range(30, 120)]
    coasted = labels.count(Tracking.COASTED)
    assert 10 < coasted < 40  # the uncertainty has outgrown the marker long before the 10 s
    assert labels == [Tracking.COASTED] * coasted + [Tracking.LOST] * (90 - coasted)


def test_coasting_can_be_switched_off() -> None:
    drive = Drive(coast_s=0.0)
    drive.seen(0, 10)
    assert drive.frame(10, None).tracking is Tracking.LOST
    assert drive.frame(11, at(11)).tracking is Tracking.MEASURED


LAMP = Circle(500.0, 400.0, 30.0)


def test_a_jump_is_measured_when_the_third_frame_shows_it_and_then_followed() -> None:
    drive = Drive()
    drive.seen(0, 20)
    for n in (20, 21):
        refused = drive.frame(n, LAMP)
        assert refused.predicted is not None
        assert refused == Detection(
            None,
            candidates=3,
            rejected=(Rejection(LAMP, "jump"),),
            stage_ns=(("search", 5),),
            tracking=Tracking.COASTED,
            predicted=refused.predicted,
        )
        assert refused.predicted.u_px == pytest.approx(at(n).u_px, abs=1.0)
    third = drive.frame(22, LAMP)
    assert third == Detection(LAMP, candidates=3, stage_ns=(("search", 5),), tracking=Tracking.MEASURED)
    hidden = drive.frame(23, None)
    assert hidden.tracking is Tracking.COASTED
    assert hidden.predicted is not None
    assert hidden.predicted.u_px == pytest.approx(500, abs=2)


@pytest.mark.parametrize("size", [0.5, 0.7, 1.5, 2.0])
def test_another_size_at_the_same_place_is_a_jump_too(size: float) -> None:
    drive = Drive()
    drive.seen(0, 20)
    other = replace(at(20), radius_px=size * at(20).radius_px)
    assert [drive.frame(20 + n, other).tracking for n in range(3)] == [Tracking.COASTED] * 2 + [Tracking.MEASURED]


@pytest.mark.parametrize(
    ("radius", "jerk"), [(60.0, {"u_px": 45.0}), (60.0, {"radius_px": 20.0}), (14.0, {"v_px": 25.0, "u_px": 10.0})]
)
def test_a_jerk_of_the_camera_and_a_rough_measurement_are_no_jumps(radius: float, jerk: dict[str, float]) -> None:
    """What overlaps the prediction and is nearly as large is the marker, though the gate is narrower than that."""
    drive = Drive()
    still = Circle(300.0, 200.0, radius)
    for n in range(40):
        drive.frame(n, still)
    jerked = Circle(*(getattr(still, name) + jerk.get(name, 0.0) for name in ("u_px", "v_px", "radius_px")))
    found = drive.frame(40, jerked)
    expected = drive.search.expected[-1]
    assert expected is not None
    assert not expected.admits(jerked)
    assert (found.tracking, found.circle) == (Tracking.MEASURED, jerked)
    assert drive.frame(41, still).tracking is Tracking.MEASURED


def test_what_jumps_to_and_fro_is_never_measured() -> None:
    drive = Drive(coast_s=0.3)
    drive.seen(0, 20)
    for n in range(20, 50):
        assert drive.frame(n, LAMP if n % 2 else Circle(60.0, 400.0, 25.0)).tracking is not Tracking.MEASURED


@pytest.mark.parametrize("between", ["marker", "nothing"])
def test_only_frames_running_confirm_a_jump(between: str) -> None:
    drive = Drive()
    drive.seen(0, 20)
    for n in (20, 23, 26):
        assert drive.frame(n, LAMP).tracking is Tracking.COASTED
        assert drive.frame(n + 1, LAMP).tracking is Tracking.COASTED
        back = drive.frame(n + 2, at(n + 2) if between == "marker" else None)
        assert back.tracking is (Tracking.MEASURED if between == "marker" else Tracking.COASTED)


def test_a_frame_that_arrives_twice_confirms_nothing() -> None:
    drive = Drive()
    drive.seen(0, 20)
    assert [drive.frame(20, LAMP).tracking for _ in range(5)] == [Tracking.COASTED] * 5
    assert drive.frame(21, LAMP).tracking is Tracking.COASTED
    assert drive.frame(22, LAMP).tracking is Tracking.MEASURED


def test_a_tentative_track_outlives_the_track_it_contradicts() -> None:
    """A slow camera: the marker is lost by its age before the lamp has been seen three times."""
    drive = Drive(coast_s=0.3)
    drive.seen(0, 20)
    labels = [drive.frame(0, LAMP, 19 * PERIOD_NS + n * 200 * MS).tracking for n in (1, 2, 3)]
    assert labels == [Tracking.COASTED, Tracking.LOST, Tracking.MEASURED]


def test_a_marker_seen_once_is_no_less_contradicted_by_a_flash() -> None:
    drive = Drive()
    drive.seen(0, 1)
    assert drive.frame(1, LAMP).tracking is Tracking.LOST  # nothing to coast on, and no measurement
    assert drive.frame(2, at(2)).tracking is Tracking.MEASURED


def test_a_clock_set_back_ends_a_tentative_track_and_does_not_stall_it() -> None:
    drive = Drive(coast_s=0.3)
    drive.seen(0, 20)
    for n in (20, 31):
        drive.frame(n, LAMP)  # the track is given up, the trial goes on
    labels = [drive.frame(n, LAMP, n * PERIOD_NS).tracking for n in (1, 2, 3)]
    assert labels == [Tracking.LOST, Tracking.LOST, Tracking.MEASURED]


@pytest.mark.parametrize(("radius_px", "whole"), [(30.0, False), (200.0, True)])
def test_with_a_much_larger_tentative_track_the_full_frame_is_searched(radius_px: float, whole: bool) -> None:
    drive = Drive()
    drive.seen(0, 20)
    for n in range(20, 24):
        drive.frame(n, replace(LAMP, radius_px=radius_px))
    assert [expected is None for expected in drive.search.expected[19:]] == [False, False, whole, whole, False]


def test_at_most_five_rejections_are_reported() -> None:
    many = Detection(LAMP, rejected=tuple(Rejection(replace(LAMP, u_px=float(n)), "weaker") for n in range(5)))
    answers = iter([Detection(at(0)), many])
    find = Follower(lambda *_: next(answers), 0.3)
    find(FRAME, 0)
    assert [refused.why for refused in find(FRAME, PERIOD_NS).rejected] == ["jump"] + ["weaker"] * 4


def test_frame_gaps_and_a_slow_camera() -> None:
    drive = Drive()
    drive.seen(0, 20)
    assert drive.frame(25, at(25)).tracking is Tracking.MEASURED  # five frames skipped
    expected = drive.search.expected[-1]
    assert expected is not None
    assert expected.circle.u_px == pytest.approx(at(25).u_px, abs=1.0)
    assert drive.frame(25 + 100, at(5)).tracking is Tracking.MEASURED  # three seconds later
    expected = drive.search.expected[-1]
    assert expected is not None
    assert not expected.useful  # it could be anywhere
    assert drive.frame(25 + 500, at(6)).tracking is Tracking.MEASURED
    assert drive.search.expected[-1] is None  # too long ago
    assert drive.frame(25 + 501, at(7)).tracking is Tracking.MEASURED


def test_frames_that_arrive_twice_or_late_break_nothing() -> None:
    drive = Drive()
    drive.seen(0, 20)
    for t_ns in (19 * PERIOD_NS, 19 * PERIOD_NS, 18 * PERIOD_NS, 12 * PERIOD_NS):
        assert drive.frame(0, at(t_ns / PERIOD_NS), t_ns).tracking is Tracking.MEASURED
    missed = drive.frame(0, None, 18 * PERIOD_NS)
    assert (missed.tracking, missed.predicted) == (Tracking.LOST, None)  # no prediction of the past
    hidden = drive.frame(21, None)
    assert hidden.tracking is Tracking.COASTED  # the track has lived through it all
    assert hidden.predicted is not None
    assert hidden.predicted.u_px == pytest.approx(at(21).u_px, abs=1.0)


def test_a_clock_that_does_not_advance_never_coasts() -> None:
    drive = Drive()
    for n in range(10):
        assert drive.frame(0, at(n), 0).tracking is Tracking.MEASURED
    assert [drive.frame(0, None, 0).tracking for _ in range(50)] == [Tracking.LOST] * 50


def test_a_clock_set_back_begins_anew() -> None:
    drive = Drive()
    for n in range(100, 120):
        drive.frame(n, at(n - 100))
    for n in range(5):
        assert drive.frame(n, at(20 + n)).tracking is Tracking.MEASURED
    assert drive.frame(5, None).tracking is Tracking.COASTED


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0, 0.0, 1e9])
def test_a_circle_that_cannot_be_is_no_measurement(bad: float) -> None:
    drive = Drive()
    drive.seen(0, 10)
    found = drive.frame(10, Circle(100.0, 100.0, bad))
    assert found.circle is None
    assert found.tracking is Tracking.COASTED


# -- through fusion: a coasted marker never raises or holds may_move ---------------------------------------------------

CONFIG = FusionConfig(raise_debounce_s=0.1, clear_debounce_s=0.2, radius_hysteresis_px=5)
CIRCLES = st.builds(Circle, st.floats(0, 640), st.floats(0, 480), st.one_of(st.floats(1, 400), st.just(179.9)))
STEPS = st.tuples(
    st.sampled_from(("seen", "steady", "missed", "missed", "range", "tick")),
    CIRCLES,
    st.integers(0, 400),
    st.floats(5, 600),
)


def reading(found: Detection, t_ns: int) -> VisionReading:
    """As the dispatcher makes it."""
    return VisionReading(
        t_ns, quality_of(found), circle=found.circle, tracking=found.tracking, predicted=found.predicted
    )


def decided(circles: list[Circle | None]) -> list[tuple[bool, bool, bool | None, Reason]]:
    """May move, stop, D and the reason after each frame, the truck at 90 cm."""
    drive, settings = Drive(), FusionConfig(decision="plain")
    state, states = fusion.initial("bay", 0), []
    for n, circle in enumerate(circles):
        state = fused.step(state, RangeReading(n * PERIOD_NS, Quality.GOOD, 900.0), n * PERIOD_NS, settings)
        state = fused.step(state, reading(drive.frame(n, circle), n * PERIOD_NS), n * PERIOD_NS, settings)
        states.append((state.may_move, state.stop, state.d, state.reason))
    return states


def test_may_move_falls_with_the_first_hidden_frame_and_returns_with_the_marker() -> None:
    states = decided([None if 30 <= n < 50 else at(n) for n in range(60)])
    assert states[:30] == [(True, False, False, Reason.NONE)] * 30
    assert states[30:39] == [(False, True, None, Reason.TARGET_COASTED)] * 9
    assert states[39:50] == [(False, True, None, Reason.NO_TARGET)] * 11
    assert states[50:] == [(True, False, False, Reason.NONE)] * 10


def test_a_lamp_beside_a_covered_marker_may_not_move_before_it_is_confirmed() -> None:
    moving, covered = (True, False, False, Reason.NONE), (False, True, None, Reason.TARGET_COASTED)
    states = decided([LAMP if n >= 30 else at(n) for n in range(34)])
    assert states[29:] == [moving, covered, covered, moving, moving]


@pytest.mark.one_interpreter
@given(st.lists(STEPS, max_size=40), st.floats(0, 3))
def test_a_coasted_marker_never_raises_or_holds_may_move(
    story: list[tuple[str, Circle, int, float]], coast_s: float
) -> None:
    search, now_ns = Script(), 0
    find = Follower(search, coast_s)
    state: StateVector = fusion.initial("bay", 0)
    last = Circle(300.0, 200.0, 100.0)
    for what, circle, later_ms, distance_mm in story:
        now_ns += later_ms * MS // 4
        match what:
            case "range":
                state = fused.step(state, RangeReading(now_ns, Quality.GOOD, distance_mm), now_ns, CONFIG)
            case "tick":
                state = fused.step(state, Tick(), now_ns, CONFIG)
            case _:
                last = circle if what == "seen" else last
                search.circle = None if what == "missed" else last
                found = find(FRAME, now_ns)
                state = fused.step(state, reading(found, now_ns), now_ns, CONFIG)
                if search.circle is None:
                    assert state.vision.quality in (Quality.COASTED, Quality.NO_TARGET)
        if state.vision.quality is not Quality.GOOD:
            assert state.may_move is False
            assert state.stop is True
            assert state.d is None
            assert state.vision.circle is None
        assert (state.vision.predicted is not None) == (state.vision.quality is Quality.COASTED)
        if state.may_move:
            assert state.vision.circle == last


@pytest.mark.parametrize("step_px", [4.0, 20.0])
def test_frames_that_arrive_in_bursts_make_no_jumps_of_a_steady_drive(step_px: float) -> None:
    """Stamped when they were handed over, not when they were taken, so that the speed seems to be anything."""
    for seed in range(10):
        rng, drive, t_ns = random.Random(seed), Drive(), 0
        for n in range(25):
            t_ns += int(rng.choice([0.3, 1, 3, 10, 60, 150]) * MS)
            seen = Circle(40.0 + step_px * n, 120.0 + rng.gauss(0, 0.3), 30.0)
            found = drive.frame(n, seen, t_ns)
            assert (found.tracking, found.circle) == (Tracking.MEASURED, seen), (seed, n)
