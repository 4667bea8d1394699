"""Is there something red in the picture that wasn't there a moment ago? A cheap check of a sparse picture. Pure."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle
from gateway.vision.compiled import library as compiled
from gateway.vision.compiled.build import LIBRARY
from gateway.vision.detect.robust import constants
from gateway.vision.detect.robust.candidates import red_plane
from gateway.vision.detect.robust.kernel.sparse_kernel import RegionKernel
from gateway.vision.detect.robust.redness import PyramidLevel
from gateway.vision.detect.robust.veil import less_veil
from gateway.vision.pixels import Pixels, adjacent, grey_levels

SPARSE_PX = 400  # diagonal of the sparse picture
OWN = 1.25  # what lies within so many radii of what is followed is part of it
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
    kernel = compiled_kernel()
    if kernel is None or not adjacent(image):
        return red_regions_plain(image, followed)
    step = sparse_step(image)
    found = kernel.regions(image, step, *disc_of(followed, step))
    return red_regions_plain(image, followed) if found is None else RedRegions(*found)


def red_regions_plain(image: Pixels, followed: Circle) -> RedRegions:
    """`red_regions` by NumPy and OpenCV."""
    step = sparse_step(image)
    sparse: Pixels = image[step // 2 :: step, step // 2 :: step].copy()
    (level,) = less_veil([PyramidLevel(grey_levels(sparse), step)])
    red = cv2.blur(red_plane(level), (3, 3))
    (u, v), inner_px, outer_px = disc_of(followed, step)
    y, x = np.ogrid[: red.shape[0], : red.shape[1]]
    distance2 = (x - u) ** 2 + (y - v) ** 2
    redness_of_it = float(cv2.mean(red, (distance2 <= inner_px * (inner_px + 1)).astype(np.uint8))[0])
    red[distance2 <= outer_px * (outer_px + 1)] = 0.0
    # Paint redder than FULL_REDNESS is no better evidence for a marker, so it sets no higher bar for others either.
    bar = max(constants.LEAST_RED, constants.AS_RED * min(constants.FULL_REDNESS, redness_of_it))
    mask = (red > bar).astype(np.uint8)
    faint = int(np.count_nonzero(red > constants.LEAST_RED)) >= constants.SMALLEST_REGION_PX
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    kept = stats[1:][stats[1:, cv2.CC_STAT_AREA] >= constants.SMALLEST_REGION_PX]
    boxes = np.column_stack([kept[:, 0], kept[:, 1], kept[:, 0] + kept[:, 2], kept[:, 1] + kept[:, 3]])
    return RedRegions(boxes.astype(np.int32), faint)


def sparse_step(image: Pixels) -> int:
    """Every so many pixels of each row and column are looked at."""
    height, width = (int(side) for side in image.shape[:2])
    return max(1, min(int(np.hypot(height, width) // SPARSE_PX), height, width))


def disc_of(followed: Circle, step: int) -> tuple[tuple[int, int], int, int]:
    """Its centre in the sparse picture, a radius that is surely it, and one beyond which nothing of it is."""
    at, radius = sparse_place(followed, step)
    return at, max(1, round(0.7 * radius)), round(OWN * radius) + 1


def sparse_place(circle: Circle, step: int) -> tuple[tuple[int, int], float]:
    """Centre and radius in a picture of every `step`-th pixel from the middle of the first step on."""
    far = 1e6  # OpenCV draws with 32 bit
    u, v = (min(max((at - step // 2) / step, -far), far) for at in (circle.u_px, circle.v_px))
    return (round(u), round(v)), min(circle.radius_px / step, far)


def load(library: Path = LIBRARY) -> RegionKernel | None:
    """The compiled check; None where there is none, or one that differs (logged)."""
    return compiled.load(RegionKernel, agrees, red_regions_plain, library)


compiled_kernel = lru_cache(maxsize=1)(load)


def agrees(kernel: RegionKernel) -> bool:
    """On red spots of all sizes in noise, for something followed inside the picture, at its edge and out of it."""
    chance = np.random.default_rng(12)
    for size in ((300, 420, 3), (500, 700, 3)):
        picture = chance.integers(0, 140, size, np.uint8)
        for n in range(40):
            u, v = (int(at) for at in chance.integers(0, 500, 2))
            cv2.circle(picture, (u, v), 2 + n % 9, (45.0, 40.0, 90.0 + 3 * n), -1)
        for followed in (Circle(200.0, 150.0, 40.0), Circle(415.0, 3.0, 25.0), Circle(-900.0, 40.0, 3.0)):
            step = sparse_step(picture)
            found = kernel.regions(picture, step, *disc_of(followed, step))
            if found is None or not alike(RedRegions(*found), red_regions_plain(picture, followed)):
                return False
    return True


def alike(some: RedRegions, others: RedRegions) -> bool:
    """The same boxes in any order, and the same faintness."""
    return sorted(some.boxes.tolist()) == sorted(others.boxes.tolist()) and some.faint == others.faint
