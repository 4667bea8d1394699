"""The cheap check for red things: what is new and what is not, compiled and not."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.detection import Circle
from gateway.vision.detect.robust import red_change
from gateway.vision.detect.robust.kernel.sparse_kernel import RegionKernel
from gateway.vision.detect.robust.red_change import (
    SPARSE_PX,
    RedRegions,
    alike,
    load,
    red_regions,
    red_regions_plain,
    sparse_place,
)
from gateway.vision.pixels import Image
from tests.examples import examples

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


# -- the compiled one --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def compiled(library: Path) -> RegionKernel:
    loaded = load(library)
    assert loaded is not None
    return loaded


def speckled(chance: np.random.Generator) -> tuple[Image, Circle]:
    """Colours of all kinds in a picture of any size, something followed anywhere, of any size."""
    height, width = (int(side) for side in chance.integers(1, 30 if chance.random() < 0.3 else 900, 2))
    coarse = chance.integers(0, 256, (max(1, height // 7), max(1, width // 7), 3), np.uint8)
    smooth = np.asarray(cv2.resize(coarse, (width, height))).reshape(height, width, 3)
    image = np.clip(smooth + chance.normal(0, 10, smooth.shape), 0, 255).astype(np.uint8)
    u, v = (float(at) for at in chance.normal(0, 1, 2) * (width, height))
    return image, Circle(u, v, float(np.exp(chance.uniform(-5, 7))))


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_same_regions_as_without_a_compiler(compiled: RegionKernel, monkeypatch: pytest.MonkeyPatch) -> None:
    chance = np.random.default_rng(31)
    monkeypatch.setattr(red_change, "compiled_kernel", lambda: compiled)
    boxes = faint = 0
    for _ in range(examples(150)):
        image, followed = speckled(chance)
        for view in (image, image[::-1], image[:, 1:] if image.shape[1] > 1 else image):
            found = red_regions(view, followed)
            assert alike(found, red_regions_plain(view, followed)), (image.shape, followed)
            boxes, faint = boxes + len(found.boxes), faint + found.faint
    assert boxes > 5 * examples(150)
    assert faint > examples(150)


def test_a_veil_is_left_to_numpy(compiled: RegionKernel) -> None:
    dusty = np.full((480, 640, 3), 150, np.uint8)
    assert compiled.regions(dusty, 2, (150, 120), 20, 40) is None
    assert compiled.regions(dusty // 8, 2, (150, 120), 20, 40) is not None  # dark: no airlight


def test_a_picture_half_of_which_is_red_has_one_region(compiled: RegionKernel) -> None:
    red = np.full((480, 640, 3), RED, np.uint8)
    red[:, 320:] = 5
    found = compiled.regions(red, 2, (-500, -500), 1, 1)
    assert found is not None
    boxes, faint = found
    assert (boxes.tolist(), faint) == ([[0, 0, 161, 240]], True)  # the blur's pixel with it
