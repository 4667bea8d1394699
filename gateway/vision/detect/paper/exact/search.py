"""The paper's method on full frames, as `pipeline.detect` has it, with a close search only where red can survive.

Every field of the Detection is the plain pipeline's, `candidates` too: all clusters that can hold a candidate are
processed, not only the largest, which costs little. `stage_ns` has other names.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from gateway.config import VisionConfig
from gateway.core.detection import Detection
from gateway.vision.detect.method import NowNs
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.paper.exact.geometry import Box, Opening
from gateway.vision.detect.paper.exact.grid import ScanGrid
from gateway.vision.detect.paper.exact.kernel import Kernel
from gateway.vision.detect.paper.stages import Contour, Mask
from gateway.vision.detect.stage_timer import StageTimer
from gateway.vision.pixels import Image, check_bgr8

FEW = 10  # boxes are compared one by one in less time than numpy's calls take
WINDOW_COST_PX = 20_000  # what a further window costs, in processed pixels: the price of some ten calls
JOINED_PX = 10_000  # so many more are processed rather than a window of their own


@dataclass(frozen=True, slots=True)
class Found:
    """Of one search of a full frame."""

    detection: Detection
    cells: Mask  # the grid
    chosen: Contour | None


class ExactSearch:
    """A Detector; keeps nothing from picture to picture but its tables."""

    def __init__(self, params: VisionConfig, now_ns: NowNs = lambda: 0, *, kernel: Kernel) -> None:
        """`kernel`: of these very parameters."""
        self.params = params
        self.opening = Opening.of(params)
        self._now_ns = now_ns
        self._kernel = kernel
        self._grid: ScanGrid | None = None

    def __call__(self, image: Image, t_ns: int = 0) -> Detection:
        return self.find(image).detection

    def find(self, image: Image) -> Found:
        check_bgr8(image)
        image = packed(image)
        timer = StageTimer(self._now_ns)
        grid = self.grid(image)
        cells = grid.scan(image)
        timer.ended("scan")
        borders = self._borders(image, grid, cells)
        timer.ended("look")
        chosen, detection = pipeline.conclude(borders, self.params, timer.ended)
        return Found(replace(detection, stage_ns=timer.stage_ns), cells, chosen)

    def grid(self, image: Image) -> ScanGrid:
        height, width = image.shape[:2]
        if self._grid is None or (self._grid.width, self._grid.height) != (width, height):
            self._grid = ScanGrid(self._kernel, self.opening, width, height)
        return self._grid

    def contours(self, image: Image, window: Box, min_area_px2: float) -> list[Contour]:
        """As `stages.contours`, in the picture's coordinates; only those of more than `min_area_px2`."""
        mask = self._kernel.cleaned(image, window, self.opening.side_px)
        found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(window.x0, window.y0))
        return [np.asarray(contour, np.int32) for contour in found if cv2.contourArea(contour) > min_area_px2]

    def _borders(self, image: Image, grid: ScanGrid, cells: Mask) -> list[Contour]:
        """All contours of more than S_min, in the order in which the plain pipeline has them."""
        height, width = image.shape[:2]
        s_min = self.params.min_area_px2
        clusters = [box for box in grid.clusters(cells) if box.largest_contour_px2 > s_min]
        affordable_px = width * height + WINDOW_COST_PX
        if len(clusters) * WINDOW_COST_PX > affordable_px:
            return self.contours(image, Box(0, 0, width, height), s_min)
        merged = _apart(clusters, self.opening, width, height)
        windows = [self.opening.window(box, width, height) for box in merged]
        if sum(window.pixels + WINDOW_COST_PX for window in windows) > affordable_px:
            return self.contours(image, Box(0, 0, width, height), s_min)
        found = [
            contour
            for box, window in zip(merged, windows, strict=True)
            for contour in self.contours(image, window, s_min)
            if box.holds(extent(contour))  # else a part of another cluster, cut by the window
        ]
        return in_plain_order(found)


def packed(image: Image) -> Image:
    """The picture itself, or a copy where its rows are not as a camera leaves them: 3 bytes a pixel, without gaps."""
    return image if image.strides[1:] == (3, 1) and image.strides[0] > 0 else np.ascontiguousarray(image)


def in_plain_order(found: list[Contour]) -> list[Contour]:
    """As OpenCV lists those of a full frame: a contour begins with its first pixel, and the last one is listed
    first."""
    return sorted(found, key=lambda contour: (int(contour[0, 0, 1]), int(contour[0, 0, 0])), reverse=True)


def _apart(boxes: list[Box], opening: Opening, width: int, height: int) -> list[Box]:
    """Boxes whose windows meet are joined, until none do; a few also where one window costs less than two."""
    margin = opening.reach_px + 1
    if len(boxes) <= FEW:
        return _few_apart(boxes, 2 * margin, width, height)
    at = np.array([(box.x0, box.y0, -box.x1, -box.y1) for box in boxes], np.int64).reshape(-1, 4)
    while len(at) > 1:
        low, high = at[:, :2] - margin, -at[:, 2:] + margin  # not cut to the picture: that changes no meeting inside it
        meets = np.all((low[:, None] < high[None]) & (low[None] < high[:, None]), axis=2)
        first = np.argmax(meets, axis=1)  # the first that each one meets, itself at the latest
        if np.array_equal(first, np.arange(len(at))):
            break
        joined = at.copy()
        np.minimum.at(joined, first, at)
        at = joined[np.unique(first)]
    return [Box(int(x0), int(y0), int(-x1), int(-y1)) for x0, y0, x1, y1 in at]


def _few_apart(boxes: list[Box], gap_px: int, width: int, height: int) -> list[Box]:
    apart: list[Box] = []
    while boxes:
        *boxes, box = boxes
        round_it = box.grown(gap_px, width, height)
        for other in apart:
            both = box.joined(other)
            if round_it.meets(other) or both.pixels <= box.pixels + other.pixels + JOINED_PX:
                apart.remove(other)
                boxes.append(both)
                break
        else:
            apart.append(box)
    return apart


def extent(contour: Contour) -> Box:
    """The box round all its pixels."""
    x, y, width, height = (int(value) for value in cv2.boundingRect(contour))
    return Box(x, y, x + width, y + height)
