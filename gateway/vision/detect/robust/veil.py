"""Dust between camera and scene: the light that it adds, estimated place by place and subtracted. Pure.

A pixel behind a veil is I = (1 - a) J + a A: J without the veil, A the airlight, a the veil's share. The darkest
channel of the darkest thing near a place bounds a A from above (dark channel prior, He et al. 2009). What is left after
a A is subtracted is (1 - a) J: the ratio of its channels is that of J, while the camera's noise is what it was. So
redness with the same k (`redness.DARK`) is at once relative to what the veil leaves and to the noise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.compiled import library as compiled
from gateway.vision.compiled.build import LIBRARY
from gateway.vision.compiled.sizes import MOST_VEIL_SIDE, VEIL_CELLS
from gateway.vision.detect.robust import constants
from gateway.vision.detect.robust.kernel.sparse_kernel import AirKernel, VeilLight
from gateway.vision.detect.robust.redness import DARK, Plane, PyramidLevel
from gateway.vision.pixels import Colours, Image, adjacent

FULL = 0.75  # darkest share near a place: above, all of the veil is subtracted
KEPT = 0.98  # of the estimate: it is an upper bound
NEARLY_ALL, BRIGHT_GREY, MOST_GAIN = 0.995, 200.0, 8.0  # of what is left: this quantile becomes that grey level
PAINT = (190.0, 45.0)  # R and G of red paint in clear air, grey levels


@dataclass(frozen=True, slots=True)
class Veil:
    """On a coarse grid over the picture."""

    share: Plane  # (rows, columns), 0 to 1: of the airlight; 0 in clear air
    airlight: tuple[float, float, float]  # BGR grey levels


def estimate(picture: Colours) -> Veil | None:
    """The veil over a (H, W, 3) BGR picture, of MOST_VEIL_SIDE at most; None in clear air and in the dark."""
    height, width = picture.shape[:2]
    if min(height, width) < 8:
        return None
    airlight = np.array([_quantile(picture, channel) for channel in range(3)], np.float32)
    if airlight.min() < constants.DARKEST_AIRLIGHT or airlight[1] > constants.MOST_GREEN * max(
        airlight[0], airlight[2]
    ):
        return None
    soft = cv2.blur(picture, (3, 3)).astype(np.float32)
    soft /= airlight
    least = np.asarray(cv2.min(cv2.min(soft[..., 0], soft[..., 1]), soft[..., 2]))
    cell = max(1.0, max(height, width) / VEIL_CELLS)
    rows, columns = max(1, round(height / cell)), max(1, round(width / cell))
    y, x = (np.linspace(0, side, n, endpoint=False).astype(int) for side, n in ((height, rows), (width, columns)))
    local = np.minimum.reduceat(np.minimum.reduceat(least, y, axis=0), x, axis=1)
    near = np.asarray(cv2.erode(local, np.ones((3, 3), np.uint8)))
    trust = np.clip((near - constants.NO_VEIL) / (FULL - constants.NO_VEIL), 0, 1)
    if np.count_nonzero(trust) < constants.LEAST_PART * trust.size:
        return None
    smooth = np.asarray(cv2.GaussianBlur(np.minimum(local, 1), (3, 3), 0.7, borderType=cv2.BORDER_REPLICATE))
    share = KEPT * smooth * trust
    blue, green, red = (float(value) for value in airlight)
    return Veil(np.asarray(share, np.float32), (blue, green, red))


def _quantile(picture: Colours, channel: int) -> float:
    if picture.dtype == np.float32:
        return float(np.quantile(picture[..., channel], constants.BRIGHT))
    counts = cv2.calcHist([picture], [channel], None, [256], [0, 256]).ravel()
    return float(np.searchsorted(np.cumsum(counts), constants.BRIGHT * counts.sum()))


def _coarse(pictures: Sequence[Colours]) -> Colours:
    """Of a pyramid: the finest one that is no larger than what a veil is estimated on."""
    return next((one for one in pictures if max(one.shape[:2]) <= MOST_VEIL_SIDE), pictures[-1])


def unveiled(levels: Sequence[PyramidLevel], veil: Veil) -> list[PyramidLevel]:
    """Each level less the veil's light, not below 0; those of 8 bits in 8 bits, times the `gain` that uses them."""
    if levels[0].bgr.dtype != np.uint8:
        deep = ((_left(level.bgr, veil), level) for level in levels)
        return [replace(level, bgr=bgr, veil=veil.share, airlight=veil.airlight) for bgr, level in deep]
    gain = _gain(_left(_coarse([level.bgr for level in levels]), veil))
    kernel = compiled_kernel()
    eight_bits = (
        kernel.unveiled(level.bgr, light_over(level.bgr, veil), gain)
        if kernel is not None and adjacent(level.bgr)
        else unveiled_plain(level.bgr, veil, gain)
        for level in levels
    )
    return [
        replace(level, bgr=bgr, veil=veil.share, gain=gain, airlight=veil.airlight)
        for bgr, level in zip(eight_bits, levels, strict=True)
    ]


