"""One picture shown for ever is not a live picture, however fresh its stamps; nor is a dead part of one."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.core.detection import Circle
from gateway.vision.pixels import Image
from gateway.vision.source.freshness import PROOFS, TILES, Freshness, FrozenFrameDetector, unchanged_since_ns

S = 1_000_000_000
MS = 1_000_000
HEIGHT, WIDTH = 120, 160
WHOLE = (slice(None), slice(None))
Area = tuple[slice, slice]


class Camera:
    """A still scene with a sensor's noise, 25 frames a second; what is stuck shows the first frame for ever."""

    def __init__(self, noise: float = 1.0, height: int = HEIGHT, width: int = WIDTH, level: float = 120.0) -> None:
        self._chance = np.random.default_rng(5)
        self._noise = noise
        self._scene = np.full((height, width, 3), level)
        self.t_ns = 0
        self.first = self._exposed()

    def _exposed(self) -> Image:
        noise = self._chance.standard_normal(self._scene.shape) * self._noise
        return np.asarray(np.clip(np.rint(self._scene + noise), 0, 255), np.uint8)

    def frame(self, *, live: tuple[Area, ...] = (WHOLE,)) -> tuple[Image, int]:
        self.t_ns += S // 25
        image, new = self.first.copy(), self._exposed()
        for area in live:
            image[area] = new[area]
        return image, self.t_ns


def watched(camera: Camera, frozen_s: float = 2.0, *, frames: int = 1 + PROOFS) -> FrozenFrameDetector:
    """After some live frames, as long as nothing is stuck."""
    detector = FrozenFrameDetector(frozen_s)
    for _ in range(frames):
        detector.judge(*camera.frame())
    return detector


def age_s(detector: FrozenFrameDetector, camera: Camera, circle: Circle | None = None) -> float:
    return (camera.t_ns - unchanged_since_ns(detector.changed_ns, WIDTH, HEIGHT, circle)) / S


MARKERS = [
    None,
    Circle(80.0, 60.0, 35.0),
    Circle(30.0, 75.0, 3.0),
    Circle(80.0, 60.0, 0.0),
    Circle(-9.0, 150.0, 4.0),
]


@pytest.mark.parametrize("noise", [0.3, 1.0, 4.0])
@pytest.mark.parametrize("circle", MARKERS)
def test_a_live_picture_is_as_new_as_its_frame_once_it_has_changed_five_times(
    noise: float, circle: Circle | None
) -> None:
    camera, detector = Camera(noise), FrozenFrameDetector(2.0)
    assert [detector.judge(*camera.frame()) for _ in range(5)] == [Freshness.UNPROVEN] * 5
    for _ in range(20):
        assert detector.judge(*camera.frame()) is Freshness.LIVE
        assert age_s(detector, camera, circle) == 0


@pytest.mark.parametrize("circle", MARKERS)
def test_a_repeated_picture_is_as_old_as_its_first_sight_and_frozen_after_its_time(circle: Circle | None) -> None:
    camera = Camera()
    detector = watched(camera)
    detector.judge(*camera.frame(live=()))  # the camera's very first picture again: new for the last time
    for n in range(1, 51):
        assert detector.judge(*camera.frame(live=())) is Freshness.LIVE
        assert age_s(detector, camera, circle) == pytest.approx(n / 25)
    assert detector.judge(*camera.frame(live=())) is Freshness.FROZEN


@pytest.mark.parametrize(
    "clock",
    [
        pytest.param((slice(2, 10), slice(2, 55)), id="a clock in a corner"),
        pytest.param((slice(0, 15), slice(None)), id="a banner across the top"),
        pytest.param((slice(100, 120), slice(None)), id="a banner across the bottom"),
    ],
)
@pytest.mark.parametrize("circle", MARKERS[:3])
def test_a_clock_burnt_into_the_picture_hides_no_freeze(clock: Area, circle: Circle | None) -> None:
    camera = Camera()
    detector = watched(camera)
    detector.judge(*camera.frame(live=()))
    looks = []
    for n in range(1, 52):
        looks.append(detector.judge(*camera.frame(live=(clock,))))
        assert age_s(detector, camera, circle) == pytest.approx(n / 25)
    assert looks == [Freshness.LIVE] * 50 + [Freshness.FROZEN]


