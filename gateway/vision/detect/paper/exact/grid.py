"""Which points of a grid may lie in red that survives the opening, and how they cluster. Pure."""

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.vision.detect.paper import stages
from gateway.vision.detect.paper.exact.geometry import Box, Opening
from gateway.vision.detect.paper.exact.kernel import Kernel
from gateway.vision.detect.paper.stages import Mask
from gateway.vision.pixels import Image

Axis = NDArray[np.int32]  # ascending pixel indices
SMALLEST_PYRAMID_PX = 8  # below, nothing is gained, and pyrDown's own border rules would have to be thought of


class Scanner(Protocol):
    """Samples the points of a grid."""

    step_px: int

    def axis(self, size: int) -> Axis:
        """Rows or columns of the grid where the picture has `size`: `step_px` apart, the last may be less."""
        ...

    def __call__(self, image: Image, ys: Axis, xs: Axis) -> Mask:
        """(len(ys), len(xs)) uint8, not 0 where a box of the opening may lie on the point. `ys`, `xs`: neighbouring
        members of the axes."""
        ...


class KernelScanner:
    """Runs of red on every K-th row, in the compiled loop."""

    def __init__(self, kernel: Kernel, opening: Opening) -> None:
        self._kernel = kernel
        self.step_px = opening.side_px

    def axis(self, size: int) -> Axis:
        return _axis(size, size - 1, self.step_px)

    def __call__(self, image: Image, ys: Axis, xs: Axis) -> Mask:
        return self._kernel.scan(image, ys, xs, self.step_px)


class PyramidScanner:
    """Red points where `pyrDown` puts them: it is the paper's Gaussian, computed at even rows and columns only."""

    def __init__(self, params: VisionConfig, opening: Opening) -> None:
        self._params = params
        self.step_px = 2 if opening.side_px < 4 else 4  # a box of 3 may lie between every fourth
        self._blur = BlurScanner(params, opening)

    @staticmethod
    def supports(params: VisionConfig) -> bool:
        return params.gaussian_kernel_px == 5 and not params.gaussian_sigma_px

    def axis(self, size: int) -> Axis:
        return _axis(size, (size - 1) // 2 * 2, self.step_px)

    def __call__(self, image: Image, ys: Axis, xs: Axis) -> Mask:
        # The grid's rows and two on either side, which the blur needs; `top` is even as all rows of the grid are.
        top, bottom = max(0, int(ys[0]) - 2), min(image.shape[0], int(ys[-1]) + 3)
        band = image[top:bottom]
        if min(band.shape[:2]) < SMALLEST_PYRAMID_PX:
            return self._blur(image, ys, xs)
        half = np.asarray(cv2.pyrDown(band), np.uint8)
        rows = half[(ys - top) // 2]
        points = rows if self.step_px == 2 else _every_second_column(rows)
        left = int(np.searchsorted(self.axis(image.shape[1]), xs[0]))
        points = points[:, left : left + len(xs)]
        return stages.red(points, self._params)


class BlurScanner:
    """Red points of a blur of any kind."""

    def __init__(self, params: VisionConfig, opening: Opening) -> None:
        self._params = params
        self.step_px = opening.side_px

    def axis(self, size: int) -> Axis:
        return _axis(size, size - 1, self.step_px)

    def __call__(self, image: Image, ys: Axis, xs: Axis) -> Mask:
        halo = self._params.gaussian_kernel_px // 2
        top, bottom = max(0, int(ys[0]) - halo), min(image.shape[0], int(ys[-1]) + halo + 1)
        blurred = stages.gaussian(image[top:bottom], self._params.gaussian_kernel_px, self._params.gaussian_sigma_px)
        return stages.red(blurred[ys - top][:, xs], self._params)


def scanner(params: VisionConfig, opening: Opening, kernel: Kernel | None) -> Scanner:
    """The fastest that supports the blur of these parameters."""
    if kernel is not None:
        return KernelScanner(kernel, opening)
    return PyramidScanner(params, opening) if PyramidScanner.supports(params) else BlurScanner(params, opening)


class ScanGrid:
    """The grid of pictures of one size."""

    def __init__(self, scan: Scanner, opening: Opening, width: int, height: int) -> None:
        self._scan = scan
        self._opening = opening
        self.width, self.height = width, height
        self.ys, self.xs = scan.axis(height), scan.axis(width)
        # Points that are 3 K - 2 apart, proof 3, are so many rows or columns apart, where the last step may be short.
        self.reach = (3 * opening.side_px - 3) // scan.step_px + 1
        self._link = np.ones((self.reach, self.reach), np.uint8)

    def scan(self, image: Image) -> Mask:
        """All of it; not 0: may be red that survives."""
        return self._scan(image, self.ys, self.xs)

    def scan_rows(self, image: Image, first: int, end: int) -> Mask:
        """Some rows of it."""
        return self._scan(image, self.ys[first:end], self.xs)

    def inside(self, box: Box) -> tuple[slice, slice]:
        """Rows and columns of the points in a box of the picture."""
        step = self._scan.step_px  # only the last step may be shorter
        return (
            slice(-(-box.y0 // step), len(self.ys) if box.y1 > self.ys[-1] else -(-box.y1 // step)),
            slice(-(-box.x0 // step), len(self.xs) if box.x1 > self.xs[-1] else -(-box.x1 // step)),
        )

    def clusters(self, cells: Mask) -> list[Box]:
        """What each cluster can reach in the picture, px. Clusters inside a hole of another are left to its box."""
        x, y, columns, rows = cv2.boundingRect(cells)
        if not columns:
            return []
        # Every point spreads up and to the left over `reach - 1`: then those at most `reach` apart touch.
        left, top = max(0, x - self.reach + 1), max(0, y - self.reach + 1)
        part = cells[top : y + rows, left : x + columns]
        linked = cv2.dilate(part, self._link, anchor=(0, 0)) if self.reach > 1 else part
        found, _ = cv2.findContours(linked, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(left, top))
        return [self._reached(cv2.boundingRect(contour)) for contour in found]

    def _reached(self, rect: tuple[int, int, int, int] | object) -> Box:
        x, y, columns, rows = rect  # type: ignore[misc]  # OpenCV's stubs: a sequence of int
        spread = self.reach - 1
        x0 = self.xs[x + spread if x else 0]  # at the edge, the spread may have been cut
        y0 = self.ys[y + spread if y else 0]
        x1, y1 = self.xs[x + columns - 1], self.ys[y + rows - 1]
        return self._opening.cluster_box(Box(int(x0), int(y0), int(x1) + 1, int(y1) + 1), self.width, self.height)


def _axis(size: int, last: int, step: int) -> Axis:
    at = np.arange(0, size, step, dtype=np.int32)
    if at[-1] > last:
        at = at[:-1]
    return at if at[-1] == last else np.append(at, np.int32(last))


def _every_second_column(rows: Image) -> Image:
    """Columns 0, 2, 4, ... and the last. A nearest-neighbour resize is five times as fast as numpy's stepping."""
    width = rows.shape[1]
    even = rows[:, : width // 2 * 2]
    picked = cv2.resize(even, (width // 2, rows.shape[0]), interpolation=cv2.INTER_NEAREST)
    return np.concatenate([np.asarray(picked, np.uint8), rows[:, -1:]], axis=1)
