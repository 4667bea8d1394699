"""The exact search, frame after frame: near the marker's last place first, and all the rest of the frame bit by bit.

Guaranteed for every frame:

- The circle is always that of a complete component of the plain pipeline's mask of *this* frame that passes all gates:
  a component is taken from the window only if it lies so far inside that the window's edges can't have changed it.
  Else, and where the window has none, the full frame is searched in the same frame. NO_TARGET is reported
  only after a search of the full frame.
- Every field but `candidates` (those of the window) and `stage_ns` is the plain pipeline's, unless a component that is
  as large or larger and passes the gates lies elsewhere. Such a one is detected in the ROUND-th frame after it
  appeared, at the latest, if it is there that long; then the full frame is searched.

How the second is kept: each frame a share of 1/ROUND of the grid is scanned, so that all of it is covered
after ROUND frames. A red point that the last search of the full frame did not have nearby requires another
one. Points that it had lie in *zones*, a step of the grid wider than they were. What stays inside a
zone is not larger than its box. While that is less than the marker, no zone can hide a rival; else, and where something
that the window cuts is close to the marker, the full frame is searched every ROUND frames.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from gateway.config import VisionConfig
from gateway.core.detection import Detection
from gateway.vision.detect.method import Detector, NowNs, Search
from gateway.vision.detect.paper import pipeline, stages
from gateway.vision.detect.paper.exact import kernel as compiled
from gateway.vision.detect.paper.exact.geometry import Box
from gateway.vision.detect.paper.exact.grid import ScanGrid
from gateway.vision.detect.paper.exact.kernel import Kernel
from gateway.vision.detect.paper.exact.search import ExactSearch, Found, extent, in_plain_order, packed
from gateway.vision.detect.paper.stages import Mask
from gateway.vision.detect.stage_timer import StageTimer, total_ns
from gateway.vision.pixels import Image, check_bgr8

ROUND = 8  # frames in which every grid point is scanned
SLACK_PX = 4  # the window extends so much farther than the marker is expected,
SLACK_ERRORS = 3  # and so many times as far as it was off the last time
LONGEST_LEAP = 4.0  # frames may be so many times as far apart as before; a guess beyond is none


@dataclass(frozen=True, slots=True)
class TrackedMarker:
    """Where the chosen contour was."""

    box: Box
    t_ns: int
    error_px: int  # how far its box was from where it was expected


@dataclass(frozen=True, slots=True)
class OtherRed:
    """What the last search of a full frame saw besides the marker."""

    unknown: Mask  # (rows, columns) uint8, 255 where a red grid point would be new
    largest_px2: int  # no zone can hold a larger contour


class ExactTracker:
    """A Detector with a memory. For one sequence of frames."""

    def __init__(self, params: VisionConfig, now_ns: NowNs = lambda: 0, *, kernel: Kernel) -> None:
        """`kernel`: of these very parameters."""
        self.search = ExactSearch(params, now_ns, kernel=kernel)
        self._params = params
        self._now_ns = now_ns
        self._marker: TrackedMarker | None = None
        self._before: TrackedMarker | None = None
        self._others: OtherRed | None = None
        self._shape: tuple[int, ...] = ()
        self._turn = 0  # which share of the grid is next
        self._since_full = 0  # frames

    def __call__(self, image: Image, t_ns: int = 0) -> Detection:
        check_bgr8(image)
        image = packed(image)
        timer = StageTimer(self._now_ns)
        found = self._near(image, t_ns, timer.ended)
        spent = timer.stage_ns
        if found is not None:
            return replace(found, stage_ns=spent)
        full = self._full_search(image, t_ns)
        return replace(full, stage_ns=(("window", total_ns(spent)), *full.stage_ns)) if spent else full

    def _full_search(self, image: Image, t_ns: int) -> Detection:
        found = self.search.find(image)
        self._shape, self._since_full = image.shape, 0
        if found.chosen is None:
            self._marker = self._before = None
        else:
            own = extent(found.chosen)
            self._moved(own, t_ns)
            self._others = self._other_red(self.search.grid(image), found, own)
        return found.detection

    def _near(self, image: Image, t_ns: int, seen: pipeline.Seen) -> Detection | None:
        """The window's result; None where the full frame must be searched."""
        marker, others = self._marker, self._others
        if marker is None or others is None or image.shape != self._shape:
            return None
        height, width = image.shape[:2]
        opening = self.search.opening
        expected = self._expected(t_ns, width, height)
        window = expected.grown(SLACK_PX + SLACK_ERRORS * marker.error_px + opening.uncut_px, width, height)
        trusted = _trusted(window, opening.uncut_px, width, height)
        boxed = [(contour, extent(contour)) for contour in self.search.contours(image, window, 0.0)]
        uncut = [contour for contour, box in boxed if trusted.holds(box)]
        cut = [(contour, box) for contour, box in boxed if not trusted.holds(box)]
        seen("window", None)
        chosen, found = pipeline.conclude(in_plain_order(uncut), self._params, seen)
        if chosen is None or any(stages.contour_area(contour) >= found.area_px2 for contour, _ in cut):
            return None
        own = extent(chosen)
        near = own.grown(opening.side_px - 1, width, height)
        self._since_full += 1
        hidden = others.largest_px2 >= found.area_px2 or any(box.meets(near) for _, box in cut)
        due = hidden and self._since_full >= ROUND
        changed = due or self._new_red(image, near, others)
        seen("rescan", None)
        if changed:
            return None
        self._moved(own, t_ns, expected)
        return found

    def _new_red(self, image: Image, near: Box, others: OtherRed) -> bool:
        """Scan the next share of the grid: is there red that was not known, and is not the marker?"""
        grid = self.search.grid(image)
        count = len(grid.ys)
        first, end = count * self._turn // ROUND, count * (self._turn + 1) // ROUND
        self._turn = (self._turn + 1) % ROUND
        if first == end:
            return False
        fresh = grid.scan_rows(image, first, end)
        rows, columns = grid.inside(near)
        fresh[max(rows.start - first, 0) : max(rows.stop - first, 0), columns] = 0
        return bool(cv2.hasNonZero(cv2.bitwise_and(fresh, others.unknown[first:end])))

    def _expected(self, t_ns: int, width: int, height: int) -> Box:
        """Where the contour's box should be: each of its sides moves on as between the last two frames."""
        marker, before = self._marker, self._before
        assert marker is not None
        if before is None:
            return marker.box
        was, now, share = before.box, marker.box, _leap(before.t_ns, marker.t_ns, t_ns)

        def on(a: int, b: int, size: int) -> int:
            return min(max(round(b + (b - a) * share), 0), size)

        ahead = Box(
            on(was.x0, now.x0, width), on(was.y0, now.y0, height), on(was.x1, now.x1, width), on(was.y1, now.y1, height)
        )
        return ahead if ahead.x0 < ahead.x1 and ahead.y0 < ahead.y1 else now

    def _moved(self, box: Box, t_ns: int, expected: Box | None = None) -> None:
        error_px = 0 if expected is None else box.farthest_side(expected)
        self._before, self._marker = self._marker, TrackedMarker(box, t_ns, error_px)

    def _other_red(self, grid: ScanGrid, found: Found, own: Box) -> OtherRed:
        """All red grid points but the marker's own, and a step of the grid round each."""
        near = own.grown(self.search.opening.side_px - 1, grid.width, grid.height)
        rows, columns = grid.inside(near)
        others = found.cells.copy()
        others[rows, columns] = 0
        zones = np.asarray(cv2.dilate(others, np.ones((3, 3), np.uint8)), np.uint8)
        largest = max((box.largest_contour_px2 for box in grid.clusters(zones)), default=0)
        return OtherRed(np.where(zones, 0, 255).astype(np.uint8), largest)


