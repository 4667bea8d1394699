"""How red a pixel is: log(R + k) - log(G + k), and the pyramid of reduced pictures for it.

A ratio, not a difference: light and shade on a ball change R and G by the same factor, so a dark red ball stands out
from bright brown wood (where R - G is the same) and its dark side from nothing. Wood, rust and skin have R/G of 1.2 to
1.9, red paint 2.5 and more. k keeps the noise of dark pixels down.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.compiled import library as compiled
from gateway.vision.compiled.build import LIBRARY
from gateway.vision.detect.robust.kernel.level_kernel import LARGEST_FACTOR, LevelKernel
from gateway.vision.pixels import Colours, adjacent

Plane = NDArray[np.float32]
Light = tuple[float, float, float]  # BGR grey levels

BLACK: Light = (0.0, 0.0, 0.0)
DARK = 8.0  # k: about twice the read noise of a cheap camera, grey levels


@lru_cache(maxsize=64)
def log_table(gain: float) -> Plane:
    """(256,): of each 8-bit value that is a grey level times `gain`."""
    return np.asarray(np.log(np.arange(256, dtype=np.float32) / np.float32(gain) + np.float32(DARK)), np.float32)


LOG = log_table(1.0)


def redness(bgr: Colours, gain: float = 1.0) -> Plane:
    """(..., 3) BGR to (...) float32: 0 for grey, 0.4 for wood, 1 and more for red, below 0 for green.

    `gain`: what 8-bit values were multiplied by.
    """
    if bgr.dtype == np.uint8:
        log = LOG if gain == 1 else log_table(gain)
        return np.asarray(log[bgr[..., 2]] - log[bgr[..., 1]], np.float32)
    return np.asarray(np.log((bgr[..., 2] + np.float32(DARK)) / (bgr[..., 1] + np.float32(DARK))), np.float32)


@dataclass(frozen=True, slots=True)
class PyramidLevel:
    """A reduced picture: its pixel (i, j) is the mean of a factor x factor square of the full one."""

    bgr: Colours
    factor: int
    veil: Plane | None = None  # share of airlight on a coarse grid, where it has been subtracted
    gain: float = 1.0  # an 8-bit value is the grey level times this; that of all levels of a pyramid
    airlight: Light = BLACK  # of a full veil

    def veil_at(self, u_px: float, v_px: float) -> float:
        """Share of airlight that has been subtracted at a place of the full frame."""
        if self.veil is None:
            return 0.0
        (height, width), (rows, columns) = self.bgr.shape[:2], self.veil.shape
        row, column = int(self.to_level(v_px) / height * rows), int(self.to_level(u_px) / width * columns)
        return float(self.veil[min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)])

    def to_full(self, px: float) -> float:
        """A coordinate of this level as one of the full frame; pixel centres lie at integers in both."""
        return px * self.factor + (self.factor - 1) / 2

    def to_level(self, px: float) -> float:
        return (px - (self.factor - 1) / 2) / self.factor


def pyramid(image: Colours, first: int, smallest_side: int) -> list[PyramidLevel]:
    """Reduced by `first`, 2 `first`, 4 `first`, ... down to `smallest_side`. Rows and columns left over are cut off."""
    last = _reduced(image, first)
    levels = [PyramidLevel(last, first)]
    while min(last.shape[:2]) >= 2 * smallest_side:
        last = _reduced(last, 2)
        levels.append(PyramidLevel(last, levels[-1].factor * 2))
    return levels


def _reduced(image: Colours, by: int) -> Colours:
    if by == 1:
        return image
    kernel = compiled_kernel()
    if kernel is None or not by <= min(*image.shape[:2], LARGEST_FACTOR) or not adjacent(image):
        return reduced_plain(image, by)
    return kernel.reduced(image, by)


def reduced_plain(image: Colours, by: int) -> Colours:
    height, width = (max(1, side // by) for side in image.shape[:2])
    cropped = image[: height * by, : width * by]
    return cast("Colours", cv2.resize(cropped, (width, height), interpolation=cv2.INTER_AREA))


def load(library: Path = LIBRARY) -> LevelKernel | None:
    """The compiled reductions; None where there is none, or one that differs (logged)."""
    return compiled.load(LevelKernel, agrees, reduced_plain, library)


compiled_kernel = lru_cache(maxsize=1)(load)


def agrees(kernel: LevelKernel) -> bool:
    """On noise of odd and even sizes."""
    chance = np.random.default_rng(7)
    return all(
        np.array_equal(kernel.reduced(picture, by), reduced_plain(picture, by))
        for rows in range(2, 20)
        for picture in [chance.integers(0, 256, (rows, 2 * rows + 3, 3), np.uint8)]
        for by in range(2, rows + 1)
    )
