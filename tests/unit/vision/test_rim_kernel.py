"""The compiled refinement of the rim gives what the Python beside it gives."""

import math
from dataclasses import astuple, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust import refinement
from gateway.vision.detect.robust.kernel import lab
from gateway.vision.detect.robust.kernel.rim_kernel import RimKernel
from gateway.vision.detect.robust.refinement import fall, fall_plain, load, refine, refine_plain
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.pixels import Image
from tests.examples import examples
from tests.unit.vision.kernel_examples import seed_near, shot


@pytest.fixture(scope="module")
def kernel(library: Path) -> RimKernel:
    loaded = load(library)
    assert loaded is not None
    return loaded


def numbers(rim: Rim) -> tuple[float, ...]:
    """All but the angle, which means nothing for a circle, and in its place how the ellipse leans, px."""
    e = rim.ellipse
    apart = e.semi_major_px - e.semi_minor_px
    lean = (apart * math.cos(2 * e.angle_rad), apart * math.sin(2 * e.angle_rad))
    return (*astuple(e)[:4], *lean, *astuple(rim)[1:])


def cases(number: int) -> list[tuple[Image, Ellipse, float, bool]]:
    chance = np.random.default_rng(2025)
    made = []
    for _ in range(number):
        image, disc = shot(chance)
        reach = (4.0, 10.0, 2.0, 0.25 * disc.semi_major_px, 1e9)[chance.integers(0, 5)]
        made.append((image, seed_near(chance, disc), reach, bool(chance.integers(0, 2))))
    return made


def both(kernel: RimKernel, image: Image, seed: Ellipse, reach: float, opponent: bool) -> tuple[Rim | None, Rim | None]:
    return kernel.refine(image, seed, reach, opponent), refine_plain(image, seed, reach, opponent=opponent)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_same_rims_as_without_a_compiler(kernel: RimKernel) -> None:
    rims = 0
    for image, seed, reach, opponent in cases(examples(500)):
        mine, plain = both(kernel, image, seed, reach, opponent)
        assert (mine is None) == (plain is None), (seed, reach, opponent, image.shape)
        if mine is not None and plain is not None:
            assert numbers(mine) == pytest.approx(numbers(plain), rel=0, abs=1e-6), (seed, reach, opponent, image.shape)
            rims += 1
    assert rims > examples(500) / 3


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_same_fall_of_redness_as_without_a_compiler(kernel: RimKernel) -> None:
    """To the last bit, also where the rim is cut by the picture's edge."""
    falls = []
    for image, seed, reach, opponent in cases(examples(200)):
        rim = refine_plain(image, seed, reach, opponent=opponent)
        if rim is not None:
            for share in (0.1, 0.25, 0.9):
                falls.append(fall_plain(image, rim.ellipse, share))
                assert kernel.fall(image, rim.ellipse, share) == falls[-1], (rim, share)
    assert len({*falls}) > examples(200) / 2


def test_a_red_disc_falls_by_the_redness_of_its_paint(kernel: RimKernel) -> None:
    image, seed = disc_picture()
    lab_of = [
        cv2.cvtColor(np.array([[colour]], np.uint8), cv2.COLOR_BGR2Lab) for colour in ((40, 45, 190), (120, 128, 122))
    ]
    inside, outside = (int(np.asarray(one)[0, 0, 1]) for one in lab_of)
    assert kernel.fall(image, seed, 0.25) == 1.5 * (inside - outside)
    assert (
        kernel.fall(image, replace(seed, u_px=-40.0, v_px=-30.0, semi_major_px=46.0, semi_minor_px=40.0), 0.25) == 0.0
    )


@pytest.mark.long
@pytest.mark.one_interpreter
def test_samples_are_rounded_as_opencv_rounds_them(kernel: RimKernel) -> None:
    """One in a million of strong noise is another grey level where a processor rounds once more or less in between."""
    chance = np.random.default_rng(5)
    clear = np.full((110, 110, 3), (70, 170, 90), np.float64)
    cv2.circle(clear, (54, 55), 36, (150, 60, 190), -1)
    for _ in range(examples(600)):
        image = np.clip(np.rint(clear + chance.normal(0, 60, clear.shape)), 0, 255).astype(np.uint8)
        mine, plain = both(kernel, image, Ellipse(54.2, 54.7, 36.5, 35.5, 0.3), 6.0, False)
        assert (mine is None) == (plain is None)
        assert mine is None or plain is None or numbers(mine) == pytest.approx(numbers(plain), rel=0, abs=1e-6)


