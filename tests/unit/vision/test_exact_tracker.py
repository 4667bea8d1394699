"""The tracked search against the plain pipeline, frame by frame: what it promises, and no silent error beyond."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway.vision.detect import registry
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.paper.exact.kernel import Kernel, load
from gateway.vision.detect.paper.exact.tracker import ROUND, ExactTracker
from gateway.vision.pixels import Image
from gateway.vision.track.follower import Follower
from tests.vision_frames import PAPER, Colour, Things
from tests.vision_promise import FRAME_NS, check_promise, comparable, searched_in_full

pytestmark = pytest.mark.one_interpreter

WIDTH, HEIGHT = 320, 240
RED: Colour = (40, 35, 190)


@pytest.fixture
def tracker(kernel: Kernel) -> ExactTracker:
    return ExactTracker(PAPER, kernel=kernel)


def picture(*discs: tuple[float, float, float], size: tuple[int, int] = (WIDTH, HEIGHT)) -> Image:
    image = np.full((size[1], size[0], 3), 120, np.uint8)
    for u, v, radius in discs:
        cv2.circle(image, (round(u), round(v)), round(radius), RED, -1)
    return image


def follow(tracker: ExactTracker, images: Iterator[Image] | list[Image]) -> tuple[list[bool], list[bool]]:
    """For each frame: was the answer the plain pipeline's, and was the full frame searched for it?"""
    same, full = [], []
    plain: dict[int, tuple[Image, object]] = {}  # by identity, with the image, so that it keeps its own
    for n, image in enumerate(images):
        found = tracker(image, n * FRAME_NS)
        if id(image) not in plain:
            plain[id(image)] = image, comparable(pipeline.detect(image, PAPER))
        same.append(comparable(found) == plain[id(image)][1])
        full.append(searched_in_full(found))
    return same, full


def test_a_marker_that_moves_and_grows_is_followed_in_the_window(tracker: ExactTracker) -> None:
    same, full = follow(tracker, [picture((60 + 6 * n, 70 + 4 * n, 14 + n / 2)) for n in range(30)])
    assert all(same)
    assert full[0]
    assert sum(full) <= 3  # the second frame may come as a surprise, no later one


def test_a_jump_a_loss_and_a_return_are_seen_in_their_own_frame(tracker: ExactTracker) -> None:
    here, there = picture((80, 80, 20)), picture((250, 180, 20))
    same, full = follow(tracker, [here, here, there, there, picture(), picture(), here, here])
    assert all(same)
    assert full == [True, False, True, False, True, True, True, False]


def test_a_marker_that_leaves_the_picture_is_exact_to_the_last_pixel(tracker: ExactTracker) -> None:
    same, full = follow(tracker, [picture((270 + 4 * n, 120, 24)) for n in range(30)])
    assert all(same)
    assert sum(full[:12]) <= 3


@pytest.mark.parametrize("when", range(ROUND))
@pytest.mark.parametrize("where", [(40, 40), (40, 200), (280, 20), (290, 215), (160, 30)])
def test_a_larger_blob_is_noticed_within_a_round(tracker: ExactTracker, when: int, where: tuple[int, int]) -> None:
    """Whenever it comes, and wherever: the answer is never wrong for ROUND frames or more."""
    small = (160, 120, 15)
    before = [picture(small)] * (ROUND + when)
    after = [picture(small, (*where, 22))] * (2 * ROUND)
    same, full = follow(tracker, before + after)
    assert all(same[: len(before)])
    assert all(same[len(before) + ROUND - 1 :])
    assert any(full[len(before) : len(before) + ROUND])


def test_known_red_things_cost_nothing(tracker: ExactTracker) -> None:
    known = [(30, 30, 9), (280, 40, 8), (50, 200, 10), (270, 200, 9)]
    same, full = follow(tracker, [picture((160 + n, 120, 25), *known) for n in range(40)])
    assert all(same)
    assert sum(full) <= 2


def test_a_known_red_thing_that_grows_is_noticed(tracker: ExactTracker) -> None:
    frames = [picture((160, 120, 20), (50, 60, 10 + n / 4)) for n in range(60)]
    same, _ = follow(tracker, frames)
    assert all(same[-ROUND:])
    assert longest_error(same) < ROUND


