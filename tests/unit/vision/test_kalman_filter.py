"""The constant-velocity filter: against a textbook one, against exact motion, and against nonsense."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.detection import Circle
from gateway.vision.track import kalman_filter as tracking
from gateway.vision.track.kalman_filter import Axis, Prediction, Track
from tests.discs import track_of

MS = 1_000_000
S = 1_000_000_000


def steady(frames: int = 40, period_ms: int = 33, u_speed: float = 90.0, r_speed: float = 12.0) -> Track:
    """A marker that moves to the right and grows, measured without noise."""
    track = track_of(Circle(100.0, 80.0, 60.0))
    for n in range(1, frames):
        t_s = n * period_ms / 1000
        circle = Circle(100.0 + u_speed * t_s, 80.0, 60.0 + r_speed * t_s)
        track = track.updated(circle, n * period_ms * MS)
    return track


def ahead(track: Track, t_ns: int) -> Prediction:
    found = track.at(t_ns)
    assert found is not None
    return found


def test_it_is_the_textbooks_kalman_filter() -> None:
    rng = np.random.default_rng(3)
    axis = Axis(x=10.0, w=0.0, xx=4.0, xw=0.0, ww=900.0)
    mean, cov = np.array([10.0, 0.0]), np.diag([4.0, 900.0])
    for _ in range(50):
        dt, q, measured, noise = rng.uniform(0.001, 0.3), rng.uniform(1, 1e4), rng.normal(10, 50), rng.uniform(0.1, 9)
        step = np.array([[1, dt], [0, 1]])
        mean = step @ mean
        cov = step @ cov @ step.T + q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        axis = axis.ahead(dt, q)
        np.testing.assert_allclose([axis.x, axis.w, axis.xx, axis.xw, axis.ww], [*mean, *cov.flat[[0, 1, 3]]])
        gain = cov[:, 0] / (cov[0, 0] + noise)
        mean = mean + gain * (measured - mean[0])
        cov = (np.eye(2) - np.outer(gain, [1.0, 0.0])) @ cov
        axis = axis.corrected(measured, noise)
        np.testing.assert_allclose([axis.x, axis.w, axis.xx, axis.xw, axis.ww], [*mean, *cov.flat[[0, 1, 3]]])


def test_steady_motion_is_predicted_where_it_goes() -> None:
    track = steady()
    for ahead_ms in (33, 100, 300):
        at = ahead(track, track.t_ns + ahead_ms * MS)
        t_s = (39 * 33 + ahead_ms) / 1000
        assert at.circle.u_px == pytest.approx(100 + 90 * t_s, abs=0.2)
        assert at.circle.v_px == pytest.approx(80, abs=1e-9)
        assert at.circle.radius_px == pytest.approx(60 + 12 * t_s, abs=0.05)


def test_a_variable_frame_rate_is_no_jitter() -> None:
    rng = np.random.default_rng(5)
    track, t_ns = track_of(Circle(0.0, 0.0, 60.0)), 0
    for n in range(120):
        t_ns += int(rng.integers(5, 120)) * MS
        at = ahead(track, t_ns)
        truth = Circle(200e-9 * t_ns, 0.0, 60.0)
        assert at.admits(truth)
        if n > 30:
            assert at.circle.u_px == pytest.approx(truth.u_px, abs=1.0)
        track = track.updated(truth, t_ns)


def test_the_gate_admits_vibration_and_refuses_a_jump() -> None:
    track = steady()
    at = ahead(track, track.t_ns + 33 * MS)
    u, v, r = at.circle.u_px, at.circle.v_px, at.circle.radius_px
    assert at.admits(at.circle)
    assert at.admits(Circle(u + 0.05 * r, v - 0.05 * r, 1.02 * r))
    assert not at.admits(Circle(u + 0.7 * r, v, r))
    assert not at.admits(Circle(u, v, 1.5 * r))
    assert not at.admits(Circle(u, v, 0.6 * r))


def test_a_small_far_marker_moves_with_the_camera_and_is_followed_all_the_same() -> None:
    track = track_of(Circle(200.0, 200.0, 12.0))
    for n in range(1, 10):
        at, truth = ahead(track, n * 33 * MS), Circle(200.0 + 10.0 * n, 200.0 - 2.0 * n, 12.0)  # most of R in a frame
        assert at.useful
        assert at.admits(truth), n
        track = track.updated(truth, n * 33 * MS)


def test_everything_admitted_lies_within_the_predictions_own_reach() -> None:
    at = ahead(steady(), 40 * 33 * MS)
    for share in np.linspace(0, 1.2, 60):
        shift, grown = share * at.reach_px, at.circle.radius_px + share * (at.largest_px - at.circle.radius_px)
        if at.admits(Circle(at.circle.u_px + shift, at.circle.v_px, at.circle.radius_px)):
            assert shift <= at.reach_px + 1e-9
        if at.admits(Circle(at.circle.u_px, at.circle.v_px, grown)):
            assert grown <= 1.2 * at.largest_px
    assert at.admits(Circle(at.circle.u_px + 0.99 * at.reach_px, at.circle.v_px, at.circle.radius_px))
    assert not at.admits(Circle(at.circle.u_px + 1.01 * at.reach_px, at.circle.v_px, at.circle.radius_px))


@pytest.mark.parametrize("sign", [1, -1])
def test_uncertainty_grows_with_time_in_either_direction(sign: int) -> None:
    track = steady()
    known = [ahead(track, track.t_ns + sign * ms * MS) for ms in (0, 10, 33, 100, 300, 1000, 3000)]
    for before, after in pairwise(known):
        assert before.sd_centre_px < after.sd_centre_px
        assert before.sd_radius_px < after.sd_radius_px
    assert known[0].useful
    assert not known[-1].useful
    assert track.at(track.t_ns + sign * 11 * S) is None


def test_a_frame_that_is_not_newer_teaches_nothing() -> None:
    track = steady()
    elsewhere = Circle(5.0, 5.0, 10.0)
    assert track.updated(elsewhere, track.t_ns) is track
    assert track.updated(elsewhere, track.t_ns - S) is track
    assert track.updated(Circle(math.nan, 1.0, 1.0), track.t_ns + S) is track
    assert track.updated(elsewhere, track.t_ns + 100 * S) is track  # too long ago to be a continuation


def test_less_of_the_rim_weighs_less() -> None:
    track, t_ns = steady(), 40 * 33 * MS
    at = ahead(track, t_ns)
    off = Circle(at.circle.u_px + 10, at.circle.v_px, at.circle.radius_px)
    pulls = [track.updated(off, t_ns, visible).u.x - at.circle.u_px for visible in (1.0, 0.5, 0.0, None)]
    assert 10 > pulls[0] > pulls[1] > pulls[2] > 0
    assert pulls[3] == pulls[0]


def test_it_is_confirmed_by_the_third_measurement() -> None:
    assert [steady(frames=n).confirmed for n in (1, 2, 3, 4)] == [False, False, True, True]


@pytest.mark.parametrize(
    "circle",
    [
        Circle(math.nan, 0.0, 1.0),
        Circle(0.0, math.inf, 1.0),
        Circle(0.0, 0.0, math.nan),
        Circle(0.0, 0.0, 0.0),
        Circle(0.0, 0.0, -4.0),
        Circle(2e6, 0.0, 1.0),
    ],
)
def test_no_track_begins_with_what_is_no_circle(circle: Circle) -> None:
    assert Track.started(circle, 0) is None


NUMBERS = st.one_of(st.floats(), st.floats(-2000, 2000), st.floats(0.1, 300))
CIRCLES = st.builds(Circle, NUMBERS, NUMBERS, st.one_of(st.floats(), st.floats(0.1, 500)))
TIMES = st.one_of(
    st.integers(-(2**70), 2**70), st.integers(-3 * S, 3 * S), st.integers(0, 40).map(lambda n: n * 33 * MS)
)


@pytest.mark.one_interpreter
@given(st.lists(st.tuples(TIMES, CIRCLES, st.none() | st.floats()), max_size=25), TIMES)
def test_no_input_gives_nonsense(story: list[tuple[int, Circle, float | None]], asked_ns: int) -> None:
    track: Track | None = None
    for t_ns, circle, visible in story:
        if track is None:
            track = Track.started(circle, t_ns)
            continue
        track = track.updated(circle, t_ns, None if visible is None or math.isnan(visible) else visible)
        for axis in (track.u, track.v, track.r):
            assert all(map(math.isfinite, (axis.x, axis.w, axis.xx, axis.xw, axis.ww)))
            assert axis.xx > 0
            assert axis.ww >= 0
            assert axis.xw**2 <= axis.xx * axis.ww * (1 + 1e-6) + 1e-6
        at = track.at(asked_ns)
        if at is not None:
            assert tracking.usable(at.circle)
            assert 0 < at.sd_centre_px < math.inf
            assert 0 < at.sd_radius_px < math.inf
            assert at.reach_px > 0
            assert at.largest_px > at.circle.radius_px