def unveiled_plain(picture: Colours, veil: Veil, gain: float) -> Image:
    return np.asarray(cv2.convertScaleAbs(_left(picture, veil), alpha=gain), np.uint8)


def _left(picture: Colours, veil: Veil) -> Plane:
    rows, above, below, share = light_over(picture, veil)
    lower = share[:, None, None]
    return np.maximum(picture - (rows[above] * (1 - lower) + rows[below] * lower), 0)


def light_over(picture: Colours, veil: Veil) -> VeilLight:
    """The veil's light between the middles of its cells. Not OpenCV's, whose last bits depend on the processor."""
    light = veil.share[..., None] * np.array(veil.airlight, np.float32)
    above, below, lower = _between(picture.shape[0], light.shape[0])
    left, right, beyond = _between(picture.shape[1], light.shape[1])
    beyond = beyond[:, None]
    rows = light.take(left, axis=1) * (1 - beyond) + light.take(right, axis=1) * beyond
    return VeilLight(rows, above, below, lower)


@lru_cache(maxsize=64)
def _between(size: int, cells: int) -> tuple[NDArray[np.int32], NDArray[np.int32], Plane]:
    """For each pixel: the cells whose middles it lies between, and the share of the second."""
    at = np.clip((np.arange(size) + 0.5) * cells / size - 0.5, 0, cells - 1)
    low = at.astype(np.int32)
    return low, np.minimum(low + 1, cells - 1), (at - low).astype(np.float32)


def _gain(left: Plane) -> float:
    """A power of the root of 2, 1 to MOST_GAIN: few differ, since each has a table of logarithms."""
    bright = float(np.quantile(left, NEARLY_ALL))
    steps = math.floor(2 * math.log2(min(MOST_GAIN, max(1.0, BRIGHT_GREY / max(bright, 1.0)))))
    return float(2 ** (steps / 2))


def contrast_left(share: float) -> float:
    """1 in clear air: how much of the redness of paint is left behind a veil, against `DARK`."""
    red, green = PAINT
    left = 1 - share
    return math.log((red * left + DARK) / (green * left + DARK)) / math.log((red + DARK) / (green + DARK))


def over(levels: Sequence[PyramidLevel]) -> Veil | None:
    """The veil over a picture; None in clear air and in the dark."""
    coarse = _coarse([level.bgr for level in levels])
    sparse = -(-max(coarse.shape[:2]) // MOST_VEIL_SIDE)  # of a picture without a pyramid
    kernel = compiled_kernel()
    if kernel is not None and adjacent(coarse) and kernel.is_clear(coarse, sparse):
        return None
    return estimate(coarse[::sparse, ::sparse].copy())


def less_veil(levels: list[PyramidLevel]) -> list[PyramidLevel]:
    """Each level less the veil over it; in clear air the levels themselves."""
    veil = over(levels)
    return levels if veil is None else unveiled(levels, veil)


def load(library: Path = LIBRARY) -> AirKernel | None:
    """The compiled decision on clear air; None where there is none, or one that differs (logged)."""
    return compiled.load(AirKernel, agrees, estimate, library)


compiled_kernel = lru_cache(maxsize=1)(load)


def agrees(kernel: AirKernel) -> bool:
    """On grey noise from clear air to thick dust: the same decision, and the same picture less the veil."""
    chance = np.random.default_rng(9)
    for dark in range(40, 70, 3):
        picture = chance.integers(2 * dark, 200, (60, 80, 3), np.uint8)
        veil = estimate(picture)
        if kernel.is_clear(picture) != (veil is None):
            return False
        if veil is not None:
            mine = kernel.unveiled(picture, light_over(picture, veil), 2.0)
            if not np.array_equal(mine, unveiled_plain(picture, veil, 2.0)):
                return False
    return True
