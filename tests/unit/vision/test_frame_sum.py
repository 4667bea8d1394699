"""Frames summed behind thick dust: what that shows, that nothing else is shown, and how old it is."""

import math
import pkgutil
import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from itertools import count, islice
from typing import Any

import numpy as np
import pytest

from gateway.config import CameraConfig, FusionConfig, VisionConfig
from gateway.core import fusion
from gateway.core.detection import Circle, Detection, Ellipse, Tracking
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Tick
from gateway.sim.weather import AIRLIGHT
from gateway.vision.detect import registry, robust
from gateway.vision.detect.method import Summing, TimedPicture
from gateway.vision.detect.robust import frame_sum
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.frame_sum import SummingSearch, mean_of, suitable
from gateway.vision.detect.robust.standing import stood_still
from gateway.vision.pixels import Image, grey_levels
from gateway.vision.process.monitor import Emit, ProcessMonitor, Start
from gateway.vision.process.vision_process import CheckedFrame, RecentFrames, detected
from gateway.vision.source.freshness import TILES
from gateway.vision.transport.messages import FrameResult
from tests import decoys, fused

pytestmark = pytest.mark.one_interpreter

PARAMS = VisionConfig(tracking=True, sum_frames=4)
PLACE = Circle(160.3, 119.8, 30.0)
RIM = Ellipse(160.3, 119.8, 30.0, 30.0, 0.0)
VEIL = 0.98
MS = 1_000_000
PERIOD_NS = 33 * MS
Move = Callable[[int], Circle | None]


@lru_cache(maxsize=64)
def clear(place: Circle | None, colour: str = "red", covered: float = 0.0) -> Image:
    """`covered`: share of the disc's height from above that something grey hides."""
    sheet = decoys.sheet(320, 240, "concrete", 3)
    if place is not None:
        sheet.disc(place.u_px, place.v_px, place.radius_px)
    image = sheet.finished(noise=0)
    if colour == "blue":
        image = np.ascontiguousarray(image[..., ::-1])
    if covered and place is not None:
        top = round(place.v_px - place.radius_px)
        image[top - 4 : top + round(2 * covered * place.radius_px), 100:220] = 120
    return image


def noisy(image: Image, seed: int, veil: float) -> Image:
    noise = np.random.default_rng([seed, 5]).standard_normal(image.shape, dtype=np.float32)
    return np.clip(np.rint(image * (1 - veil) + np.array(AIRLIGHT) * veil + 2 * noise), 0, 255).astype(np.uint8)


@lru_cache(maxsize=1)
def seeds() -> tuple[int, ...]:
    """Ten with none of which one frame shows the disc at PLACE."""
    hidden = (seed for seed in count(1) if detect(noisy(clear(PLACE), seed, VEIL), PARAMS).circle is None)
    return tuple(islice(hidden, 10))


