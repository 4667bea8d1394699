"""The picture's own health: measured on rendered bays, disturbed in every way it is meant for, and judged over time."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gateway.config import PictureConfig
from gateway.core.readings import PictureFault, PictureHealth
from gateway.sim.render import Painter
from gateway.sim.scenario import load
from gateway.sim.world import World
from gateway.vision.picture.background import LOST_S, TRUSTED_S, Background
from gateway.vision.picture.judge import PictureJudge
from gateway.vision.picture.measure import PERIOD_NS, PictureMeter, halved, sharpness, veil
from gateway.vision.pixels import Image
from tests.long import mostly_long

pytestmark = pytest.mark.one_interpreter

S = 1_000_000_000
T0 = 5000 * S
SCENARIOS = Path(__file__).parents[3] / "config" / "scenarios"
DARK, BRIGHT, FLAT, BLURRED, DUSTY, SHIFTED = ({fault} for fault in PictureFault)
Disturb = Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]]


@lru_cache
def scenes(name: str, count: int = 8) -> tuple[Image, ...]:
    """Frames all through a scenario, without the sensor's noise."""
    scenario = load(SCENARIOS / f"{name}.toml", {"camera": {"noise": 0}})
    world, painter = World(scenario), Painter(scenario)
    return tuple(painter.frame(world.truth(n * scenario.duration_s / count), 0) for n in range(count))


@lru_cache
def yard() -> Image:
    """A truck at 5 m, its marker hidden; most of the picture is the yard, which stands still."""
    still = {"start": {"distance_cm": 500}, "legs": [], "repeat": False, "camera": {"noise": 0}}
    scenario = load(SCENARIOS / "approach.toml", still | {"faults": [{"kind": "marker_hidden", "at_s": 0, "for_s": 9}]})
    return Painter(scenario).frame(World(scenario).truth(1.0), 0)


_CHANCE = np.random.default_rng(3)


@lru_cache
def _noise_sheet() -> np.ndarray[Any, np.dtype[np.float32]]:
    return _CHANCE.standard_normal((640, 800, 3), np.float32)


def exposed(scene: np.ndarray[Any, Any], noise: float = 2.0) -> Image:
    """A sensor's noise on a scene: a part of one large sheet of noise, elsewhere each time."""
    (height, width), sheet = scene.shape[:2], _noise_sheet()
    y, x = (int(_CHANCE.integers(0, sheet.shape[n] - side)) for n, side in enumerate((height, width)))
    noisy = scene + np.float32(noise) * sheet[y : y + height, x : x + width]
    return np.asarray(cv2.convertScaleAbs(np.maximum(noisy, 0, out=noisy)), np.uint8)  # rounds and saturates


def measured(image: Image) -> PictureHealth:
    found = PictureMeter().measure(image, T0, marker=True)
    assert found is not None
    return found


