"""Behind thick dust, frames of a truck that stands are summed where one alone shows no marker. Pure.

The noise of a mean of N frames is that of one by the square root of N; the dust's veil stays. Only frames that follow
each other closely count, within SPAN_NS, so that the result is fresh: it is as old as the oldest of them. What is found
must have stood still in each of them (`standing`). All else is as with one frame: the same search, the same gates.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from gateway.config import VisionConfig
from gateway.core.detection import Detection, Ellipse, Rejection
from gateway.vision.compiled.sizes import MOST_VEIL_SIDE
from gateway.vision.detect.method import NowNs, Search, TimedPicture
from gateway.vision.detect.robust import candidates, measurement, red_change, redness, refinement, veil
from gateway.vision.detect.robust.roi_search import RoiSearch
from gateway.vision.detect.robust.standing import evenly_lit, stood_still
from gateway.vision.detect.robust.veil import estimate
from gateway.vision.detect.stage_timer import total_ns
from gateway.vision.pixels import Colours, GreyLevels, Pixels, grey_levels
from gateway.vision.track.kalman_filter import Prediction

SPAN_NS = 120_000_000  # from the oldest frame to the newest; a third of the usual `fusion.vision_deadline_s`
EVEN_GAPS = 1.5  # the longest gap between two of them, of the shortest
THICK = 0.8  # median share of airlight from which on
LASTING_NS = 2_000_000_000  # frames are kept for this time after one that showed no marker behind so much
MOVED = "moved"  # the rejection code of a disc that did not stand still


class SummingSearch:
    """A `Search`: another one's result and, where that is none, the one for the mean of the newest frames."""

    def __init__(self, search: Search, frames: int) -> None:
        self._search = search
        self._most = frames
        self._recent: Sequence[TimedPicture] = ()
        self._until_ns = 0
        self._next_ns = 0  # after a sum in vain: further ones would be of the same frames

    def recent(self, frames: Sequence[TimedPicture]) -> None:
        self._recent = frames

    def keeps(self, t_ns: int) -> int:
        return self._most if 0 < self._until_ns - t_ns <= LASTING_NS else 1

    def __call__(
        self,
        image: Pixels,
        t_ns: int,
        expected: Prediction | None,
        radii_px: tuple[float, float] | None = None,
    ) -> Detection:
        found = self._search(image, t_ns, expected, radii_px)  # type: ignore[arg-type]
        recent, self._recent = self._recent, ()
        if found.circle is not None or self._most < 2 or not _thick(image):
            return found
        self._until_ns = t_ns + LASTING_NS
        frames = suitable(recent[-self._most :])
        if len(frames) < 2 or frames[-1].t_ns != t_ns or 0 < self._next_ns - t_ns <= SPAN_NS:
            return found
        summed = self._summed(frames, t_ns, expected, radii_px)
        if summed.circle is None:
            self._next_ns = t_ns + SPAN_NS
            refused = [entry for entry in summed.rejected if entry.why == MOVED]
            return replace(found, rejected=(*refused, *found.rejected))
        return replace(summed, stage_ns=(("single", total_ns(found.stage_ns)), *summed.stage_ns))

    def _summed(
        self,
        frames: Sequence[TimedPicture],
        t_ns: int,
        expected: Prediction | None,
        radii_px: tuple[float, float] | None,
    ) -> Detection:
        pictures = [grey_levels(frame.picture) for frame in frames]
        mean = mean_of(pictures)
        if not evenly_lit(pictures, mean):
            return Detection(None)
        found = self._search(mean, t_ns, expected, radii_px)  # type: ignore[arg-type]
        if found.circle is None:
            return found
        c = found.circle
        disc = found.ellipse or Ellipse(c.u_px, c.v_px, c.radius_px, c.radius_px, 0.0)
        if stood_still(pictures, mean, disc):
            return replace(found, frames=len(frames))
        return Detection(None, rejected=(Rejection(c, MOVED),))


def suitable(recent: Sequence[TimedPicture]) -> Sequence[TimedPicture]:
    """The newest of these that follow each other closely and evenly, and are of one size; at least the newest."""
    kept = list(recent[-1:])
    shortest = longest = 0
    for frame in reversed(recent[:-1]):
        gap = kept[0].t_ns - frame.t_ns
        shortest, longest = min(gap, shortest or gap), max(gap, longest)
        span = kept[-1].t_ns - frame.t_ns
        alike = frame.picture.shape == kept[0].picture.shape and frame.picture.dtype == kept[0].picture.dtype
        if gap <= 0 or span > SPAN_NS or longest > EVEN_GAPS * shortest or not alike:
            break
        kept.insert(0, frame)
    return kept


def mean_of(pictures: Sequence[Colours]) -> GreyLevels:
    total = np.zeros(pictures[0].shape, np.float32)
    for picture in pictures:
        cv2.accumulate(picture, total)
    return np.asarray(total / np.float32(len(pictures)), np.float32)


def _thick(image: Pixels) -> bool:
    step = max(1, -(-max(image.shape[:2]) // MOST_VEIL_SIDE))
    size = (max(1, image.shape[1] // step), max(1, image.shape[0] // step))
    small: Pixels = cv2.resize(image, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    found = estimate(grey_levels(small))
    return found is not None and float(np.median(found.share)) >= THICK


def search(params: VisionConfig, now_ns: NowNs) -> SummingSearch:
    """The robust method's, frame after frame. Its kernels are loaded and compared now: that takes longer than a first
    frame may."""
    for module in (candidates, measurement, red_change, redness, refinement, veil):
        module.compiled_kernel()
    return SummingSearch(RoiSearch(params, now_ns), params.sum_frames)
