"""The robust search that knows where to look first, and searches the whole frame when that is not enough.

Every measurement comes out of the same evidence, the same gates and the same refinement at full resolution, whether
the search was in a window or in the whole frame; the window only leaves out candidates that lie elsewhere. So that a
track can't hold on to a wrong thing, those are heard again and again:

- every CONTEST frames the whole frame is searched once more, reduced to about REDUCED_PX of diagonal. Whatever it takes
  for the marker in another place calls for a search of the whole frame at full resolution, in the same frame;
- every WHOLE frames that search comes anyway: for a rival too small to be seen in the reduced picture;
- it comes at once when the window holds nothing, or nothing that the track's gate admits.

Where the two then disagree, the one with more evidence stands, as among the candidates of any search.
"""

import math
from dataclasses import replace

import cv2
import numpy as np

from gateway.config import VisionConfig
from gateway.model import Circle, Detection
from gateway.vision.pipeline import NowNs
from gateway.vision.pixels import Image
from gateway.vision.robust.detect import Window, detect
from gateway.vision.tracking import Prediction

CONTEST, WHOLE = 8, 64  # frames
REDUCED_PX = 400  # diagonal of the picture in which rivals are looked for
ROUND_RIM = 1.35  # the evidence looks at the surroundings, too: so many radii
SAME_PLACE = 0.5  # of two circles: their centres are closer than so many radii


class NearSearch:
    """A `follow.Search` that counts its frames."""

    def __init__(self, params: VisionConfig, now_ns: NowNs) -> None:
        self._params = params
        self._now_ns = now_ns
        self._near = 0  # frames in a row that were searched in a window

    def __call__(self, image: Image, t_ns: int, expected: Prediction | None) -> Detection:
        if expected is None:
            return self._whole(image)
        window = window_round(expected, image.shape[1], image.shape[0])
        found = detect(image, self._params, self._now_ns, window=window, expected=expected.circle)
        if found.circle is None or not expected.admits(found.circle):
            return self._also_whole(image, found)
        self._near += 1
        if self._near % WHOLE == 0:
            return self._also_whole(image, found)
        if self._near % CONTEST == 0:
            start_ns = self._now_ns()
            contested = self._rival(image, found.circle)
            found = replace(found, stage_ns=(*found.stage_ns, ("contest", self._now_ns() - start_ns)))
            if contested:
                return self._also_whole(image, found)
        return found

    def _whole(self, image: Image) -> Detection:
        self._near = 0
        return detect(image, self._params, self._now_ns)

    def _also_whole(self, image: Image, before: Detection) -> Detection:
        """`before`: what the window gave; its time is told, too."""
        whole = self._whole(image)
        spent_ns = sum(ns for _, ns in before.stage_ns)
        return replace(_better(whole, before), stage_ns=(("window", spent_ns), *whole.stage_ns))

    def _rival(self, image: Image, holder: Circle) -> bool:
        """Is something in another place taken for the marker when the whole frame is looked at coarsely?"""
        times = int(math.hypot(*image.shape[:2]) // REDUCED_PX)
        if times < 2:
            return True  # the whole frame itself is as small
        rival = detect(reduce(image, times), self._params).circle
        return rival is not None and not same_place(scaled(rival, times), holder)


def _better(whole: Detection, held: Detection) -> Detection:
    """The search of the whole frame may have overlooked what was found in the window; it passed the same gates."""
    if held.circle is None or (whole.circle is not None and same_place(whole.circle, held.circle)):
        return whole
    return whole if _rank(whole) >= _rank(held) else held


def _rank(found: Detection) -> float:
    """By this the search chooses among the candidates of one frame."""
    return 0.0 if found.circle is None else (found.confidence or 0.0) * found.circle.radius_px**0.3


def window_round(expected: Prediction, width: int, height: int) -> Window:
    """All that an admitted circle and its surroundings can cover, cut to the picture; at least one pixel."""
    half = expected.reach_px + ROUND_RIM * expected.largest_px + 2
    u, v = expected.circle.u_px, expected.circle.v_px
    x0, y0 = (min(max(0, math.floor(at - half)), size - 1) for at, size in ((u, width), (v, height)))
    x1, y1 = (max(min(math.ceil(at + half) + 1, size), low + 1) for at, size, low in ((u, width, x0), (v, height, y0)))
    return x0, y0, x1, y1


def reduce(image: Image, times: int) -> Image:
    """The picture with each side `times` as small: means of `times` x `times` pixels."""
    if times == 1:
        return image
    height, width = image.shape[0] // times, image.shape[1] // times
    part = image[: height * times, : width * times]
    return np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def scaled(circle: Circle, by: float) -> Circle:
    """The same circle in a picture that is `by` times as large; pixel centres lie at integers in both."""
    return Circle((circle.u_px + 0.5) * by - 0.5, (circle.v_px + 0.5) * by - 0.5, circle.radius_px * by)


def same_place(one: Circle, other: Circle) -> bool:
    apart = math.hypot(one.u_px - other.u_px, one.v_px - other.v_px)
    return apart < SAME_PLACE * max(one.radius_px, other.radius_px)
