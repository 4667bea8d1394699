"""What is red, in the two forms that `red.h` reads: tables of all colours, and bounds that settle most of them. Pure.

OpenCV's rounding is not reproduced here. Tables and bounds are both taken from its own conversion; the kernel compares
them on all 2^24 colours before the bounds are used, and where they don't describe the ranges (those that let in yellow,
say) only the tables are used.
"""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.vision.detect.paper import stages

LARGEST_FACTOR = 127  # signed bytes
LARGEST_GREEN = 31  # five binary places
NEVER = 32767  # no number of a bound is so large: 255 * 127 = 32385
HUE_OF_60_DEGREES = 30

Flags = NDArray[np.bool_]
Rule = NDArray[np.int32]


def tables(params: VisionConfig) -> NDArray[np.uint8]:
    """What equations 2 to 4 make of each of the 2^24 colours: bits of pairs (g, r), 8 KB, then bits of colours, index
    b + 256 g + 65536 r, 2 MB. Takes 0.1 s."""
    plane = np.empty((256, 256, 3), np.uint8)
    plane[..., 0] = np.arange(256, dtype=np.uint8)[None, :]
    plane[..., 1] = np.arange(256, dtype=np.uint8)[:, None]
    table = np.empty((256, 256 * 256 // 8), np.uint8)
    for r in range(256):
        plane[..., 2] = r
        table[r] = np.packbits(stages.red(plane, params).ravel(), bitorder="little")
    pairs = np.packbits(table.reshape(65536, 32).any(axis=1), bitorder="little")
    return np.concatenate([pairs, table.ravel()])


def rule(params: VisionConfig) -> Rule:
    """The `Rule` of `red.h`, with `wide` 0: whether it holds is decided by the kernel; and `green` 0. (15,) int32.

    Each bound is the ideal one's ratio, in factors of a byte, with what OpenCV's rounding makes of the colours nearest
    to it on either side.
    """
    saturation, value = params.red_low_1[1], params.red_low_1[2]
    d, x = np.meshgrid(np.arange(256), np.arange(256), indexing="ij")
    may = d <= x
    grey = np.where(may, x - d, 0)
    lively = _hsv(grey, grey, x)[..., 1] >= saturation
    on_s = _bound(Fraction(2 * saturation - 1, 510), d[may], x[may], lively[may])

    may = x <= d
    low, between = 255 - d, np.where(may, 255 - d + x, 0)
    h_1, h_2 = params.red_high_1[0], params.red_low_2[0]
    on_hue = []
    for blue, green, width in ((low, between, h_1), (between, low, max(180 - h_2, 0))):
        hue = _hsv(blue, green, np.full_like(d, 255))[..., 0]
        inside = (hue <= h_1) | (hue >= h_2)
        on_hue.append(_bound(Fraction(2 * HUE_OF_60_DEGREES, 2 * width + 1), d[may], x[may], inside[may]))
    return np.array([0, value, *on_s, *on_hue[0], *on_hue[1], 0], np.int32)


def green(both: NDArray[np.uint8]) -> int:
    """The k of `maybe.h`, from `tables`: the smallest with 32 g <= k r + 26 for every red colour, 1 to 31; 0: none."""
    pairs = np.unpackbits(both[: 256 * 256 // 8], bitorder="little").reshape(256, 256)
    r, g = (axis.astype(np.int64) for axis in np.nonzero(pairs))
    excess = 32 * g - 26
    if np.any((r == 0) & (excess > 0)):
        return 0
    k = int(np.max(-(-excess // np.maximum(r, 1)), initial=1))
    return max(k, 1) if k <= LARGEST_GREEN else 0


def _bound(ratio: Fraction, d: NDArray[np.int64], x: NDArray[np.int64], inside: Flags) -> tuple[int, int, int, int]:
    """q, p, maybe, sure of `red.h`, where about d >= ratio x is `inside`."""
    if ratio <= 1:
        near = ratio.limit_denominator(LARGEST_FACTOR)
        p, q = near.numerator, near.denominator
    else:
        near = (1 / ratio).limit_denominator(LARGEST_FACTOR)
        p, q = near.denominator, near.numerator
    p, q = max(p, 1), max(q, 1)
    f = q * d - p * x
    maybe = int(f[inside].min(initial=NEVER))
    sure = int(f[~inside].max(initial=-NEVER)) + 1
    return q, p, maybe, max(maybe, sure)


def _hsv(blue: NDArray[np.int64], green: NDArray[np.int64], red: NDArray[np.int64]) -> NDArray[np.uint8]:
    return stages.bgr_to_hsv(np.dstack([blue, green, red]).astype(np.uint8))
