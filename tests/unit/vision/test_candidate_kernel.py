"""The compiled loops over pixels, edges and cells give what the Python beside them gives."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway.vision.detect.robust import candidates
from gateway.vision.detect.robust.candidates import (
    RADII,
    SHARES,
    Peak,
    blur_weights,
    gradients,
    load,
    red_plane,
)
from gateway.vision.detect.robust.kernel.candidate_kernel import CandidateKernel
from gateway.vision.detect.robust.redness import Plane, PyramidLevel, redness
from tests.examples import examples
from tests.unit.vision.kernel_examples import plane

Planes = tuple[Plane, Plane, Plane, Plane]


@pytest.fixture(scope="module")
def kernel(library: Path) -> CandidateKernel:
    loaded = load(library)
    assert loaded is not None
    return loaded


def peaks(kernel: CandidateKernel, planes: Planes) -> list[Peak]:
    return kernel.votes(planes, RADII, blur_weights())


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_same_blobs_as_without_a_compiler(kernel: CandidateKernel) -> None:
    chance = np.random.default_rng(1)
    found = 0
    for _ in range(examples(400)):
        red, factor = plane(chance), int(chance.integers(1, 5))
        limits = float(chance.uniform(0, 6)), float(chance.choice([10, 60, 1000]))
        mine = kernel.blobs(red, SHARES, factor, limits)
        assert mine == candidates._blobs(red, factor, limits)
        found += len(mine)
    assert found > examples(400)


def test_blobs_that_grow_together_in_the_last_row_and_round_each_other(kernel: CandidateKernel) -> None:
    for drawing in (
        ["#.#.#", "#.#.#", "#####"], ["#####", "#.#.#", "#.#.#"], ["#####", "#...#", "#.#.#", "#...#", "#####"],
        ["#.....#", ".#...#.", "..#.#..", "...#..."], ["##..", "##..", "..##", "..##"], ["....", "....", "...#"],
    ):  # fmt: skip
        red = np.array([[float(mark == "#") for mark in row] for row in drawing], np.float32)
        everything: tuple[float, float] = (0.0, 99.0)
        mine = kernel.blobs(red, SHARES, 1, everything)
        assert mine == candidates._blobs(red, 1, everything)


@pytest.mark.parametrize("size", [1, 2, 3, 8, 9, 255, 4096, 4097])
def test_the_median_of_any_values(kernel: CandidateKernel, size: int) -> None:
    """By way of the thresholds: a blob is where the redness is over 0.15 of the way from the median to the most."""
    chance = np.random.default_rng(size)
    for values in (chance.normal(0, 1, size), chance.integers(-2, 3, size), chance.normal(0, 1e-3, size) - 2):
        red = np.append(values, 9.0).astype(np.float32)[None]
        for limits in ((0.0, 99.0), (0.5, 0.5)):
            assert kernel.blobs(red, SHARES, 1, limits) == candidates._blobs(red, 1, limits)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_same_votes_as_without_a_compiler(kernel: CandidateKernel) -> None:
    chance = np.random.default_rng(2)
    found = 0
    for _ in range(examples(300)):
        red = np.asarray(cv2.GaussianBlur(plane(chance), (5, 5), 1.0), np.float32)
        if min(red.shape) < 8:
            continue
        planes = gradients(red)
        mine, plain = peaks(kernel, planes), candidates._peaks(*planes)
        assert [peak[:3] for peak in mine] == [peak[:3] for peak in plain]
        assert [peak[3] for peak in mine] == pytest.approx([peak[3] for peak in plain], abs=1.1e-5)  # five digits
        found += len(mine)
    assert found > examples(300)


def test_a_symmetric_picture_has_its_peaks_in_the_same_order(kernel: CandidateKernel) -> None:
    tile = np.full((48, 80, 3), (120, 125, 122), np.uint8)
    cv2.circle(tile, (39, 23), 9, (40, 45, 190), -1)
    picture = np.tile(tile, (2, 2, 1))
    planes = gradients(np.asarray(cv2.GaussianBlur(redness(picture), (5, 5), 1.0), np.float32))
    mine = peaks(kernel, planes)
    assert mine == candidates._peaks(*planes)
    assert len({peak[3] for peak in mine[:4]}) < 4


def test_redness_of_windows_and_of_pictures_upside_down(
    kernel: CandidateKernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = np.random.default_rng(4).integers(0, 256, (50, 70, 3), np.uint8)
    for view in (picture, picture[3:40, 5:60], picture[::-1]):
        assert np.array_equal(kernel.redness(view), redness(view))
    monkeypatch.setattr(candidates, "compiled_kernel", lambda: kernel)
    apart = np.repeat(picture, 2, axis=1)[:, ::2]
    for other in (apart, picture.astype(np.float32)):
        assert np.array_equal(red_plane(PyramidLevel(other, 1)), redness(other))