def test_a_tile_that_differs_in_any_of_its_compared_rows_has_changed() -> None:
    """Of 10 rows of a tile here, every second is compared."""
    still = Camera().frame()[0]
    for row in range(10):
        detector = FrozenFrameDetector(2.0)
        detector.judge(still, S)
        moved = still.copy()
        moved[30 + row, :9] ^= 1  # the first tile of the fourth row of tiles
        moved[35, 150:] ^= 1  # the last one, outside the rows that are compared
        detector.judge(moved, 2 * S)
        expected = np.full((12, 16), S)
        if row % 2 == 0:
            expected[3, 0] = 2 * S
        expected[3, 15] = S
        assert detector.changed_ns.tolist() == expected.tolist(), row


def test_a_marker_in_a_dead_part_of_a_live_picture_is_old() -> None:
    """A decoder that lost a slice: the upper half stands still, the lower goes on."""
    camera = Camera()
    detector = watched(camera)
    detector.judge(*camera.frame(live=()))
    lower = (slice(60, None), slice(None))
    for n in range(1, 11):
        assert detector.judge(*camera.frame(live=(lower,))) is Freshness.LIVE
        assert age_s(detector, camera, Circle(80.0, 30.0, 20.0)) == pytest.approx(n / 25)
        assert age_s(detector, camera, Circle(80.0, 95.0, 20.0)) == 0
        assert age_s(detector, camera) == 0


def test_a_source_that_never_changed_is_never_live_and_frozen_in_its_time() -> None:
    camera, detector = Camera(), FrozenFrameDetector(2.0)
    looks = [detector.judge(*camera.frame(live=())) for _ in range(52)]
    assert looks == [Freshness.UNPROVEN] * 51 + [Freshness.FROZEN]


def test_a_clock_alone_does_not_make_a_source_believed_that_is_opened_again() -> None:
    camera, detector = Camera(), FrozenFrameDetector(2.0)
    clock = (slice(0, 15), slice(None))
    looks = [detector.judge(*camera.frame(live=(clock,))) for _ in range(52)]
    assert looks == [Freshness.UNPROVEN] * 51 + [Freshness.FROZEN]


def encoded(image: Image, quality: int) -> Image:
    return as_image(cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR))


def dead_pictures(kind: str, camera: Camera) -> list[Image]:
    """What comes of a sensor that is stuck, again and again in this order; a clock in it is never the same."""
    if kind == "encoded anew":  # the encoder has a bit rate to keep
        return [encoded(camera.first, quality) for quality in (60, 61, 60, 62)]
    return [camera.frame()[0] for _ in range({"two pictures in turn": 2, "a film in a loop": 40}[kind])]


@pytest.mark.parametrize("kind", ["two pictures in turn", "a film in a loop", "encoded anew"])
def test_a_dead_picture_is_found_though_it_never_equals_the_one_before(kind: str) -> None:
    camera = Camera(4.0)
    detector = watched(camera)
    pictures = dead_pictures(kind, camera)
    shown_ns, looks = [], []
    for n in range(len(pictures) + 51):
        image, t_ns = pictures[n % len(pictures)].copy(), camera.frame()[1]
        image[:15] = n  # a banner with a clock
        looks.append(detector.judge(image, t_ns))
        shown_ns.append(t_ns)
        new_ns = shown_ns[min(n, len(pictures) - 1)]
        if kind != "encoded anew":
            assert unchanged_since_ns(detector.changed_ns, WIDTH, HEIGHT, MARKERS[1]) == new_ns
    assert looks[: len(pictures) + 47] == [Freshness.LIVE] * (len(pictures) + 47)
    assert looks[-1] is Freshness.FROZEN