def faults(healths: Iterable[PictureHealth], seconds: float, limits: PictureConfig | None = None) -> set[PictureFault]:
    """What is judged when these come again and again, half a second apart, for this time."""
    judge, status = PictureJudge(limits or PictureConfig()), PictureHealth(1, 0, 1, 1, 0, 0)
    for n, health in enumerate(itertools.islice(itertools.cycle(healths), int(2 * seconds) + 1)):
        status = judge.judged(health, T0 + n * S // 2)
    return set(status.faults)


def blurred(sigma: float) -> Disturb:
    return lambda scene: np.asarray(cv2.GaussianBlur(scene, (0, 0), sigma))


def times(gain: float) -> Disturb:
    return lambda scene: scene * gain


def dusty(share: float) -> Disturb:
    return lambda scene: scene * (1 - share) + 205 * share


def covered(level: float) -> Disturb:
    return lambda scene: np.full_like(scene, level)


# What is measured.


@pytest.mark.parametrize("name", ["approach", "day", "dusk", "dust", "rusty"])
@pytest.mark.parametrize("noise", mostly_long([5.0, 2.0]))
def test_a_clean_bay_is_in_order_whatever_the_truck_the_light_and_the_clouds_do(name: str, noise: float) -> None:
    healths = [measured(exposed(scene, noise)) for scene in scenes(name)]
    assert faults(healths, 3600) == set()


@pytest.mark.mostly_long(short=3)
@pytest.mark.parametrize("name", ["approach", "day", "dusk"])
@pytest.mark.parametrize(
    ("disturb", "noise", "seconds", "expected"),
    [
        pytest.param(covered(0), 2.0, 10, DARK, id="lens cap"),
        pytest.param(times(0.03), 2.0, 10, DARK, id="no light"),
        pytest.param(covered(90), 2.0, 10, FLAT, id="cover"),
        pytest.param(covered(90), 10.0, 10, FLAT, id="cover, much gain"),
        pytest.param(covered(240), 2.0, 10, FLAT, id="white cover"),
        pytest.param(covered(255), 2.0, 10, BRIGHT, id="sun in the lens"),
        pytest.param(times(20), 2.0, 10, BRIGHT, id="over-exposed"),
        pytest.param(blurred(4), 2.0, 90, BLURRED, id="blur of 4 px"),
        pytest.param(blurred(6), 2.0, 90, BLURRED, id="blur of 6 px"),
        pytest.param(blurred(4), 8.0, 90, BLURRED, id="blur of 4 px, noise"),
        pytest.param(dusty(0.7), 2.0, 1200, DUSTY, id="dust of 0.7"),
        pytest.param(dusty(0.95), 2.0, 10, FLAT, id="dust so thick that nothing is seen"),
    ],
)
@pytest.mark.failure_mode("C4", "C5")
def test_each_disturbance_is_named_and_no_other(
    name: str, disturb: Disturb, noise: float, seconds: float, expected: set[PictureFault]
) -> None:
    healths = [measured(exposed(disturb(scene.astype(np.float32)), noise)) for scene in scenes(name)]
    assert faults(healths, seconds) == expected
    assert faults(healths, 2) == set()  # not at once


@pytest.mark.parametrize("quality", [30, 60])
def test_a_jpeg_of_a_sharp_picture_is_sharp_and_of_a_blurred_one_blurred(quality: int) -> None:
    def coded(scene: np.ndarray[Any, Any]) -> Image:
        data = cv2.imencode(".jpg", exposed(scene), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)

    assert faults([measured(coded(scene)) for scene in scenes("day")], 600) == set()
    assert faults([measured(coded(blurred(5)(scene))) for scene in scenes("day")], 600) == BLURRED


@pytest.mark.parametrize("noise", [0.0, 2.0, 6.0])
def test_sharpness_falls_with_blur_and_hardly_with_noise(noise: float) -> None:
    found = [
        np.median([sharpness(exposed(blurred(sigma)(scene), noise)) or np.nan for scene in scenes("approach")])
        for sigma in (0.3, 1.0, 2.0, 4.0, 8.0)
    ]
    assert found == pytest.approx([0.6, 0.48, 0.32, 0.19, 0.12], abs=0.05)


def test_a_picture_of_noise_alone_has_no_sharpness() -> None:
    assert sharpness(exposed(np.full((480, 640, 3), 90.0), 10)) is None
    assert measured(exposed(np.full((480, 640, 3), 90.0), 10)).sharpness is None


def test_a_picture_with_contrast_and_no_edge_at_all_is_as_blurred_as_can_be() -> None:
    shade = np.broadcast_to(np.linspace(20, 230, 640)[None, :, None], (480, 640, 3))
    assert measured(exposed(shade)).sharpness == 0.0


def test_brightness_contrast_and_burnt_share_of_a_known_picture() -> None:
    picture = np.zeros((480, 640, 3), np.uint8)
    picture[:, 160:480] = 100
    picture[:, 480:] = 255
    health = measured(picture)
    assert health.brightness == pytest.approx((0.5 * 100 + 0.25 * 255) / 255, abs=1e-3)
    assert (health.contrast, health.clipped) == (1.0, 0.25)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7, 0.85])
