"""The eyedropper for the robust method: the marker's colour in the method's own measure, and what is proposed of it."""

import math

import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.vision.detect import registry
from gateway.vision.pixels import Image
from gateway.web.tuning.marker_pick import pick
from gateway.web.tuning.response_models import MarkerPickView
from tests import decoys

ORANGE, AMBER, RED, GREEN = (18, 91, 231), (30, 140, 255), (45, 35, 190), (60, 140, 30)  # BGR


def flat(bgr: tuple[int, int, int], noise: float = 0.0) -> Image:
    image = np.full((60, 80, 3), bgr, np.float32)
    image += np.random.default_rng(61).normal(0, noise, image.shape)
    return np.asarray(np.clip(np.rint(image), 0, 255), np.uint8)


def at_the_middle(image: Image, present: str | None = None, size_px: int = 15) -> MarkerPickView:
    return pick(image, image.shape[1] / 2, image.shape[0] / 2, size_px, present)


def test_of_another_colour_that_one_is_proposed_with_its_hue_and_chroma() -> None:
    found = at_the_middle(flat(ORANGE))

    assert found.colour == "#e75b12"
    assert found.hue_deg == pytest.approx(20.6, abs=0.1)
    assert found.hues_deg == pytest.approx((20.6, 20.6), abs=0.1)
    assert found.chroma == pytest.approx(math.log(239 / 26), abs=0.01)  # beyond 20 degrees against blue, the least
    assert found.distance == pytest.approx(2.94, abs=0.02)  # (20.6 - 0.3 - 10) / 3.5
    assert found.keys == {"marker_colour": "#e75b12"}
    assert found.warnings == []


@pytest.mark.parametrize("present", [None, "#e75b12"])
def test_of_the_present_colour_nothing_is_proposed(present: str | None) -> None:
    found = at_the_middle(flat(RED if present is None else ORANGE), present)

    assert (found.distance, found.keys, found.warnings) == (0, {}, [])


def test_a_red_marker_needs_no_colour_of_its_own() -> None:
    found = at_the_middle(flat(RED), "#1e8c3c")

    assert found.distance > 1
    assert found.keys == {"marker_colour": None}


@pytest.mark.parametrize(
    ("bgr", "says"),
    [
        ((150, 152, 158), "too pale (chroma 0.04, paint has 0.3 and more)"),
        ((130, 150, 165), "too pale (chroma 0.23"),
        ((4, 12, 26), "nearly black (26 of 255)"),
        ((20, 120, 253), "over-exposed (253 of 255)"),
    ],
)
def test_what_has_no_hue_to_be_known_by_is_said_and_nothing_is_proposed(bgr: tuple[int, int, int], says: str) -> None:
    found = at_the_middle(flat(bgr), "#1e3cb4")

    assert says in found.warnings[0]
    assert found.keys == {}
    assert found.distance <= 10  # a number, of grey, too


def test_a_patch_of_many_colours_or_over_the_rim_is_refused() -> None:
    two = np.hstack([flat(ORANGE)[:, :42], flat(GREEN)[:, 42:]])
    near = np.hstack([flat(ORANGE)[:, :42], flat((20, 200, 231))[:, 42:]])  # as strong a yellow
    rim = np.hstack([flat(ORANGE)[:, :42], flat((120, 120, 120))[:, 42:]])

    assert "many colours: hues over" in at_the_middle(two).warnings[0]
    assert "many colours: hues over 31 degrees" in at_the_middle(near).warnings[0]
    assert "many colours" in at_the_middle(rim).warnings[0]
    assert at_the_middle(two).keys == at_the_middle(rim).keys == {}


@pytest.mark.parametrize("dim", [1.0, 0.35])
def test_a_noisy_and_a_dim_patch_are_fine(dim: float) -> None:
    blue, green, red = (round(dim * level) for level in ORANGE)
    found = at_the_middle(flat((blue, green, red), noise=6.0))

    assert found.warnings == []
    assert found.hue_deg == pytest.approx(20.6, abs=2)


@pytest.mark.parametrize("bgr", [ORANGE, AMBER, GREEN])
def test_what_is_proposed_is_what_the_method_then_finds(bgr: tuple[int, int, int]) -> None:
    sheet = decoys.sheet(320, 240, "concrete", 62)
    sheet.disc(158.0, 122.0, 44.0, (bgr[0], bgr[1], min(bgr[2], 235)))
    image = sheet.finished()
    before = VisionConfig(tracking=False)
    taught = before.model_copy(update=pick(image, 158, 122, 31, None).keys)

    assert registry.detector(before)(image).circle is None
    found = registry.detector(taught)(image).circle
    assert found is not None
    assert found.radius_px == pytest.approx(44, abs=0.3)
    assert pick(image, 158, 122, 31, taught.marker_colour).distance == 0


def test_a_click_beside_the_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="beside the picture"):
        pick(flat(RED), 80, 5, 9, None)
