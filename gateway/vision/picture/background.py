"""Has the camera been moved? The fixed background compared with the one learned while no marker was in sight. Pure.

Six overlapping parts of the small picture are each matched by phase correlation. Half of them must be recognised, so a
truck that stands in the others does no harm. What is learned lives as long as the vision process.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.durations import NS_PER_S

PERIOD_NS = 2 * NS_PER_S
PART_PX, LEAST_PX = 64, 24  # side of a part; a smaller picture gives no result
LEAST_DEVIATION = 6.0  # grey levels: a picture that is dark, covered or full of dust gives no result
RECOGNISED = 0.4  # response of the phase correlation: another scene gives less, the same one up to 1
ENOUGH = 3  # of the six parts
LEARNED_FROM, STILL_PX = 5, 1.0  # so many pictures running, of which none has moved farther
FORGET_S = 60.0  # what was seen once and not again may have been a truck
TRUSTED_S = 1800.0  # what has been recognised for this time, or again after a visit, was none
LOST_S = 3600.0

Grey = NDArray[np.uint8]
Parts = list[NDArray[np.float32]]


@dataclass(slots=True)
class _Known:
    parts: Parts
    recognised_s: float = 0.0  # in all
    lost_s: float = 0.0  # since it was recognised last, while it could have been
    visited: bool = False  # a marker was in sight since it was learned
    trusted: bool = False


class Background:
    """Of one camera; small grey pictures of one size, in order."""

    def __init__(self) -> None:
        self._due_ns = 0
        self._learning: list[Parts] = []
        self._known: _Known | None = None

    def shift(self, grey: Grey, t_ns: int, *, marker: bool) -> float | None:
        """How far the background has moved, in px of `grey`; None: not due, or unknown.

        Half the width where nothing of it has been recognised for an hour: farther than can be measured.
        """
        if marker:
            self._learning = []
            if self._known is not None:
                self._known.visited = True
        if marker or 0 < self._due_ns - t_ns <= PERIOD_NS:
            return None
        self._due_ns = t_ns + PERIOD_NS
        if min(grey.shape) < LEAST_PX or float(grey.std()) < LEAST_DEVIATION:
            self._learning = []
            return None
        parts = _parts(grey)
        if self._known is None:
            self._learn(parts)
            return None
        moved_px = _moved_px(self._known.parts, parts, ENOUGH)
        if moved_px is None:
            moved_px = self._unrecognised(self._known, grey.shape[1] / 2)
        else:
            self._recognised(self._known)
        return moved_px

    def _learn(self, parts: Parts) -> None:
        if self._learning:
            moved_px = _moved_px(self._learning[0], parts, len(parts) - 1)
            if moved_px is None or moved_px > STILL_PX:
                self._learning = []
        self._learning.append(parts)
        if len(self._learning) == LEARNED_FROM:
            same = zip(*self._learning, strict=True)
            self._known = _Known([np.asarray(np.mean(part, axis=0), np.float32) for part in same])
            self._learning = []

    def _recognised(self, known: _Known) -> None:
        known.lost_s = 0.0
        known.recognised_s += PERIOD_NS / NS_PER_S
        known.trusted = known.trusted or known.visited or known.recognised_s >= TRUSTED_S

    def _unrecognised(self, known: _Known, beyond_px: float) -> float | None:
        known.lost_s += PERIOD_NS / NS_PER_S
        if known.lost_s >= FORGET_S and not known.trusted:
            self._known = None
        return beyond_px if known.lost_s >= LOST_S else None


def _parts(grey: Grey) -> Parts:
    """Two rows of three, which overlap or touch as the picture's size has it; each fades out towards its edges."""
    height, width = grey.shape
    side = min(PART_PX, height, width)
    corners = [(y, x) for y in (0, height - side) for x in (0, (width - side) // 2, width - side)]
    fade = np.asarray(cv2.createHanningWindow((side, side), cv2.CV_32F), np.float32)
    return [grey[y : y + side, x : x + side] * fade for y, x in corners]


def _moved_px(before: Parts, now: Parts, enough: int) -> float | None:
    """Median of how far the recognised parts have moved; None: fewer than `enough`. A zoom or a turn counts, too."""
    # Not with OpenCV's window argument: OpenCV applies it to what it is given, in place.
    found = [cv2.phaseCorrelate(one, other) for one, other in zip(before, now, strict=True)]
    moved_px = [math.hypot(*place) for place, response in found if response >= RECOGNISED]
    return float(np.median(moved_px)) if len(moved_px) >= enough else None