def test_the_veil_is_the_share_of_dust_where_something_is_dark(share: float) -> None:
    scene = np.clip(scenes("day")[0].astype(np.float32), 0, 205)
    scene[:30] = 0
    found = veil(halved(exposed(dusty(share)(scene), 1)))
    assert found == pytest.approx(share, abs=0.06)


def test_in_a_black_picture_dust_cannot_be_measured() -> None:
    assert veil(np.zeros((120, 160, 3), np.uint8)) is None


@pytest.mark.parametrize("size", [(1, 1), (2, 300), (16, 24), (97, 101), (480, 640), (1080, 1920), (1920, 1080)])
def test_any_size_of_picture_is_measured(size: tuple[int, int]) -> None:
    meter = PictureMeter()
    for n in range(8):
        image = _CHANCE.integers(0, 256, (*size, 3), dtype=np.uint8)
        assert meter.measure(image, T0 + 3 * n * S, marker=False) is not None


def test_every_half_second_is_enough_and_a_clock_that_goes_back_is_no_end() -> None:
    meter, image = PictureMeter(), np.zeros((48, 64, 3), np.uint8)
    due = [meter.measure(image, T0 + n * S // 30, marker=True) is not None for n in range(61)]
    assert sum(due) == 5
    assert [n for n, one in enumerate(due) if one] == [0, 15, 30, 45, 60]
    assert meter.measure(image, T0 - 900 * S, marker=True) is not None


# What is judged.


def health(**of: Any) -> PictureHealth:
    return PictureHealth(
        **({"brightness": 0.5, "clipped": 0.0, "contrast": 0.4, "sharpness": 0.6, "veil": 0.2, "shift_px": 0.0} | of)
    )


FINE = health()
BAD = {
    PictureFault.DARK: (health(brightness=0.01), 5),
    PictureFault.BRIGHT: (health(clipped=0.9), 5),
    PictureFault.FLAT: (health(contrast=0.01), 5),
    PictureFault.BLURRED: (health(sharpness=0.1), 60),
    PictureFault.DUSTY: (health(veil=0.8), 900),
    PictureFault.SHIFTED: (health(shift_px=20.0), 60),
}


class Judge:
    def __init__(self, limits: PictureConfig | None = None) -> None:
        self.judge = PictureJudge(limits or PictureConfig())
        self.t_ns = T0

    def see(self, one: PictureHealth, seconds: float) -> list[int]:
        """The status after each measurement, half a second apart."""
        found = []
        for _ in range(round(2 * seconds)):
            self.t_ns += S // 2
            found.append(self.judge.judged(one, self.t_ns).status)
        return found


@pytest.mark.parametrize("fault", PictureFault)
def test_a_fault_begins_and_ends_after_its_time(fault: PictureFault) -> None:
    bad, seconds = BAD[fault]
    judge = Judge()
    judge.see(FINE, 100)
    begun = judge.see(bad, 5 * seconds)
    assert begun.index(1 << fault) / 2 == pytest.approx(seconds, abs=max(1, 0.02 * seconds))
    assert set(begun[begun.index(1 << fault) :]) == {1 << fault}
    ended = judge.see(FINE, 2 * seconds)
    assert ended.index(0) / 2 == pytest.approx(seconds, abs=max(1.5, 0.05 * seconds))
    assert set(ended[ended.index(0) :]) == {0}


@pytest.mark.parametrize("fault", PictureFault)
def test_a_fault_that_comes_and_goes_is_none(fault: PictureFault) -> None:
    bad, seconds = BAD[fault]
    judge, seen = Judge(), set()
    for _ in range(20):
        seen |= {*judge.see(bad, seconds / 2), *judge.see(FINE, seconds / 2)}
    assert seen == {0}


@pytest.mark.parametrize("fault", PictureFault)
def test_what_cannot_be_measured_changes_nothing(fault: PictureFault) -> None:
    bad, seconds = BAD[fault]
    judge = Judge()
    judge.see(bad, 5 * seconds)
    unknown = {"sharpness": None, "veil": None, "shift_px": None}
    if fault in (PictureFault.BLURRED, PictureFault.DUSTY, PictureFault.SHIFTED):
        assert set(judge.see(health(**unknown), 3 * seconds)) == {1 << fault}
    fresh = Judge()
    assert set(fresh.see(health(**unknown), 3 * seconds)) == {0}


def test_a_gap_in_the_pictures_is_no_time_in_which_anything_was_seen() -> None:
    judge = Judge()
    judge.see(health(veil=0.8), 10)
    judge.t_ns += 7200 * S
    assert set(judge.see(health(veil=0.8), 10)) == {0}


def test_of_a_picture_that_shows_nothing_only_that_is_reported() -> None:
    for bad, name in (
        (health(brightness=0.01, contrast=0.0), DARK),
        (health(clipped=0.9, contrast=0.0), BRIGHT),
        (health(contrast=0.01), FLAT),
    ):
        worse = PictureHealth(bad.brightness, bad.clipped, bad.contrast, 0.01, 0.99, None)
        assert faults([worse], 3600) == name


def test_at_its_limit_a_fault_does_not_come_and_go() -> None:
    judge, limit = Judge(), PictureConfig().sharpness_min
    judge.see(health(sharpness=limit * 0.95), 120)
    assert set(judge.see(health(sharpness=limit * 1.05), 600)) == {1 << PictureFault.BLURRED}
    assert judge.see(health(sharpness=limit * 1.2), 120)[-1] == 0


LIMITS = ("brightness_min", "clipped_max", "contrast_min", "sharpness_min", "veil_max", "shift_max_px")


@pytest.mark.parametrize("key", LIMITS)
def test_0_switches_a_limit_off(key: str) -> None:
    worst = PictureHealth(0.0, 1.0, 0.0, 0.0, 1.0, 500.0)
    every = dict.fromkeys(LIMITS, 0.0)
    assert faults([worst], 3600, PictureConfig(**every)) == set()
    default = PictureConfig().model_dump()
    alone = faults([worst], 3600, PictureConfig(**{**every, key: default[key]}))
    assert len(alone) == 1


# Has the camera been moved?


def moved(scene: Image, dx: float = 0, dy: float = 0, *, turn_deg: float = 0, zoom: float = 1) -> Image:
    height, width = scene.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), turn_deg, zoom)
    matrix[:, 2] += np.array((dx, dy))
    return np.asarray(cv2.warpAffine(scene, matrix, (width, height), borderMode=cv2.BORDER_REFLECT), np.uint8)


