"""Which points of a grid may lie in red that survives the opening, and how they cluster. Pure."""

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.detect.paper.exact.geometry import Box, Opening
from gateway.vision.detect.paper.exact.kernel import Kernel
from gateway.vision.detect.paper.stages import Mask
from gateway.vision.pixels import Image

Axis = NDArray[np.int32]  # ascending pixel indices
# Points that are 3 K - 2 apart, proof 3, are so many rows or columns apart, where the last step may be short.
REACH = 3
LINK = np.ones((REACH, REACH), np.uint8)


class ScanGrid:
    """The grid of pictures of one size."""

    def __init__(self, kernel: Kernel, opening: Opening, width: int, height: int) -> None:
        self._kernel = kernel
        self._opening = opening
        self.width, self.height = width, height
        self.ys, self.xs = _axis(height, opening.side_px), _axis(width, opening.side_px)
        self._rows_px, self._columns_px = self.ys.tolist(), self.xs.tolist()

    def scan(self, image: Image) -> Mask:
        """All of it; not 0: may be red that survives."""
        return self._kernel.scan(image, self.ys, self.xs, self._opening.side_px)

    def scan_rows(self, image: Image, first: int, end: int) -> Mask:
        """Some rows of it."""
        return self._kernel.scan(image, self.ys[first:end], self.xs, self._opening.side_px)

    def inside(self, box: Box) -> tuple[slice, slice]:
        """Rows and columns of the points in a box of the picture."""
        step = self._opening.side_px  # only the last step may be shorter
        return (
            slice(-(-box.y0 // step), len(self.ys) if box.y1 > self.ys[-1] else -(-box.y1 // step)),
            slice(-(-box.x0 // step), len(self.xs) if box.x1 > self.xs[-1] else -(-box.x1 // step)),
        )

    def clusters(self, cells: Mask) -> list[Box]:
        """What each cluster can reach in the picture, px. Clusters inside a hole of another are left to its box."""
        x, y, columns, rows = cv2.boundingRect(cells)
        if not columns:
            return []
        # Every point spreads up and to the left over `REACH - 1`: then those at most `REACH` apart touch.
        left, top = max(0, x - REACH + 1), max(0, y - REACH + 1)
        part = cells[top : y + rows, left : x + columns]
        linked = cv2.dilate(part, LINK, anchor=(0, 0))
        found, _ = cv2.findContours(linked, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(left, top))
        return [self._reached(cv2.boundingRect(contour)) for contour in found]

    def _reached(self, rect: tuple[int, int, int, int] | object) -> Box:
        x, y, columns, rows = rect  # type: ignore[misc]  # OpenCV's stubs: a sequence of int
        spread = REACH - 1
        x0 = self._columns_px[x + spread if x else 0]  # at the edge, the spread may have been cut
        y0 = self._rows_px[y + spread if y else 0]
        x1, y1 = self._columns_px[x + columns - 1], self._rows_px[y + rows - 1]
        return self._opening.cluster_box(Box(x0, y0, x1 + 1, y1 + 1), self.width, self.height)


def _axis(size: int, step: int) -> Axis:
    """Every `step`-th row or column, and the last."""
    at = np.arange(0, size, step, dtype=np.int32)
    return at if at[-1] == size - 1 else np.append(at, np.int32(size - 1))
