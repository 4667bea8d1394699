"""Smaller pictures, in C. Pure. Reference: `redness.reduced_plain`."""

import ctypes

import numpy as np

from gateway.vision.pixels import Image

LARGEST_FACTOR = 256  # the sum of a column of so many pixels has 16 bits

_Pointer, _Int = ctypes.c_void_p, ctypes.c_int64


class LevelKernel:
    """The compiled reductions. May be called from any thread."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._halved = library.gateway_halved
        self._halved.argtypes = [_Pointer, _Pointer]
        self._reduced = library.gateway_reduced
        self._reduced.argtypes = [_Pointer, _Int, _Pointer, _Pointer]
        self._halved.restype = self._reduced.restype = None

    def reduced(self, picture: Image, by: int) -> Image:
        """By 2 to LARGEST_FACTOR; for a picture of `by` x `by` px at least whose pixels lie side by side."""
        height, width = picture.shape[:2]
        out = np.empty((height // by, width // by, 3), np.uint8)
        described = (_Int * 4)(picture.ctypes.data, picture.strides[0], height, width)
        if by == 2:
            self._halved(ctypes.addressof(described), out.ctypes.data)
        else:
            sums = np.empty(3 * width, np.uint16)
            self._reduced(ctypes.addressof(described), by, sums.ctypes.data, out.ctypes.data)
        return out