class Watched:
    """A meter that sees one scene after the other, every 2 s."""

    def __init__(self) -> None:
        self.meter = PictureMeter()
        self.t_ns = T0

    def see(self, scenes: Sequence[Image], *, marker: bool = False, noise: float = 2.0) -> list[float | None]:
        found = []
        for scene in scenes:
            self.t_ns += 2 * S + PERIOD_NS // 10
            health = self.meter.measure(exposed(scene, noise), self.t_ns, marker=marker)
            assert health is not None
            found.append(health.shift_px)
        return found


def learned() -> Watched:
    watched = Watched()
    assert watched.see([yard()] * 5) == [None] * 5
    return watched


@pytest.mark.parametrize(
    ("place", "px"),
    [((0, 0), 0), ((3, 0), 3), ((0, -8), 8), ((8, 6), 10), ((-30, 10), 31.6), ((50, 0), 50), ((64, 48), 80)],
)
def test_a_camera_that_was_moved_sees_the_background_elsewhere(place: tuple[float, float], px: float) -> None:
    found = learned().see([moved(yard(), *place)] * 4)
    assert [shift for shift in found if shift is not None] == pytest.approx([px] * 4, abs=1.0 + 0.03 * px)


def test_a_turn_and_a_zoom_are_a_move_too() -> None:
    assert min(shift or 0 for shift in learned().see([moved(yard(), turn_deg=3)] * 3)) > 8
    assert min(shift or 0 for shift in learned().see([moved(yard(), zoom=1.07)] * 3)) > 8


