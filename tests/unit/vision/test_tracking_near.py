"""The tracked robust search on drawn and rendered sequences: the full search's answers, mostly out of windows."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection, Rejection, Tracking
from gateway.sim.render import Painter
from gateway.sim.scenario import parse
from gateway.sim.world import World
from gateway.vision.detect import registry
from gateway.vision.detect.geometry import distance_px, same_place
from gateway.vision.detect.robust import roi_search
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.roi_search import CHECK, FAINT, FULL, RoiSearch, window_round
from gateway.vision.pixels import Image
from gateway.vision.track.kalman_filter import Prediction
from tests.discs import circle_of, cover, rounded, track_of

pytestmark = pytest.mark.one_interpreter

PERIOD_NS = 33_000_000
FOLLOWED = VisionConfig(method="robust", tracking=True)
SAME_PX = 0.2  # between the window's and the full search's circle: both are refined from their own first guess


Paint = tuple[float, float, float]
RED: Paint = (44.0, 38.0, 178.0)


def picture(*circles: Circle, size: tuple[int, int] = (240, 320), seed: int = 0, paints: Sequence[Paint] = ()) -> Image:
    """Red discs, anti-aliased, on rough concrete, with the sensor's noise. `paints`: of the first discs."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : size[0], 0 : size[1]]
    plane: NDArray[np.float64] = np.full((*size, 3), (118.0, 121.0, 119.0))
    plane += 8 * np.sin(x / 31 + y / 17)[..., None]
    for n, circle in enumerate(circles):
        paint = np.array(paints[n] if n < len(paints) else RED)
        plane += cover(circle.u_px, circle.v_px, circle.radius_px, size) * (paint - plane)
    blurred = cv2.GaussianBlur(plane, (0, 0), 0.7) + rng.normal(0, 1.5, plane.shape)
    return rounded(blurred)


