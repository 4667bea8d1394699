"""No marker, no answer; and no picture of any kind makes the robust method raise, hang or grow."""

import math
import tracemalloc

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError

from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.vision.detect import registry
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.method import REJECTIONS
from gateway.vision.pixels import Image
from tests import decoys
from tests.examples import examples
from tests.long import mostly_long

pytestmark = pytest.mark.one_interpreter

PARAMS = VisionConfig()
WIDTH, HEIGHT = 320, 240
chance = np.random.default_rng


@pytest.mark.parametrize("ground", mostly_long(decoys.GROUNDS))
@pytest.mark.parametrize("name", [name for name in decoys.DECOYS if name != "text"])
def test_a_decoy_alone_is_no_marker(name: str, ground: str) -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, ground, 5)
    decoys.DECOYS[name](sheet, 158.0, 122.0, 44.0)
    found = detect(sheet.finished(), PARAMS)

    assert found.circle is None, found.confidence
    assert found.ellipse is None
    assert found.confidence is None
    assert {rejection.why for rejection in found.rejected} <= set(REJECTIONS)


@pytest.mark.parametrize("radius", [30.0, 40.0])
@pytest.mark.parametrize("off", [6.0, 9.0])
def test_a_lamp_that_blinds_the_camera_is_no_marker(radius: float, off: float) -> None:
    """White in the middle, round it a red that falls off."""
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 7)
    sheet.paint *= 0.6
    for reach, light in ((0.22, (300, 300, 420)), (0.8, (18, 14, 190))):
        away = np.hypot(*sheet.far(158.0 + off * (reach < 0.5), 122.0)) / (reach * radius)
        sheet.paint += np.exp(-(away**2))[..., None] * np.array(light, np.float32)
    found = detect(sheet.finished(), PARAMS)

    assert found.circle is None
    assert "blur" in {rejection.why for rejection in found.rejected}


@pytest.mark.parametrize("words", ["S", "O", "8"])
@pytest.mark.parametrize("size", [60, 120])
def test_a_letter_is_no_marker(words: str, size: int) -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 11)
    mask = np.zeros(sheet.paint.shape[:2], np.uint8)
    scale, thick = decoys.SUPER * size / 25, round(decoys.SUPER * size / 4)
    place = (decoys.SUPER * 130, decoys.SUPER * 150)
    cv2.putText(mask, words, place, cv2.FONT_HERSHEY_SIMPLEX, scale, 1, thick, cv2.LINE_8)
    sheet.fill(mask > 0, decoys.RED)

    assert detect(sheet.finished(), PARAMS).circle is None


@pytest.mark.parametrize("ground", decoys.GROUNDS)
@pytest.mark.parametrize("seed", range(3))
def test_an_empty_ground_has_no_marker(ground: str, seed: int) -> None:
    assert detect(decoys.sheet(WIDTH, HEIGHT, ground, 30 + seed).finished(), PARAMS).circle is None


def _plain(colour: tuple[int, int, int]) -> Image:
    return np.full((HEIGHT, WIDTH, 3), colour, np.uint8)


