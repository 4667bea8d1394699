"""The cheap check for red things: what is new and what is not."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.detection import Circle
from gateway.vision.detect.robust.red_change import SPARSE_PX, RedRegions, red_regions, sparse_place
from gateway.vision.pixels import Image

OWN = Circle(300.0, 240.0, 60.0)
RED, WOOD, DUSTY = (40, 40, 200), (60, 95, 140), (150, 150, 190)


def scene(*others: tuple[Circle, tuple[int, int, int]], own: tuple[int, int, int] = RED) -> Image:
    image = np.full((480, 640, 3), 120, np.uint8)
    for circle, colour in ((OWN, own), *others):
        centre = round(circle.u_px), round(circle.v_px)
        cv2.circle(image, centre, round(circle.radius_px), colour, -1)
    return image


def test_what_is_followed_is_no_red_region_and_another_red_thing_is_one() -> None:
    assert red_regions(scene(), OWN).boxes.shape == (0, 4)
    (box,) = red_regions(scene((Circle(500.0, 100.0, 20.0), RED)), OWN).boxes
    step = int(np.hypot(640, 480) // SPARSE_PX)
    assert (box * step).tolist() == pytest.approx([480, 80, 521, 121], abs=2 * step)


def test_wood_is_none_beside_a_red_marker_but_a_dusty_marker_lets_it_count() -> None:
    board = Circle(500.0, 100.0, 30.0), WOOD
    assert len(red_regions(scene(board), OWN).boxes) == 0
    assert len(red_regions(scene(board, own=DUSTY), OWN).boxes) == 1


def test_specks_are_no_red_regions() -> None:
    speck = Circle(501.0, 101.0, 1.0), RED  # one pixel of the sparse picture
    assert len(red_regions(scene(speck, own=DUSTY), OWN).boxes) == 0


def regions_at(*boxes: tuple[int, int, int, int]) -> RedRegions:
    return RedRegions(np.array(boxes, np.int32).reshape(-1, 4))


@pytest.mark.parametrize(
    ("now", "new"),
    [
        (regions_at(), False),
        (regions_at((10, 10, 20, 20)), False),
        (regions_at((24, 10, 34, 20)), False),  # moved on
        (regions_at((0, 0, 60, 60)), False),  # come nearer
        (regions_at((27, 10, 37, 20)), True),
        (regions_at((10, 10, 20, 20), (80, 80, 90, 90)), True),
    ],
)
def test_new_red(now: RedRegions, new: bool) -> None:
    assert now.new_since(regions_at((10, 10, 20, 20))) is new
    assert now.new_since(regions_at()) is (len(now.boxes) > 0)


@given(
    u=st.floats(-1e6, 1e6), v=st.floats(-1e6, 1e6), r=st.floats(1e-3, 1e6),
    height=st.integers(1, 40), width=st.integers(1, 900), shade=st.integers(0, 255),
)  # fmt: skip
def test_no_circle_and_no_size_breaks_it(u: float, v: float, r: float, height: int, width: int, shade: int) -> None:
    found = red_regions(np.full((height, width, 3), shade, np.uint8), Circle(u, v, r))
    assert found.boxes.shape == (0, 4)
    assert not found.new_since(found)


def test_places_of_the_sparse_picture() -> None:
    assert sparse_place(Circle(2.0, 7.0, 10.0), 5) == ((0, 1), 2.0)
