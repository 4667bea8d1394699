"""The compiled decision that the air is clear is that of the estimate in NumPy."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway.vision.detect.robust.kernel.sparse_kernel import AirKernel
from gateway.vision.detect.robust.redness import PyramidLevel
from gateway.vision.detect.robust.veil import estimate, less_veil, load
from gateway.vision.pixels import Image
from tests.examples import examples


@pytest.fixture(scope="module")
def kernel(library: Path) -> AirKernel:
    loaded = load(library)
    assert loaded is not None
    return loaded


def picture(chance: np.random.Generator) -> Image:
    """Of any size and tint, partly behind a veil of any thickness."""
    height, width = (int(side) for side in chance.integers(1 if chance.random() < 0.1 else 8, 161, 2))
    light = (
        chance.uniform(10, 250, 3) if chance.random() < 0.3 else chance.uniform(10, 250) * chance.uniform(0.9, 1.1, 3)
    )
    clear = np.asarray(cv2.resize(chance.uniform(0, 1, (7, 9)), (width, height)))[..., None] * light
    share = np.asarray(cv2.resize(chance.uniform(0, 1, (2, 3)) ** chance.choice([0.05, 0.3, 1]), (width, height)))[
        ..., None
    ]
    seen = (1 - share) * clear + share * light + chance.normal(0, 2, (height, width, 3))
    return np.asarray(np.clip(np.rint(seen), 0, 255), np.uint8)


@pytest.mark.one_interpreter
@pytest.mark.long
def test_clear_air_is_what_the_estimate_says(kernel: AirKernel) -> None:
    chance = np.random.default_rng(21)
    clear = veiled = 0
    for _ in range(examples(1000)):
        image = picture(chance)
        none = estimate(image) is None
        assert kernel.is_clear(image) == none, image.shape
        clear, veiled = clear + none, veiled + (not none)
    assert min(clear, veiled) > examples(1000) / 10


def test_every_so_many_pixels_are_a_picture_too(kernel: AirKernel) -> None:
    chance = np.random.default_rng(23)
    for every in (1, 2, 3, 5):
        for _ in range(examples(15)):
            image = np.repeat(np.repeat(picture(chance)[:, ::-1], every, axis=0), every, axis=1)
            image[1::every, 1::every] = 0  # none of those that count, unless all do
            cut = image[: image.shape[0] - every // 2, : image.shape[1] - every // 2]
            assert kernel.is_clear(cut, every) == (estimate(cut[::every, ::every].copy()) is None), (every, cut.shape)


def test_clear_air_of_a_large_picture_needs_no_estimate(kernel: AirKernel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.vision.detect.robust.veil.compiled_kernel", lambda: kernel)
    monkeypatch.setattr("gateway.vision.detect.robust.veil.estimate", lambda _: pytest.fail("estimated"))
    levels = [PyramidLevel(np.zeros((480, 640, 3), np.uint8), 1)]
    assert less_veil(levels) is levels


def test_opencvs_mean_of_nine_is_a_whole_number_rounded() -> None:
    for total in range(9 * 255 + 1):
        nine = np.full(9, total // 9)
        nine[: total % 9] += 1
        patch = np.pad(nine.reshape(3, 3).astype(np.uint8), 2, mode="edge")
        assert np.asarray(cv2.blur(patch, (3, 3)))[3, 3] == (2 * total + 9) // 18
