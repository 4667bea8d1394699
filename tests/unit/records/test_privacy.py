"""What lies outside the region of a stored picture cannot be recognised, and what lies inside is untouched."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays

from gateway.records.privacy import SQUARE_PX, blurred_outside

NOISE = np.random.default_rng(1).integers(0, 256, (240, 336, 3), np.uint8)


def test_inside_it_is_lossless_and_outside_there_are_squares() -> None:
    out = blurred_outside(NOISE, (100, 60, 80, 50))
    assert (out[60:110, 100:180] == NOISE[60:110, 100:180]).all()
    left = out[:, :96].reshape(10, 24, 4, 24, 3)
    assert (left == left[:, :1, :, :1]).all()
    assert np.abs(left[:, 0, :, 0].astype(float) - NOISE[:, :96].reshape(10, 24, 4, 24, 3).mean((1, 3))).max() <= 0.6
    assert (NOISE[0, 0] != out[0, 0]).any(), "a copy: the picture itself stays as it is"


@pytest.mark.parametrize(("width", "height"), [(336, 240), (97, 50), (48, 200)])
@pytest.mark.parametrize("across", [0, 1, 2])
@pytest.mark.parametrize("down", [0, 1, 2])
def test_on_every_side_of_the_region_there_are_squares(width: int, height: int, across: int, down: int) -> None:
    """The region is one of nine thirds."""
    image = np.random.default_rng(2).integers(0, 256, (height, width, 3), np.uint8)
    left, top = across * width // 3, down * height // 3
    out = blurred_outside(image, (left, top, width // 3, height // 3))
    outside = np.ones((height, width), bool)
    outside[top : top + height // 3, left : left + width // 3] = False
    kept = (out == image).all(axis=-1) & outside
    assert kept.mean() < 0.001  # by chance
    squares = -(-width // SQUARE_PX) * -(-height // SQUARE_PX)
    assert len(np.unique(out[outside], axis=0)) <= squares


def test_a_word_that_can_be_read_cannot_be_read_any_more() -> None:
    """Two pictures that differ in fine detail only are one outside the region."""
    lines = np.zeros((240, 336, 3), np.uint8)
    lines[:, ::2] = 200
    shifted = np.roll(lines, 1, axis=1)
    assert (blurred_outside(lines, (0, 0, 1, 1))[1:, 1:] == blurred_outside(shifted, (0, 0, 1, 1))[1:, 1:]).all()


@pytest.mark.one_interpreter
@given(
    arrays(np.uint8, st.tuples(st.integers(1, 60), st.integers(1, 60), st.just(3))),
    st.tuples(*[st.integers(0, 100)] * 2, *[st.integers(1, 100)] * 2),
)
def test_any_picture_and_any_region(image: np.ndarray, region: tuple[int, int, int, int]) -> None:
    out = blurred_outside(image, region)
    assert out.shape == image.shape
    left, top, width, height = region
    assert (out[top : top + height, left : left + width] == image[top : top + height, left : left + width]).all()
    assert SQUARE_PX == 24