def approach(n: int) -> Circle:
    return Circle(120.3 + 1.5 * n + 1.2 * math.sin(2.1 * n), 110.2 + 1.1 * math.cos(1.3 * n), 24.0 + 0.6 * n)


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Fills with `window` and `full`, one for every search."""
    kinds: list[str] = []

    def watched(image: Image, *args: Any, window: Any = None, **more: Any) -> Detection:
        kinds.append("full" if window is None else "window")
        return detect(image, *args, window=window, **more)

    monkeypatch.setattr(roi_search, "detect", watched)
    return kinds


def detections(frames: Iterator[tuple[int, Image]]) -> list[Detection]:
    find = registry.detector(FOLLOWED)
    return [find(image, t_ns) for t_ns, image in frames]


def steadily(scene: Callable[[int], Image], count: int) -> Iterator[tuple[int, Image]]:
    return ((n * PERIOD_NS, scene(n)) for n in range(count))


@pytest.mark.long
def test_every_answer_is_the_full_searchs_and_most_are_from_a_window(searched: list[str]) -> None:
    images = [picture(approach(n), seed=n) for n in range(CHECK * 3)]
    found = detections((n * PERIOD_NS, image) for n, image in enumerate(images))
    assert searched.count("full") == 1
    assert searched.count("window") == len(images) - 1
    for n, (one, image) in enumerate(zip(found, images, strict=True)):
        assert one.tracking is Tracking.MEASURED
        assert asdict(circle_of(one)) == pytest.approx(asdict(circle_of(detect(image, FOLLOWED))), abs=SAME_PX)
        assert asdict(circle_of(one)) == pytest.approx(asdict(approach(n)), abs=0.3)


@pytest.mark.parametrize("clutter", [True, False])
def test_the_full_frame_is_searched_in_its_turn_where_it_holds_anything_red(
    monkeypatch: pytest.MonkeyPatch, clutter: bool
) -> None:
    kinds: list[str] = []

    def stand_in(image: Image, *args: Any, window: Any = None, **more: Any) -> Detection:
        kinds.append("full" if window is None else "window")
        return Detection(Circle(100.0, 100.0, 30.0))

    monkeypatch.setattr(roi_search, "detect", stand_in)
    find = registry.detector(FOLLOWED)
    image = picture(Circle(100.0, 100.0, 30.0), *[Circle(250.0, 150.0, 15.0)] * clutter)
    for n in range(2 * FULL + 2):
        find(image, n * PERIOD_NS)
    full = [n for n, kind in enumerate(kinds) if kind == "full"]
    assert full == ([0, FULL + 1, 2 * FULL + 2] if clutter else [0])


@pytest.mark.parametrize(
    ("circle", "confidence", "why", "wins"),
    [
        (None, None, None, False),  # overlooked: the window's passed the same gates
        (Circle(250.0, 60.0, 30.0), 0.5, None, False),  # less evidence
        (Circle(250.0, 60.0, 30.0), 0.9, None, True),
        (Circle(250.0, 60.0, 90.0), 0.6, None, True),  # larger
        (Circle(250.0, 60.0, 40.0), 0.6, "weaker", False),  # the window's was found: of two of about one size it stays
        (Circle(250.0, 60.0, 50.0), 0.6, "weaker", True),  # much larger
        (Circle(250.0, 60.0, 30.0), 0.6, "rim", False),  # the window's was found, but not as a disc
        (Circle(101.0, 100.0, 31.0), 0.1, None, True),  # the same thing: as the full search measures it
    ],
)
def test_where_window_and_full_frame_disagree_the_one_with_more_evidence_is_used(
    monkeypatch: pytest.MonkeyPatch, circle: Circle | None, confidence: float | None, why: str | None, wins: bool
) -> None:
    rejected = () if why is None else (Rejection(Circle(101.0, 99.0, 30.0), why),)
    rival = Detection(circle, confidence=confidence, rejected=rejected)
    held = Detection(Circle(100.0, 100.0, 30.0), confidence=0.7)
    monkeypatch.setattr(roi_search, "detect", lambda *_, window=None, **__: held if window is not None else rival)
    search = RoiSearch(FOLLOWED, lambda: 0)
    track = track_of(Circle(100.0, 100.0, 30.0))
    found = [search(np.zeros((480, 640, 3), np.uint8), 1, track.at(1)) for _ in range(CHECK)]  # nothing was found yet
    assert found[0].circle == held.circle
    assert found[CHECK - 1].circle == (rival.circle if wins else held.circle)


@pytest.mark.mostly_long
@pytest.mark.parametrize("hidden", [1, 4, 9, 25])
def test_a_marker_that_reappears_is_measured_in_its_first_frame(hidden: int) -> None:
    def scene(n: int) -> Image:
        return picture(approach(n), seed=n) if not 8 <= n < 8 + hidden else picture(seed=n)

    found = detections(steadily(scene, 12 + hidden))
    labels = [one.tracking for one in found]
    coasted = min(hidden, 9)  # 0.3 s
    assert labels == (
        [Tracking.MEASURED] * 8
        + [Tracking.COASTED] * coasted
        + [Tracking.LOST] * (hidden - coasted)
        + [Tracking.MEASURED] * 4
    )
    for n, one in enumerate(found):
        assert (one.circle is None) == (one.tracking is not Tracking.MEASURED)
        if one.predicted is not None:
            assert distance_px(one.predicted, approach(n)) < 8


@pytest.mark.mostly_long
@pytest.mark.parametrize("covered", [1, 2, 15])
def test_a_lamp_is_not_taken_for_a_marker_that_is_covered_for_a_moment(covered: int) -> None:
    lamp = Circle(270.0, 200.0, 14.0)

    def scene(n: int) -> Image:
        return picture(*([] if 8 <= n < 8 + covered else [approach(n)]), lamp, seed=n)

    for n, one in enumerate(detections(steadily(scene, 12 + covered))):
        if 8 <= n < 8 + covered or (n < 10 + covered and one.circle is None and covered > 9):
            assert one.circle is None
            assert one.tracking is (Tracking.COASTED if n < 17 else Tracking.LOST)
            assert same_place(one.rejected[0].circle, lamp if n < 8 + covered else approach(n))
        else:
            assert same_place(circle_of(one), approach(n))


def test_gaps_and_a_wild_frame_rate_lose_nothing() -> None:
    rng = np.random.default_rng(4)
    t_s, frames, truths = 0.0, [], []
    for n in range(20):
        t_s += float(rng.choice([0.005, 0.02, 0.033, 0.1, 0.4, 1.5]))
        truths.append(Circle(60 + 20 * t_s, 120.0, 25 + t_s))
        frames.append((round(t_s * 1e9), picture(truths[-1], seed=n)))
    for one, truth in zip(detections(iter(frames)), truths, strict=True):
        assert one.tracking is Tracking.MEASURED
        assert distance_px(circle_of(one), truth) < 0.3


def test_a_machine_too_slow_for_full_frames_still_searches_windows(searched: list[str]) -> None:
    """One frame in half a second, and no velocity known: the marker is searched for where it was first."""
    frames = ((n * 500_000_000, picture(Circle(100 + 3 * n, 120.0, 30.0), seed=n)) for n in range(6))
    assert [one.tracking for one in detections(frames)] == [Tracking.MEASURED] * 6
    assert searched == ["full"] + ["window"] * 5


def test_after_a_long_gap_a_new_red_thing_is_found_at_once(searched: list[str]) -> None:
    lamp, marker = Circle(60.0, 60.0, 12.0), Circle(220.0, 150.0, 55.0)
    frames = [(0, picture(lamp)), (33_000_000, picture(lamp, seed=1)), (2_000_000_000, picture(lamp, marker, seed=2))]
    found = detections(iter(frames))
    assert same_place(found[1].circle or marker, lamp)
    assert same_place(found[2].circle or lamp, marker)
    assert searched == ["full", "window", "window", "full"]


def test_a_track_does_not_hold_on_to_a_lamp_when_the_marker_comes(searched: list[str]) -> None:
    """A small red light is followed until the marker appears elsewhere: the full search prefers that one."""
    lamp, marker = Circle(60.0, 60.0, 12.0), Circle(220.0, 150.0, 55.0)
    assert detect(picture(lamp), FOLLOWED).circle is not None
    preferred = detect(picture(lamp, marker), FOLLOWED).circle
    assert preferred is not None
    assert same_place(preferred, marker)
    found = detections(steadily(lambda n: picture(lamp, seed=n) if n < 6 else picture(lamp, marker, seed=n), 6 + CHECK))
    assert [one.tracking for one in found].count(Tracking.MEASURED) == len(found) - 2  # while the jump is tentative
    assert same_place(found[5].circle or marker, lamp)
    assert same_place(found[-1].circle or lamp, marker)
    assert searched.count("full") == 4  # at the beginning, and when something red had come: thrice to confirm it


def test_what_the_full_search_prefers_is_followed_soon_after_it_appears() -> None:
    """Far redder than any paint: no reason to overlook a large red marker."""
    lamp, marker = Circle(50.0, 120.0, 14.0), Circle(220.0, 120.0, 66.0)
    paints = [(5.0, 4.0, 200.0), (70.0, 60.0, 190.0)]

    def scene(n: int) -> Image:
        return picture(*([lamp] if n < 6 else [lamp, marker]), paints=paints, seed=n)

    found = detections(steadily(scene, 8 + 2 * CHECK))
    assert same_place(found[5].circle or marker, lamp)
    assert [same_place(one.circle or lamp, marker) for one in found[-CHECK:]] == [True] * CHECK


def test_a_faint_marker_beside_a_very_red_lamp_is_searched_for_in_the_end(searched: list[str]) -> None:
    lamp, dusty = Circle(50.0, 120.0, 20.0), Circle(200.0, 120.0, 30.0)
    gaps = [Circle(u, v, 6.0) for u in (50.0, 125.0, 200.0, 275.0) for v in (30.0, 210.0)]  # black: the air is clear
    paints = [*[(5.0, 5.0, 5.0)] * len(gaps), (5.0, 4.0, 200.0), (125.0, 120.0, 190.0)]
    find = registry.detector(FOLLOWED)
    both = picture(*gaps, lamp, dusty, paints=paints)
    for n in range(FAINT + 5):
        found = find(picture(*gaps, lamp, paints=paints) if n < 4 else both, n * PERIOD_NS)
    assert searched.count("full") == 4  # thrice to confirm it
    assert same_place(found.circle or lamp, dusty)


def test_with_a_slow_camera_a_new_red_thing_is_found_after_the_same_time() -> None:
    lamp, marker = Circle(60.0, 60.0, 12.0), Circle(220.0, 150.0, 55.0)
    period_ns = 200_000_000
    find = registry.detector(FOLLOWED)
    seen = []
    for n in range(10):
        found = find(picture(*([lamp] if n < 5 else [lamp, marker]), seed=n), n * period_ns)
        seen.append(found.rejected[0].circle if found.circle is None else found.circle)
        assert (found.circle is None) == (n in (6, 7))  # tentative
    for n, circle in enumerate(seen):
        assert same_place(circle, lamp if n < 6 else marker)  # 0.3 s are two frames at most


def test_red_things_that_were_found_once_cost_nothing_more(searched: list[str]) -> None:
    """Clutter that stands, sways and comes nearer with the marker is nothing new."""

    def scene(n: int) -> Image:
        clutter = Circle(40.0 + 3 * math.sin(n / 3), 200.0, 14.0 + 0.2 * n), Circle(290.0 - 0.4 * n, 40.0, 9.0)
        return picture(Circle(160.0 + n, 120.0, 40.0 + 0.5 * n), *clutter, seed=n)

    for one in detections(steadily(scene, 3 * CHECK)):
        assert circle_of(one).radius_px > 35
    assert searched.count("full") == 1


@pytest.mark.long
def test_a_rendered_drive_with_vibration_is_followed_to_the_end() -> None:
    scenario = parse(
        {
            "seed": 3,
            "camera": {"width_px": 320, "height_px": 240, "focal_px": 300.0},
            "start": {"distance_cm": 90},
            "legs": [{"distance_cm": 30, "speed_cm_s": 40, "hold_s": 1}],
            "vibration": {"amplitude_mm": 2.5},
        }
    )
    world, painter = World(scenario), Painter(scenario)
    find, seen = registry.detector(FOLLOWED), 0
    for n in range(0, 80, 2):
        truth = world.truth(n / 30)
        one = find(painter.frame(truth, n), round(n / 30 * 1e9))
        assert one.tracking is Tracking.MEASURED, n
        assert math.hypot(circle_of(one).u_px - truth.u_px, circle_of(one).v_px - truth.v_px) < 1.0
        assert circle_of(one).radius_px == pytest.approx(truth.radius_px, abs=1.5)
        seen += 1
    assert seen == 40


@given(
    u=st.floats(-50, 700),
    v=st.floats(-50, 500),
    r=st.floats(0.5, 400),
    sd=st.floats(0.1, 60),
    sd_r=st.floats(0.1, 60),
    small=st.booleans(),
)
def test_a_window_holds_every_near_circle_that_would_be_admitted(
    u: float, v: float, r: float, sd: float, sd_r: float, small: bool
) -> None:
    width, height = (5, 3) if small else (640, 480)
    expected = Prediction(Circle(u, v, r), sd, sd_r)
    x0, y0, x1, y1 = window_round(expected, width, height)
    assert 0 <= x0 < x1 <= width
    assert 0 <= y0 < y1 <= height
    for turn in np.linspace(0, 2 * np.pi, 16):
        far = 0.999 * min(expected.reach_px, expected.near_px)
        at_u, at_v = u + far * math.cos(turn), v + far * math.sin(turn)
        if expected.admits(Circle(at_u, at_v, r)):
            assert x0 <= max(0, at_u - r)
            assert x1 >= min(width, at_u + r)
            assert y0 <= max(0, at_v - r)
            assert y1 >= min(height, at_v + r)


def test_times_of_both_searches_are_reported() -> None:
    ticks = iter(range(0, 10**9, 1000))
    search = RoiSearch(FOLLOWED, lambda: next(ticks))
    track = track_of(Circle(40.0, 40.0, 20.0))
    image = picture(Circle(200.0, 150.0, 30.0))
    away = search(image, PERIOD_NS, track.at(PERIOD_NS))
    assert away.circle is not None  # the window was empty
    names = [name for name, _ in away.stage_ns]
    assert names[0] == "window"
    assert names[1:] == [name for name, _ in detect(image, FOLLOWED).stage_ns]
    assert all(ns > 0 for _, ns in away.stage_ns)