@pytest.mark.parametrize("gain", [0.15, 0.5, 1.5])
def test_another_light_moves_nothing(gain: float) -> None:
    slope = np.linspace(0.4, 1.4, 640)[None, :, None]
    for scene in (times(gain)(yard().astype(np.float32)), yard() * slope, dusty(0.6)(yard().astype(np.float32))):
        found = learned().see([np.clip(scene, 0, 255)] * 4)
        assert all(shift is not None and shift < 3 for shift in found)


def test_trucks_that_come_and_go_are_no_moved_camera_even_with_their_markers_hidden() -> None:
    """An hour of them, the yard in between."""
    watched, judge = learned(), PictureJudge(PictureConfig())
    visit = [*scenes("approach", 24), *[yard()] * 5]
    statuses = set()
    for n, shift in enumerate(watched.see(visit * 4)):
        statuses.add(judge.judged(health(shift_px=shift), T0 + 2 * n * S).status)
    assert statuses == {0}


@pytest.mark.failure_mode("C6")
def test_a_moved_camera_is_reported_between_the_trucks() -> None:
    watched, judge = learned(), PictureJudge(PictureConfig())
    visit = [moved(scene, 16, 0) for scene in (*scenes("approach", 12), *[yard()] * 12)]
    for n, shift in enumerate(watched.see(visit * 4)):
        status = judge.judged(health(shift_px=shift), T0 + 2 * n * S).status
    assert status == 1 << PictureFault.SHIFTED


def test_while_a_marker_is_in_sight_nothing_is_learned_and_nothing_measured() -> None:
    watched = Watched()
    watched.see([yard()] * 4)
    assert watched.see([yard()], marker=True) == [None]
    assert watched.see([yard()] * 5) == [None] * 5  # begun anew
    assert watched.see([moved(yard(), 20, 0)] * 2, marker=True) == [None, None]
    assert watched.see([yard()]) == pytest.approx([0], abs=1)


def test_nothing_is_learned_from_what_moves_is_dark_or_has_no_contrast() -> None:
    watched = Watched()
    watched.see(scenes("approach", 12))
    watched.see([np.asarray(yard() // 20, np.uint8)] * 6)
    watched.see([np.full_like(yard(), 90)] * 6)
    assert watched.see([yard()] * 5) == [None] * 5
    assert watched.see([yard()]) == pytest.approx([0], abs=1)


def grey(scene: Image) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.asarray(cv2.cvtColor(halved(exposed(scene)), cv2.COLOR_BGR2GRAY), np.uint8)


def test_a_background_that_is_never_recognised_again_is_forgotten_if_it_may_have_been_a_truck() -> None:
    background, t_ns = Background(), T0
    truck, empty = grey(scenes("approach")[5]), grey(yard())
    found = []
    for picture in [truck] * 5 + [empty] * 40:
        t_ns += 3 * S
        found.append(background.shift(picture, t_ns, marker=False))
    assert found[:35] == [None] * 35  # 30 lost, then 5 to learn
    assert found[-3:] == pytest.approx([0, 0, 0], abs=0.3)


@pytest.mark.mostly_long
@pytest.mark.parametrize("trusted", ["recognised after a visit", "recognised for long"])
def test_a_trusted_background_that_is_lost_for_an_hour_is_farther_than_can_be_measured(trusted: str) -> None:
    background, t_ns = Background(), T0
    empty, elsewhere = grey(yard()), grey(scenes("approach")[5])

    def see(picture: np.ndarray[Any, np.dtype[np.uint8]], seconds: float, *, marker: bool = False) -> float | None:
        nonlocal t_ns
        found = None
        for _ in range(int(seconds / 2)):
            t_ns += 2 * S + 1
            found = background.shift(picture, t_ns, marker=marker)
        return found

    see(empty, 10)
    if trusted == "recognised for long":
        see(empty, TRUSTED_S)
    else:
        see(elsewhere, 10, marker=True)
        see(empty, 2)
    assert see(elsewhere, LOST_S - 10) is None
    see(elsewhere, 9999, marker=True)  # what is hidden by a truck with its marker does not count
    assert see(elsewhere, 4) is None
    assert see(elsewhere, 20) == empty.shape[1] / 2
    assert see(empty, 2) == pytest.approx(0, abs=0.3)