def test_what_equals_the_last_frame_is_old_though_another_frame_has_more_in_common() -> None:
    """The upper part shows three pictures in turn, the lower each of its pictures twice."""
    camera = Camera()
    detector = watched(camera, frames=6)
    upper, lower = [camera.frame()[0][:70] for _ in range(3)], camera.first[70:]
    for n in range(30):
        image, t_ns = camera.frame()
        image[:70] = upper[n % 3]
        if n % 2:
            image[70:] = lower
        lower = image[70:]
        detector.judge(image, t_ns)
        assert set(detector.changed_ns[7:].flat) == {t_ns - n % 2 * S // 25}


def test_a_dead_picture_that_is_encoded_anew_is_not_believed_when_the_source_is_opened_again() -> None:
    camera, detector = Camera(4.0), FrozenFrameDetector(2.0)
    pictures = dead_pictures("encoded anew", camera)
    looks = [detector.judge(pictures[n % len(pictures)], camera.frame()[1]) for n in range(54)]
    assert looks[-1] is Freshness.FROZEN
    assert Freshness.LIVE not in looks


def test_tiles_that_come_again_by_chance_each_from_another_frame_are_live() -> None:
    """A compressed live picture: each tile has a few values only, and no two frames have most of them in common."""
    chance = np.random.default_rng(8)
    detector = FrozenFrameDetector(2.0)
    looks = []
    for n in range(200):
        values = chance.integers(100, 104, (*TILES, 1), dtype=np.uint8)
        looks.append(detector.judge(np.kron(values, np.ones((10, 10, 3), np.uint8)), n * S // 25))
    assert looks == [Freshness.UNPROVEN] * PROOFS + [Freshness.LIVE] * (200 - PROOFS)


def test_a_change_begins_the_time_anew() -> None:
    camera = Camera()
    detector = watched(camera)
    for _ in range(40):
        detector.judge(*camera.frame(live=()))
    detector.judge(*camera.frame())
    assert age_s(detector, camera) == 0
    looks = [detector.judge(*camera.frame(live=())) for _ in range(51)]  # seen before: it is not new again
    assert looks == [Freshness.LIVE] * 50 + [Freshness.FROZEN]


@pytest.mark.parametrize("level", [0, 255])
def test_clipped_parts_cannot_tell_and_go_with_the_rest(level: int) -> None:
    """A yard at night: a lit place in the middle, black round it, which no noise changes."""
    camera = Camera()
    lit = (slice(40, 80), slice(50, 110))
    night = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
    detector = FrozenFrameDetector(2.0)
    for _ in range(60):
        image, t_ns = camera.frame()
        night[lit] = image[lit]
        detector.judge(night.copy(), t_ns)
        assert age_s(detector, camera) == 0
    still = [detector.judge(night.copy(), camera.frame()[1]) for _ in range(51)]
    assert still == [Freshness.LIVE] * 50 + [Freshness.FROZEN]
    assert age_s(detector, camera, Circle(80.0, 60.0, 15.0)) == pytest.approx(51 / 25)


def test_a_black_picture_without_noise_is_frozen_in_the_end() -> None:
    camera = Camera()
    detector = watched(camera)
    black = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    detector.judge(black, camera.frame()[1])
    looks = [detector.judge(black, camera.frame()[1]) for _ in range(51)]
    assert looks == [Freshness.LIVE] * 50 + [Freshness.FROZEN]


def test_plain_pictures_that_differ_are_live() -> None:
    detector = FrozenFrameDetector(2.0)
    looks = [detector.judge(np.full((16, 24, 3), n, np.uint8), n * S) for n in range(100)]
    assert looks == [Freshness.UNPROVEN] * PROOFS + [Freshness.LIVE] * (100 - PROOFS)


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (12, 16), (13, 17), (480, 640), (1080, 1920)])
def test_any_size_of_picture_will_do(size: tuple[int, int]) -> None:
    height, width = size
    camera = Camera(30.0, height, width)
    detector = watched(camera)
    for circle in (None, Circle(width / 2, height / 2, height / 4), Circle(0.0, 0.0, 1.0)):
        assert unchanged_since_ns(detector.changed_ns, width, height, circle) == camera.t_ns


@pytest.mark.parametrize("quality", [30, 50, 90])
def test_a_live_scene_as_jpeg_stays_live(quality: int) -> None:
    """Noise of one grey level, quantised as strongly as cameras do it: a scene with edges, as any yard has."""
    chance = np.random.default_rng(3)
    scene = cv2.resize(
        chance.integers(20, 230, (12, 16, 3), dtype=np.uint8), (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST
    )
    detector = FrozenFrameDetector(2.0)
    for n in range(40):
        noisy = np.clip(scene + chance.standard_normal(scene.shape), 0, 255).astype(np.uint8)
        detector.judge(encoded(noisy, quality), n * S // 25)
        assert n * S // 25 - unchanged_since_ns(detector.changed_ns, WIDTH, HEIGHT, Circle(80.0, 60.0, 30.0)) == 0


def as_image(picture: NDArray[np.generic] | None) -> Image:
    assert picture is not None
    return np.asarray(picture, np.uint8)