def _stripes() -> Image:
    image = _plain((110, 110, 110))
    image[:, (np.arange(WIDTH) // 12) % 2 == 0] = (40, 35, 190)
    return image


def _checks() -> Image:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] // 16
    return np.where(((x + y) % 2 == 0)[..., None], (40, 35, 190), (110, 110, 110)).astype(np.uint8)


def _gradient() -> Image:
    x = np.linspace(0, 255, WIDTH, dtype=np.float32)
    return np.broadcast_to(np.stack([40 + 0 * x, 40 + 0 * x, x], 1), (HEIGHT, WIDTH, 3)).astype(np.uint8)


def _glow() -> Image:
    """A red light in fog: as round as can be, but without a rim."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    share = np.exp(-((x - 160.0) ** 2 + (y - 120.0) ** 2) / (2 * 40.0**2))
    return np.asarray(np.array([60, 60, 60]) + share[..., None] * np.array([-20, -20, 150]), np.uint8)


PICTURES = {
    "black": lambda: _plain((0, 0, 0)),
    "white": lambda: _plain((255, 255, 255)),
    "all red": lambda: _plain((30, 25, 200)),
    "noise": lambda: chance(1).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8),
    "dark noise": lambda: chance(2).integers(0, 12, (HEIGHT, WIDTH, 3)).astype(np.uint8),
    "red noise": lambda: chance(3).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8) // (4, 4, 1),
    "blotches": lambda: cv2.resize(chance(5).integers(0, 256, (12, 16, 3)).astype(np.uint8), (WIDTH, HEIGHT)),
    "blocks": lambda: np.kron(chance(5).integers(0, 256, (15, 20, 3)), np.ones((16, 16, 1))).astype(np.uint8),
    "stripes": _stripes,
    "checks": _checks,
    "gradient": _gradient,
    "glow": _glow,
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_of_nothing_has_no_marker(name: str) -> None:
    assert detect(np.asarray(PICTURES[name](), np.uint8), PARAMS).circle is None


sides = st.integers(1, 48)
coordinates = st.floats(-1e6, 1e6) | st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300])


@settings(max_examples=examples(60), deadline=None)
@given(st.tuples(sides, sides).flatmap(lambda shape: arrays(np.uint8, (*shape, 3))))
def test_any_picture_gives_a_complete_answer(image: Image) -> None:
    found = detect(image, PARAMS)

    assert (found.circle is None) == (found.ellipse is None) == (found.confidence is None) == (found.visible is None)
    if found.circle is not None and found.confidence is not None:
        assert math.isfinite(found.circle.u_px + found.circle.v_px)
        assert found.circle.radius_px > 0
        assert PARAMS.min_confidence <= found.confidence <= 1


@settings(max_examples=examples(40), deadline=None)
@given(
    window=st.tuples(*[st.integers(-500, 500)] * 4),
    expected=st.builds(Circle, coordinates, coordinates, coordinates),
)
def test_no_window_and_no_prediction_is_too_wild(window: tuple[int, int, int, int], expected: Circle) -> None:
    sheet = decoys.sheet(96, 72, "wood", 3)
    sheet.disc(47.0, 36.0, 14.0)
    found = detect(sheet.finished(), PARAMS, window=window, expected=expected)

    if found.circle is not None:
        assert (found.circle.u_px, found.circle.v_px) == pytest.approx((47.0, 36.0), abs=1.0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 500), (500, 1), (2, 2), (3, 700), (7, 7), (8, 8), (9, 33)])
def test_tiny_and_thin_pictures_are_searched_in_vain(shape: tuple[int, int]) -> None:
    for seed in range(3):
        assert detect(chance(seed).integers(0, 256, (*shape, 3)).astype(np.uint8), PARAMS).circle is None


def test_something_else_than_a_picture_is_refused() -> None:
    for wrong in (np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3), np.float64), np.zeros((0, 4, 3), np.uint8)):
        with pytest.raises(ValueError, match="not a"):
            detect(wrong, PARAMS)  # type: ignore[arg-type]
    for level in (np.nan, np.inf, -0.5, 255.5):
        with pytest.raises(ValueError, match="grey levels from 0 to 255"):
            detect(np.full((40, 40, 3), level, np.float32), PARAMS)


def test_a_picture_that_is_a_view_of_another_is_searched_too() -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 1)
    sheet.disc(160.0, 120.0, 40.0)
    image = sheet.finished()
    flipped = detect(image[::-1, ::-1], PARAMS).circle

    assert flipped is not None
    assert (flipped.u_px, flipped.v_px) == pytest.approx((WIDTH - 1 - 160.0, HEIGHT - 1 - 120.0), abs=0.1)


def test_memory_stays_below_half_of_a_large_picture() -> None:
    image = np.full((4000, 6000, 3), (120, 122, 121), np.uint8)
    cv2.circle(image, (3100, 2050), 700, (40, 35, 190), -1)
    detect(image, PARAMS)
    tracemalloc.start()
    found = detect(image, PARAMS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    assert found.circle is not None
    assert found.circle.radius_px == pytest.approx(700.5, abs=1.0)
    assert peak < image.nbytes / 2


OTHERS = {  # BGR
    "amber": (30, 140, 255),
    "pure orange": (18, 91, 231),
    "brown": (40, 60, 110),
    "rust": (44, 62, 128),
    "skin": (64, 85, 141),
    "magenta": (200, 20, 200),
    "deep pink over-exposed": (255, 60, 255),
    "pale": (190, 190, 210),
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_disc_of_another_colour_is_no_marker(name: str) -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, "leaves", 8)
    sheet.disc(158.0, 122.0, 60.0, (120, 120, 120))
    sheet.disc(158.0, 122.0, 44.0, OTHERS[name])
    found = detect(sheet.finished(), PARAMS)

    assert found.circle is None, found.confidence
    assert "colour" in {r.why for r in found.rejected if abs(r.circle.radius_px - 44) < 2}


LIGHTS = {
    "white": (1, 1, 1),
    "dim": (0.25, 0.25, 0.25),
    "blue": (1.7, 1.1, 0.62),
    "bright": (1.4, 1.4, 1.4),
    "warm": (0.8, 0.95, 1.1),
}


REDS = {"red": (45, 35, 190), "vermilion": (39, 57, 198), "faded": (120, 120, 205)}
LIT = [(colour, light) for colour in REDS for light in LIGHTS if (colour, light) != ("faded", "blue")]  # that is lilac


@pytest.mark.parametrize("ground", [(140, 120, 60), (110, 140, 100)])
def test_a_grey_disc_on_a_coloured_truck_is_no_marker(ground: tuple[int, int, int]) -> None:
    """Though it is redder than the truck, and would be red in a light that made a grey truck look like that."""
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 8)
    sheet.paint[:] = ground
    sheet.disc(158.0, 122.0, 44.0, (150, 150, 150))

    assert detect(sheet.finished(), PARAMS).circle is None


@pytest.mark.parametrize(
    ("colour", "light"), [(REDS[colour], LIGHTS[light]) for colour, light in LIT], ids=["-".join(pair) for pair in LIT]
)
def test_the_markers_red_is_red_in_any_light(colour: tuple[int, int, int], light: tuple[float, float, float]) -> None:
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 8)
    sheet.disc(158.0, 122.0, 44.0, colour)
    sheet.paint *= np.array(light, np.float32)
    found = detect(sheet.finished(), PARAMS)

    assert found.circle is not None
    assert found.circle.radius_px == pytest.approx(44, abs=0.5)


@pytest.mark.parametrize("name", ["amber", "pure orange", "magenta"])
@pytest.mark.parametrize("tracking", [False, True])
def test_a_plant_may_have_a_marker_of_another_colour(name: str, tracking: bool) -> None:
    blue, green, red = OTHERS[name]
    params = VisionConfig(marker_colour=f"#{red:02x}{green:02x}{blue:02x}", tracking=tracking)
    found = registry.detector(params)
    for n, colour in enumerate((OTHERS[name], OTHERS[name], (45, 35, 190), (190, 60, 35))):
        sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 8)
        sheet.disc(158.0, 122.0, 44.0, colour)
        circle = found(sheet.finished(), 1 + n * 10_000_000_000).circle
        assert (circle is not None) == (n < 2)
        assert circle is None or circle.radius_px == pytest.approx(44, abs=0.3)


@pytest.mark.parametrize("colour", ["#1e3cb4", "#1e8c3c", "#f0c814", "#14a0a0"])
def test_of_any_hue_that_is_not_grey(colour: str) -> None:
    red, green, blue = bytes.fromhex(colour[1:])
    sheet = decoys.sheet(WIDTH, HEIGHT, "concrete", 8)
    sheet.disc(158.0, 122.0, 44.0, (blue, green, red))
    picture = sheet.finished()

    assert detect(picture, PARAMS).circle is None
    found = detect(picture, VisionConfig(marker_colour=colour)).circle
    assert found is not None
    assert found.radius_px == pytest.approx(44, abs=0.3)


@pytest.mark.parametrize("colour", ["red", "#f00", "#gg0000", "#808080", "#050000"])
def test_a_colour_that_says_nothing_is_refused(colour: str) -> None:
    with pytest.raises(ValidationError, match=r"should match pattern|no hue"):
        VisionConfig(marker_colour=colour)
