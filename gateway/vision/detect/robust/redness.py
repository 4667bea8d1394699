"""How red a pixel is: log(R + k) - log(G + k), and the pyramid of reduced pictures for it.

A ratio, not a difference: light and shade on a ball change R and G by the same factor, so a dark red ball stands out
from bright brown wood (where R - G is the same) and its dark side from nothing. Wood, rust and skin have R/G of 1.2 to
1.9, red paint 2.5 and more. k keeps the noise of dark pixels down.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.pixels import Image

Plane = NDArray[np.float32]

DARK = 8.0  # k: about twice the read noise of a cheap camera, grey levels
LOG = np.log(np.arange(256, dtype=np.float32) + np.float32(DARK))


def redness(bgr: Image) -> Plane:
    """(..., 3) uint8 BGR to (...) float32: 0 for grey, 0.4 for wood, 1 and more for red, below 0 for green."""
    return np.asarray(LOG[bgr[..., 2]] - LOG[bgr[..., 1]], np.float32)


@dataclass(frozen=True, slots=True)
class PyramidLevel:
    """A reduced picture: its pixel (i, j) is the mean of a factor x factor square of the full one."""

    bgr: Image
    factor: int

    def to_full(self, px: float) -> float:
        """A coordinate of this level as one of the full frame; pixel centres lie at integers in both."""
        return px * self.factor + (self.factor - 1) / 2

    def to_level(self, px: float) -> float:
        return (px - (self.factor - 1) / 2) / self.factor


def pyramid(image: Image, first: int, smallest_side: int) -> list[PyramidLevel]:
    """Reduced by `first`, 2 `first`, 4 `first`, ... down to `smallest_side`. Rows and columns left over are cut off."""
    levels = [PyramidLevel(_reduced(image, first), first)]
    while min(levels[-1].bgr.shape[:2]) >= 2 * smallest_side:
        last = levels[-1]
        levels.append(PyramidLevel(_reduced(last.bgr, 2), last.factor * 2))
    return levels


def _reduced(image: Image, by: int) -> Image:
    if by == 1:
        return image
    height, width = (max(1, side // by) for side in image.shape[:2])
    cropped = image[: height * by, : width * by]
    return np.asarray(cv2.resize(cropped, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
