"""a* of CIE Lab from 8-bit BGR by tables of whole numbers: OpenCV's to the last bit for all 2^24 colours. Pure.

Source: ITU-R BT.709 primaries, D65 white, sRGB's curve, CIE 1976; OpenCV rounds each step to 12 or 15 bits.
"""

import numpy as np
from numpy.typing import NDArray

_PRIMARIES = np.array([[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169]])  # R, G, B to X and Y
_WHITE = np.array([[0.950456], [1.0]])
PER_GREY = 8  # steps of linear light to a grey level
_ROOT_BITS, _WEIGHT_BITS = 15, 12


def weights() -> NDArray[np.int64]:
    """(2, 3): of R, G and B in X and Y over those of white, 4096ths."""
    return np.asarray(np.rint((1 << _WEIGHT_BITS) * _PRIMARIES / _WHITE), np.int64)


def linear() -> NDArray[np.uint16]:
    """(256,): linear light by the stored value."""
    x = np.arange(256) / 255
    light = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(255 * PER_GREY * light), np.uint16)


def root() -> NDArray[np.uint16]:
    """(n,): CIE's f, a cube root, of linear light from 0 to white, and somewhat beyond."""
    single = np.float32
    x = (single(1) / single(255 * PER_GREY) * np.arange(255 * PER_GREY + 9).astype(single)).astype(np.float64)
    # OpenCV cuts its root off to single precision.
    cut = (np.cbrt(x).view(np.uint64) >> np.uint64(29) << np.uint64(29)).view(np.float64)
    return np.asarray(np.rint((1 << _ROOT_BITS) * np.where(x < 216 / 24389, x * 841 / 108 + 16 / 116, cut)), np.uint16)