def test_a_rival_as_large_as_the_marker_is_looked_at_every_round(tracker: ExactTracker) -> None:
    """A red frame of a thing with a box larger than the marker: its zone could hide anything."""
    image = picture((160, 120, 20))
    cv2.line(image, (20, 20), (90, 200), RED, 7)
    same, full = follow(tracker, [image] * (4 * ROUND))
    assert all(same)
    assert [n for n, was in enumerate(full) if was] == [0, ROUND, 2 * ROUND, 3 * ROUND]


def test_two_markers_that_come_together_and_part(tracker: ExactTracker) -> None:
    apart = [abs(n - 30) * 3 for n in range(60)]
    same, _ = follow(tracker, [picture((160 - d, 120, 20), (160 + d, 120, 18)) for d in apart])
    assert all(same)


def test_a_component_that_the_window_cuts_is_not_used(tracker: ExactTracker) -> None:
    """A long bar sweeps over the marker: while they touch, they are one component that no window holds."""
    frames = []
    for n in range(40):
        image = picture((160, 120, 20))
        cv2.rectangle(image, (0, 6 * n), (319, 6 * n + 6), RED, -1)
        frames.append(image)
    same, _ = follow(tracker, frames)
    assert longest_error(same) < ROUND
    touching = range(16, 24)
    assert all(same[n] for n in touching)


def test_frames_of_another_size_begin_anew(tracker: ExactTracker) -> None:
    frames = [picture((60, 60, 20)), picture((60, 60, 20), size=(640, 480)), picture((60, 60, 20), size=(100, 90))]
    same, full = follow(tracker, frames)
    assert all(same)
    assert all(full)


@pytest.mark.parametrize("times_ns", [[0, 0, 0, 0, 0], [0, 10**9, 5, 2 * 10**9, -(10**12)], [10**18, 3, 2, 1, 0]])
def test_wild_times_spoil_nothing(tracker: ExactTracker, times_ns: list[int]) -> None:
    for n, t_ns in enumerate(times_ns):
        image = picture((60 + 20 * n, 90, 20))
        assert comparable(tracker(image, t_ns)) == comparable(pipeline.detect(image, PAPER))


def longest_error(same: list[bool]) -> int:
    longest = run = 0
    for right in same:
        run = 0 if right else run + 1
        longest = max(longest, run)
    return longest


@pytest.mark.long
def test_wild_sequences_stay_within_the_promise(kernel: Kernel) -> None:
    errors = full = 0
    for seed in range(20):
        tracker = ExactTracker(PAPER, kernel=kernel)
        more = check_promise(tracker, Things(np.random.default_rng([6, seed])), 50)
        errors, full = errors + more[0], full + more[1]
    assert 0 < errors < 100  # the promise is put to the test, and the window does most of the work
    assert full < 600


def test_the_gates_hold_in_the_window_too(library: Path) -> None:
    params = PAPER.model_copy(update={"min_circularity": 0.7})
    kernel = load(params, library)
    assert kernel is not None
    tracker = ExactTracker(params, kernel=kernel)
    for n in range(12):
        image = picture((150 + n, 120, 20))
        cv2.rectangle(image, (20, 150), (280, 160), RED, -1)  # larger, but not round
        found = tracker(image, n * FRAME_NS)
        assert comparable(found) == comparable(pipeline.detect(image, params))
        assert found.circle is not None
        assert found.circle.radius_px < 25


@pytest.mark.parametrize("compiled", [True, False])
def test_vision_method_paper_is_these(compiled: bool, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "gateway.vision.detect.paper.exact.tracker.compiled.load",
        lambda params: load(params, library) if compiled else None,
    )
    image = picture((150, 120, 20))
    for tracking in (False, True):
        detect = registry.detector(PAPER.model_copy(update={"tracking": tracking}))
        assert isinstance(detect, Follower) == tracking
        found = [detect(image, n * FRAME_NS) for n in range(2)]
        assert {detection.circle for detection in found} == {pipeline.detect(image, PAPER).circle}
        first = next(name for name, _ in found[1].stage_ns)
        assert first == (("window" if tracking else "scan") if compiled else "gaussian")
