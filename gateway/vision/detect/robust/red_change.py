"""Is there something red in the picture that wasn't there a moment ago? A cheap check of a sparse picture. Pure."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle
from gateway.vision.detect.robust.candidates import red_plane
from gateway.vision.detect.robust.decision import FULL_REDNESS
from gateway.vision.detect.robust.redness import PyramidLevel
from gateway.vision.detect.robust.veil import less_veil
from gateway.vision.pixels import Pixels, grey_levels

SPARSE_PX = 400  # diagonal of the sparse picture
LEAST_RED = 0.15  # log(R/G): a marker behind much dust still has this
AS_RED = 0.5  # what appears is new if it is at least so red, compared with what is followed
OWN = 1.25  # what lies within so many radii of what is followed is part of it
SMALLEST_PX = 12  # smallest area of a red spot in the sparse picture that counts: a disc of radius 2
GROWN_PX = 6  # a known spot may have moved so far in the sparse picture since the last check


@dataclass(frozen=True, slots=True)
class RedRegions:
    """Boxes round red spots in the sparse picture, (n, 4) int32: x0, y0, x1, y1, the last two beyond it."""

    boxes: NDArray[np.int32]
    faint: bool = False  # there is anything red at all, even if it is much less red than what is followed

    def new_since(self, before: "RedRegions") -> bool:
        """Is there a spot that is none of those before, grown, shrunk or moved a little?"""
        x0, y0, x1, y1 = (self.boxes[:, None, k] for k in range(4))
        was_x0, was_y0, was_x1, was_y1 = (before.boxes[None, :, k] for k in range(4))
        meet = (x0 < was_x1 + GROWN_PX) & (was_x0 - GROWN_PX < x1) & (y0 < was_y1 + GROWN_PX) & (was_y0 - GROWN_PX < y1)
        return bool((~meet.any(axis=1)).any())


def red_regions(image: Pixels, followed: Circle) -> RedRegions:
    """The red spots of a (H, W, 3) BGR picture that are not `followed` itself."""
    height, width = image.shape[:2]
    step = max(1, min(int(np.hypot(height, width) // SPARSE_PX), height, width))
    sparse: Pixels = image[step // 2 :: step, step // 2 :: step].copy()
    (level,) = less_veil([PyramidLevel(grey_levels(sparse), step)])
    red = cv2.blur(red_plane(level), (3, 3))
    at, radius = sparse_place(followed, step)
    inside = np.zeros(red.shape, np.uint8)
    cv2.circle(inside, at, max(1, round(0.7 * radius)), 255, -1)
    redness_of_it = float(cv2.mean(red, inside)[0])
    cv2.circle(red, at, round(OWN * radius) + 1, 0.0, -1)
    # Paint redder than FULL_REDNESS is no better evidence for a marker, so it sets no higher bar for others either.
    mask = (red > max(LEAST_RED, AS_RED * min(FULL_REDNESS, redness_of_it))).astype(np.uint8)
    faint = int(np.count_nonzero(red > LEAST_RED)) >= SMALLEST_PX
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    kept = stats[1:][stats[1:, cv2.CC_STAT_AREA] >= SMALLEST_PX]
    boxes = np.column_stack([kept[:, 0], kept[:, 1], kept[:, 0] + kept[:, 2], kept[:, 1] + kept[:, 3]])
    return RedRegions(boxes.astype(np.int32), faint)


def sparse_place(circle: Circle, step: int) -> tuple[tuple[int, int], float]:
    """Centre and radius in a picture of every `step`-th pixel from the middle of the first step on."""
    far = 1e6  # OpenCV draws with 32 bit
    u, v = (min(max((at - step // 2) / step, -far), far) for at in (circle.u_px, circle.v_px))
    return (round(u), round(v)), min(circle.radius_px / step, far)