def _leap(before_ns: int, now_ns: int, next_ns: int) -> float:
    """So many of the last interval lie between now and the next frame; 1 where the times are of no use."""
    share = (next_ns - now_ns) / (now_ns - before_ns) if now_ns > before_ns else 1.0
    return share if 0 < share <= LONGEST_LEAP else 1.0


def _trusted(window: Box, uncut_px: int, width: int, height: int) -> Box:
    """The part of a window where its own edges have changed nothing."""
    return Box(
        window.x0 + uncut_px if window.x0 else 0,
        window.y0 + uncut_px if window.y0 else 0,
        window.x1 - uncut_px if window.x1 < width else width,
        window.y1 - uncut_px if window.y1 < height else height,
    )


def detector(params: VisionConfig, now_ns: NowNs) -> Detector:
    """On full frames: by the shortcuts that change no bit, where there is a kernel; else the plain pipeline."""
    kernel = compiled.load(params)
    return pipeline.detector(params, now_ns) if kernel is None else ExactSearch(params, now_ns, kernel=kernel)


def tracked(params: VisionConfig, now_ns: NowNs) -> Search:
    """For a Follower, whose prediction it does not need: it keeps the marker's motion itself."""
    kernel = compiled.load(params)
    find = pipeline.detector(params, now_ns) if kernel is None else ExactTracker(params, now_ns, kernel=kernel)
    return lambda image, t_ns, *_: find(image, t_ns)
