"""The compiled loops, where they were built: loaded, checked against OpenCV, and offered as three functions.

A library that is missing, stale, for another machine, or wrong in a single bit is not used; nothing else changes.
"""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.vision.compiled import library as compiled
from gateway.vision.compiled.build import LIBRARY
from gateway.vision.compiled.sizes import CHUNK_PX, HALO_PX
from gateway.vision.detect.paper import stages
from gateway.vision.detect.paper.exact import red
from gateway.vision.detect.paper.exact.geometry import Box, Opening
from gateway.vision.detect.paper.stages import Mask
from gateway.vision.pixels import Image

MAYBE_KERNEL_PX = 5  # of `maybe.h`
# Half of the kernel of OpenCV's 8-bit Gaussian with sigma 0, from the middle, in 16ths. Larger ones are left to it.
WEIGHTS: dict[int, tuple[int, int, int]] = {1: (16, 0, 0), 3: (8, 4, 0), 5: (6, 4, 1)}
# Of the opening. Without one every red pixel survives: there is nothing to be gained. The closing of 31, 61 px, still
# fits the words of 64.
SMALLEST_SIDE_PX, LARGEST_SIDE_PX = 3, 31
_POINTER, _SIZE = ctypes.c_void_p, ctypes.c_ssize_t


class Kernel:
    """The loops for one set of parameters. Not for two threads at once: the scratch memory is shared."""

    def __init__(self, library: ctypes.CDLL, params: VisionConfig) -> None:
        self._scan, self._mask, self._clean = library.gateway_scan, library.gateway_mask, library.gateway_clean
        picture: list[Any] = [_POINTER, _SIZE, _SIZE, _SIZE]
        loops: list[Any] = [_POINTER] * 6
        self._scan.argtypes = [*picture, _POINTER, _SIZE, _POINTER, _SIZE, _SIZE, *loops]
        self._mask.argtypes = [*picture, *[_SIZE] * 4, *loops]
        self._clean.argtypes = [*picture, *[_SIZE] * 5, *loops, _POINTER]
        self._scan.restype = self._mask.restype = self._clean.restype = None
        self._sheets = np.empty(0, np.uint64)
        self._sheets_at = 0
        self._weights = np.array(WEIGHTS[params.gaussian_kernel_px], np.uint16)
        self._tables = red.tables(params)
        self._rule = red.rule(params)
        self._constants = (self._weights.ctypes.data, self._rule.ctypes.data, self._tables.ctypes.data)
        self._rule[0] = 1
        library.gateway_disagreements.argtypes = [_POINTER, _POINTER]
        library.gateway_disagreements.restype = ctypes.c_uint32
        self._rule[0] = library.gateway_disagreements(*self._constants[1:]) == 0  # else only the tables are used
        if params.gaussian_kernel_px == MAYBE_KERNEL_PX:
            self._rule[-1] = red.green(self._tables)
        self._sums = np.empty(0, np.uint16)
        self._row = np.empty(0, np.uint8)
        self._width = 0
        self._scratch = (0, 0)

    @property
    def bounded(self) -> bool:
        """Whether bounds settle most colours, so that the tables are read for few."""
        return bool(self._rule[0])

    def scan(self, image: Image, ys: NDArray[np.int32], xs: NDArray[np.int32], side_px: int) -> Mask:
        """(len(ys), len(xs)) uint8: 1 where a grid point lies in a run of red that a box may have (1)."""
        height, width = image.shape[:2]
        cells = np.empty((len(ys), len(xs)), np.uint8)
        self._make_room(width)
        where = (ys.ctypes.data, len(ys), xs.ctypes.data, len(xs), side_px)
        self._scan(
            image.ctypes.data, image.strides[0], height, width, *where, *self._constants, *self._scratch,
            cells.ctypes.data,
        )  # fmt: skip
        return cells

    def mask(self, image: Image, window: Box) -> Mask:
        """Equations 1 to 4 in a window of the picture."""
        height, width = image.shape[:2]
        mask = np.empty((window.y1 - window.y0, window.x1 - window.x0), np.uint8)
        self._make_room(width)
        self._mask(
            image.ctypes.data, image.strides[0], height, width, window.x0, window.y0, window.x1, window.y1,
            *self._constants, *self._scratch, mask.ctypes.data,
        )  # fmt: skip
        return mask

    def cleaned(self, image: Image, window: Box, side_px: int) -> Mask:
        """M_c in the window, where the opening amounts to a square of `side_px`. Exact for
        components as far inside as `geometry` requires."""
        height, width = image.shape[:2]
        columns, rows = window.x1 - window.x0, window.y1 - window.y0
        mask = np.empty((rows, columns), np.uint8)
        self._make_room(width)
        pad = side_px // 2 * 2
        pitch = (columns + 2 * pad + 63) // 64
        need = 2 * pitch * (rows + 2 * pad) + 3 * pitch + 2
        if self._sheets.size < need:
            self._sheets = np.empty(need, np.uint64)
            self._sheets_at = self._sheets.ctypes.data
        self._clean(
            image.ctypes.data, image.strides[0], height, width, window.x0, window.y0, window.x1, window.y1, side_px,
            *self._constants, *self._scratch, self._sheets_at, mask.ctypes.data,
        )  # fmt: skip
        return mask

    def _make_room(self, width: int) -> None:
        if self._width < width:
            self._sums = np.empty(3 * (width + 2 * HALO_PX), np.uint16)
            self._row = np.empty(4 * width + 1 + -(-width // CHUNK_PX), np.uint8)
            self._width = width
            self._scratch = (self._sums.ctypes.data, self._row.ctypes.data)


def load(params: VisionConfig, library: Path = LIBRARY) -> Kernel | None:
    """None where there is none or one of another source, and for a blur or an opening that it doesn't support."""
    if params.gaussian_sigma_px or params.gaussian_kernel_px not in WEIGHTS:
        return None
    if not SMALLEST_SIDE_PX <= Opening.of(params).side_px <= LARGEST_SIDE_PX:
        return None
    return compiled.load(
        lambda loaded: Kernel(loaded, params), lambda kernel: _agrees(kernel, params), stages.red, library
    )


def _agrees(kernel: Kernel, params: VisionConfig) -> bool:
    """On a small picture of every kind of colour, near red above all."""
    chance = np.random.default_rng(4)
    image = chance.integers(0, 256, (48, 67, 3), dtype=np.uint8)
    image[10:40, 8:60] = np.clip(chance.normal((70, 60, 150), (30, 30, 50), (30, 52, 3)), 0, 255).astype(np.uint8)
    blurred = stages.gaussian(image, params.gaussian_kernel_px)
    plain = stages.red(blurred, params)
    return bool(np.array_equal(plain, kernel.mask(image, Box(0, 0, 67, 48))))