@pytest.mark.parametrize("wild", [math.nan, math.inf, -math.inf, 1e300, -1e9, 0.0, 1e-300, 3.0])
@pytest.mark.parametrize("place", range(5))
def test_wild_seeds_and_reaches_as_without_a_compiler(kernel: RimKernel, place: int, wild: float) -> None:
    image, _ = shot(np.random.default_rng(8))
    fields = [60.0, 50.0, 30.0, 28.0, 0.4]
    fields[place] = wild
    for reach in (6.0, wild):
        mine, plain = both(kernel, image, Ellipse(*fields), reach, False)
        assert (mine is None) == (plain is None)
        assert mine is None or plain is None or numbers(mine) == pytest.approx(numbers(plain), rel=0, abs=1e-6)


def test_nothing_in_pictures_without_a_rim(kernel: RimKernel) -> None:
    for level in (0, 128, 255):
        image = np.full((90, 80, 3), level, np.uint8)
        assert kernel.refine(image, Ellipse(40.0, 45.0, 20.0, 20.0, 0.0), 4.0, False) is None


def disc_picture(width: int = 160) -> tuple[Image, Ellipse]:
    seed = Ellipse(70.3, 75.6, 48.0, 45.0, 0.6)
    image = np.full((150, width, 3), (120, 128, 122), np.uint8)
    cv2.ellipse(image, (70, 76), (48, 45), math.degrees(0.6), 0, 360, (40, 45, 190), -1, cv2.LINE_AA)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.9), np.uint8), seed


def test_windows_and_pictures_upside_down_are_read_where_they_lie(kernel: RimKernel) -> None:
    image, seed = disc_picture()
    window = image[3:140, 5:150]
    assert not window.flags.c_contiguous
    for view in (window, image[::-1]):
        mine, plain = both(kernel, view, seed, 8.0, False)
        assert mine is not None
        assert plain is not None
        assert numbers(mine) == pytest.approx(numbers(plain), rel=0, abs=1e-6)


def test_a_picture_whose_pixels_lie_apart_is_left_to_numpy(kernel: RimKernel, monkeypatch: pytest.MonkeyPatch) -> None:
    image, seed = disc_picture()
    apart = np.repeat(image, 2, axis=1)[:, ::2]
    monkeypatch.setattr(refinement, "compiled_kernel", lambda: kernel)
    assert refine(apart, seed, 8.0) == refine_plain(image, seed, 8.0)
    assert fall(apart, seed, 0.25) == fall_plain(image, seed, 0.25)


def test_more_kinds_of_blur_than_are_kept(kernel: RimKernel, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.vision.detect.robust.kernel.rim_kernel._PROFILES", 2)
    small = load(library)
    assert small is not None
    for image, seed, reach, opponent in cases(40):
        arguments = (image, seed, reach, opponent)
        assert small.refine(*arguments) == kernel.refine(*arguments)


# -- what the kernel repeats of OpenCV --------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.one_interpreter
def test_red_against_green_is_opencvs_for_all_colours() -> None:
    linear, root, weights = lab.linear().astype(np.int64), lab.root().astype(np.int64), lab.weights()
    green, blue = np.meshgrid(np.arange(256), np.arange(256))
    for red in range(256):
        image = np.dstack([blue, green, np.full_like(blue, red)]).astype(np.uint8)
        lights = np.stack([linear[np.full_like(blue, red)], linear[green], linear[blue]])
        x, y = (root[(np.tensordot(row, lights, 1) + 2048) >> 12] for row in weights)
        a = (500 * (x - y) + (128 << 15) + (1 << 14)) >> 15
        assert np.array_equal(a, cv2.cvtColor(image, cv2.COLOR_BGR2Lab)[..., 1]), red