def dusty(image: Image, number: int, veil: float = VEIL) -> Image:
    return noisy(image, seeds()[number % 10] + 100 * (number // 10), veil)


def timed(images: Sequence[Image], period_ns: int = PERIOD_NS) -> list[TimedPicture]:
    return [TimedPicture(image, period_ns * (n + 1)) for n, image in enumerate(images)]


def in_sum(images: Sequence[Image], period_ns: int = PERIOD_NS) -> Detection:
    """What is reported of the last of them."""
    frames = timed(images, period_ns)
    search = frame_sum.search(PARAMS, lambda: 0)
    search.recent(frames)
    return search(frames[-1].picture, frames[-1].t_ns, None)


STANDING = [dusty(clear(PLACE), n) for n in range(4)]


class Nothing:
    """A search that never finds anything."""

    calls = 0

    def __call__(self, *_: Any) -> Detection:
        self.calls += 1
        return Detection(None)


def test_the_sum_shows_what_no_frame_does() -> None:
    for image in STANDING:
        assert in_sum([image]).circle is None
    found = in_sum(STANDING)
    assert found.frames == 4
    assert found.circle is not None
    assert (found.circle.u_px, found.circle.v_px) == pytest.approx((PLACE.u_px, PLACE.v_px), abs=0.25)
    assert found.circle.radius_px == pytest.approx(PLACE.radius_px, abs=0.3)


def test_one_frame_that_shows_the_marker_is_not_summed() -> None:
    found = in_sum([dusty(clear(PLACE), n, 0.9) for n in range(4)])
    assert found.circle is not None
    assert found.frames == 1


def test_clear_air_is_not_summed() -> None:
    nothing = Nothing()
    search = SummingSearch(nothing, 4)  # type: ignore[arg-type]
    frames = timed([clear(None)] * 4)
    search.recent(frames)
    assert search(frames[-1].picture, frames[-1].t_ns, None) == Detection(None)
    assert nothing.calls == 1
    assert search.keeps(frames[-1].t_ns) == 1


def moved(du: float, dv: float, dr: float = 0.0) -> Move:
    return lambda n: Circle(PLACE.u_px + du * (n - 1.5), PLACE.v_px + dv * (n - 1.5), PLACE.radius_px + dr * (n - 1.5))


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    "move",
    [
        moved(3, 0),
        moved(-3, 0),
        moved(0, 3),
        moved(2.2, -2.2),
        moved(1, 0),
        moved(0, 0, 2),
        moved(0, 0, -1),
        moved(12, 0),
    ],
)
def test_a_marker_that_moves_is_not_in_the_sum(move: Move) -> None:
    images = [dusty(clear(move(n)), n) for n in range(4)]
    found = in_sum(images)
    assert found.frames == 1
    if found.circle is not None:  # by the newest frame alone
        now = move(3)
        assert now is not None
        assert math.hypot(found.circle.u_px - now.u_px, found.circle.v_px - now.v_px) < 1


def test_without_the_check_one_that_moves_would_be_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """3 px a frame, where neither frame alone shows it: so the test above tests the check."""
    monkeypatch.setattr(frame_sum, "stood_still", lambda *_: True)
    images = [dusty(clear(moved(3, 0)(n)), n) for n in range(4)]
    found = in_sum(images)
    assert found.circle is not None
    assert found.frames == 4


CHANGES: dict[str, Callable[[int], Image]] = {
    "covered in the newest": lambda n: clear(PLACE if n < 3 else None),
    "covered in the newer two": lambda n: clear(PLACE if n < 2 else None),
    "covered but for the newest": lambda n: clear(PLACE if n == 3 else None),
    "covered in one between": lambda n: clear(None if n == 1 else PLACE),
    "half of it covered in the newest": lambda n: clear(PLACE, covered=0.5 if n == 3 else 0.0),
    "a quarter of it covered in one between": lambda n: clear(PLACE, covered=0.25 if n == 1 else 0.0),
    "covered little by little": lambda n: clear(PLACE, covered=0.2 * n),
    "a smaller one in its place": lambda n: clear(PLACE if n < 2 else replace(PLACE, radius_px=22.0)),
    "a larger one in its place": lambda n: clear(PLACE if n < 3 else replace(PLACE, radius_px=42.0)),
    "one beside it in its place": lambda n: clear(PLACE if n < 2 else replace(PLACE, u_px=200.0)),
    "another colour in its place": lambda n: clear(PLACE, colour="red" if n < 3 else "blue"),
}


@pytest.mark.mostly_long(short=3)
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("veil", [0.95, VEIL])
def test_what_changed_within_the_frames_did_not_stand(change: str, veil: float) -> None:
    """Judged by itself, too: whatever the search makes of such a mean."""
    images = [dusty(CHANGES[change](n), n, veil) for n in range(4)]
    assert not stood_still(images, mean_of(images), RIM)
    if veil == VEIL:
        found = in_sum(images)
        assert found.circle is None or found.frames == 1


@pytest.mark.long
def test_what_stands_is_seen_to_stand() -> None:
    """In 150 windows, a fiftieth of which may be taken for moved by their noise."""
    seen = 0
    for seed in range(50):
        for veil in (0.9, 0.96, VEIL):
            images = [dusty(clear(PLACE), 4 * seed + n, veil) for n in range(4)]
            seen += stood_still(images, mean_of(images), RIM)
    assert seen >= 147


def test_too_much_noise_tells_nothing() -> None:
    images = [dusty(clear(PLACE), n, 0.998) for n in range(4)]
    assert not stood_still(images, mean_of(images), RIM)
    assert stood_still(STANDING, mean_of(STANDING), RIM)
    assert not stood_still(STANDING, mean_of(STANDING), replace(RIM, u_px=-80.0))
    assert not stood_still(STANDING, mean_of(STANDING), replace(RIM, semi_major_px=3.0, semi_minor_px=3.0))


def test_another_exposure_ends_the_sum() -> None:
    brighter = np.clip(np.rint(STANDING[3] * 1.1), 0, 255).astype(np.uint8)
    assert in_sum(STANDING).frames == 4
    assert in_sum([*STANDING[:3], brighter]).frames == 1
    assert in_sum([*STANDING[:2], brighter, STANDING[3]]).circle is None


# Which frames.


@pytest.mark.parametrize(
    ("fps", "most", "frames"),
    [(30, 4, 4), (30, 8, 4), (25, 8, 4), (60, 8, 8), (60, 4, 4), (10, 4, 2), (9, 4, 2), (8, 4, 1)],
)
def test_so_many_frames_are_fresh_enough(fps: int, most: int, frames: int) -> None:
    recent = [TimedPicture(STANDING[0], round(n * 1e9 / fps)) for n in range(10)]
    assert len(suitable(recent[-most:])) == frames


def test_a_gap_ends_the_sum() -> None:
    at = [0, 33, 66, 99]
    pictures = [TimedPicture(STANDING[0], MS * t) for t in at]
    assert len(suitable(pictures)) == 4
    for times, left in (
        ([0, 10, 20, 70], 2),
        ([0, 50, 60, 70], 3),
        ([0, 33, 33, 66], 2),
        ([0, 66, 33, 99], 2),
        ([0, 33, 99, 66], 1),
        ([0, 35, 66, 99], 4),
    ):
        frames = [replace_t(one, MS * t) for one, t in zip(pictures, times, strict=True)]
        kept = suitable(frames)
        assert len(kept) == left, times
        assert kept[-1] is frames[-1]
    other = TimedPicture(STANDING[0][:100], 33 * MS)
    assert len(suitable([pictures[0], other, *pictures[2:]])) == 2
    deep = TimedPicture(STANDING[0].astype(np.uint16), 33 * MS)
    assert len(suitable([pictures[0], deep, *pictures[2:]])) == 2
    assert list(suitable([])) == []


def replace_t(frame: TimedPicture, t_ns: int) -> TimedPicture:
    return TimedPicture(frame.picture, t_ns)


def test_frames_of_another_moment_are_not_summed() -> None:
    search = frame_sum.search(PARAMS, lambda: 0)
    search.recent(timed(STANDING))
    assert search(STANDING[-1], 10_000 * MS, None).circle is None
    assert search(STANDING[-1], 4 * PERIOD_NS, None).circle is None  # they are used once


def test_a_bay_without_marker_costs_one_sum_in_an_eighth_of_a_second() -> None:
    nothing = Nothing()
    search = SummingSearch(nothing, 4)  # type: ignore[arg-type]
    frames = timed([dusty(clear(None), n) for n in range(4)] * 15)
    for n, frame in enumerate(frames):
        search.recent(frames[max(0, n - 3) : n + 1])
        search(frame.picture, frame.t_ns, None)
        assert search.keeps(frame.t_ns) == 4
    assert nothing.calls - len(frames) == pytest.approx(60 * 33 / 132, abs=2)
    assert search.keeps(frames[-1].t_ns + 2001 * MS) == 1


def test_one_frame_is_enough_where_it_is_switched_off() -> None:
    search = frame_sum.search(VisionConfig(), lambda: 0)
    frames = timed(STANDING)
    search.recent(frames)
    assert search(frames[-1].picture, frames[-1].t_ns, None).circle is None
    assert search.keeps(frames[-1].t_ns) == 1


def test_deep_frames_are_summed_with_all_their_bits() -> None:
    """Half a grey level below: in 8 bits it is in none of the frames."""
    of16 = [np.asarray(257 * image.astype(np.int32) - 120, np.uint16) for image in STANDING]
    mean = frame_sum.mean_of([grey_levels(image) for image in of16])
    assert np.abs(mean - (frame_sum.mean_of(STANDING) - np.float32(120 / 257))).max() < 1e-3
    assert in_sum(of16).circle is not None  # type: ignore[arg-type]


# Through the follower, as the vision process does it.


def checked(frames: Sequence[Image], first_ns: int = PERIOD_NS) -> list[CheckedFrame]:
    times = [first_ns + PERIOD_NS * n for n in range(len(frames))]
    return [
        CheckedFrame(image, n + 1, t_ns, np.full(TILES, t_ns, np.int64), image)
        for n, (image, t_ns) in enumerate(zip(frames, times, strict=True))
    ]


def followed(frames: Sequence[CheckedFrame]) -> list[tuple[Detection, int]]:
    detect, recent, found = registry.detector(PARAMS), RecentFrames(), []
    assert isinstance(detect, Summing)
    for frame in frames:
        recent.add(frame)
        found.append(detected(detect, detect, frame, recent))
    return found


@pytest.mark.long
def test_a_sum_is_as_old_as_its_oldest_frame() -> None:
    frames = checked([dusty(clear(PLACE), n) for n in range(10)])
    results = followed(frames)
    summed = [(n, found, since_ns) for n, (found, since_ns) in enumerate(results) if found.frames > 1]
    assert len(summed) >= 2
    for n, found, since_ns in summed:
        assert found.tracking is Tracking.MEASURED
        assert since_ns == frames[n - found.frames + 1].t_capture_ns
        assert frames[n].t_capture_ns - since_ns <= frame_sum.SPAN_NS
    for (found, since_ns), frame in zip(results, frames, strict=True):
        if found.frames == 1:
            assert since_ns == frame.t_capture_ns


def test_a_part_of_a_sum_that_repeats_itself_is_older_still() -> None:
    frames = checked(STANDING)
    frames[0] = replace(frames[0], changed_ns=np.full(TILES, 7, np.int64))
    detect, recent = registry.detector(PARAMS), RecentFrames()
    assert isinstance(detect, Summing)
    recent.keep(4)
    for frame in frames:
        recent.add(frame)
    found, since_ns = detected(detect, detect, frames[-1], recent)
    assert (found.frames, since_ns) == (4, 7)


@pytest.mark.long
def test_a_marker_that_drives_through_thick_dust_is_in_no_sum() -> None:
    """3 px a frame across the picture; single frames may show it, a sum never does."""
    places = [Circle(90.3 + 3 * n, 119.8, 30.0) for n in range(16)]
    results = followed(checked([dusty(clear(place), n) for n, place in enumerate(places)]))
    assert [found.frames for found, _ in results] == [1] * 16


@pytest.mark.long
def test_a_marker_that_is_covered_ends_with_the_frame_that_covers_it() -> None:
    """In the sums it would be for three frames more."""
    images = [dusty(clear(PLACE), n) for n in range(10)] + [dusty(clear(None), n) for n in range(10, 20)]
    results = followed(checked(images))
    assert sum(found.circle is not None for found, _ in results[4:10]) >= 3
    assert all(found.circle is None for found, _ in results[10:])


def test_the_frames_kept_are_those_before_the_one_at_hand() -> None:
    recent, frames = RecentFrames(), checked(STANDING)
    for frame in frames:
        recent.add(frame)
    assert [f.seq for f in recent.until(frames[3])] == [4]
    recent.keep(3)
    for frame in frames:
        recent.add(frame)
    assert [f.seq for f in recent.until(frames[3])] == [2, 3, 4]
    assert [f.seq for f in recent.until(frames[2])] == [2, 3]
    recent.keep(1)
    assert [f.seq for f in recent.until(frames[3])] == [4]


# In the main process.


def readings_of(result: FrameResult, now_ns: int) -> list[VisionReading]:
    monitor = ProcessMonitor("camera", CameraConfig(), PARAMS, random.Random(1))
    token = next(a.token for a in monitor.settle(0) if isinstance(a, Start))
    monitor.ready(token, 1)
    monitor.opened(token, 2, lossless=False, finite=False)
    monitor.result(token, result, now_ns)
    return [a.reading for a in monitor.settle(now_ns) if isinstance(a, Emit)]


def test_the_reading_says_how_many_frames_and_is_as_old_as_the_first() -> None:
    found = Detection(PLACE, frames=4, tracking=Tracking.MEASURED)
    (reading,) = readings_of(FrameResult(1, 200 * MS, found, 101 * MS), 260 * MS)
    assert (reading.t_ns, reading.frames, reading.quality) == (101 * MS, 4, Quality.GOOD)


def test_an_old_sum_neither_follows_a_newer_frame_nor_outlives_its_oldest() -> None:
    config = FusionConfig(recovery_s=0, clear_hold_s=0)
    z = RangeReading(1_000 * MS, Quality.GOOD, 900.0)
    state = fused.step(fusion.initial("1", 0), z, 1_000 * MS, config)
    blind = VisionReading(1_000 * MS, Quality.NO_TARGET)
    summed = VisionReading(950 * MS, Quality.GOOD, PLACE, frames=4)

    after = fused.step(fused.step(state, blind, 1_050 * MS, config), summed, 1_060 * MS, config)
    assert after.vision.quality is Quality.NO_TARGET

    state = fused.step(state, summed, 1_060 * MS, config)
    assert (state.vision.quality, state.vision.frames) == (Quality.GOOD, 4)
    assert fused.step(state, Tick(), 1_250 * MS, config).vision.circle == PLACE
    late = fused.step(state, Tick(), 1_251 * MS, config).vision  # 301 ms after its oldest frame
    assert (late.quality, late.circle, late.frames) == (Quality.STALE, None, 1)


def test_the_age_of_a_sum_leaves_time_for_the_next() -> None:
    """The oldest frame, a search of 50 ms for one frame and one for the sum, and the frames until the next result."""
    deadline_ns = FusionConfig().vision_deadline_s * 1e9
    for fps, frames in ((30, 4), (10, 2)):
        period_ns = 1e9 / fps
        work_ns = 100 * MS
        next_ns = math.ceil(work_ns / period_ns) * period_ns
        assert (frames - 1) * period_ns <= frame_sum.SPAN_NS
        assert (frames - 1) * period_ns + next_ns + work_ns <= deadline_ns + 50 * MS


def test_every_kernel_is_loaded_before_the_first_frame() -> None:
    """Comparing them with their references takes longer than `fusion.vision_deadline_s`: the first result was stale."""
    modules = [import_module(f"{robust.__name__}.{found.name}") for found in pkgutil.iter_modules(robust.__path__)]
    kernels = [module.compiled_kernel for module in modules if hasattr(module, "compiled_kernel")]
    for kernel in kernels:
        kernel.cache_clear()
    frame_sum.search(VisionConfig(), lambda: 0)
    assert [kernel.cache_info().currsize for kernel in kernels] == [1] * len(kernels)
