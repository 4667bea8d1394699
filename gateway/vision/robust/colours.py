"""The rim of a candidate, measured in the colours in which it is clearest. Pure."""

from dataclasses import replace
from math import ceil, floor

import cv2
import numpy as np

from gateway.model import Ellipse
from gateway.vision.pixels import Image
from gateway.vision.robust.rim import Rim, refine

GOOD = 0.6  # quality from which on nothing better is looked for
SEARCH_PX, SEARCH = (
    3.0,
    0.08,
)  # how far the rim may be from where the evidence saw it; the latter of its semi-minor axis
AROUND = 1.4  # of the semi-major axis: part of the picture that is looked at


def roundness(rim: Rim) -> float:
    """1 where all edges lie on the ellipse; a half where they scatter by 1 % of it and half a pixel (small: 3 %)."""
    size_px = rim.ellipse.semi_minor_px
    return 1 / (1 + (rim.rms_px / (min(0.5, 0.03 * size_px) + 0.01 * size_px)) ** 2)


def quality(rim: Rim) -> float:
    """0 to 1: how much of the rim in the picture is an edge, and how well these edges lie on one ellipse."""
    return rim.support * roundness(rim)


def clearest_rim(image: Image, seed: Ellipse, reach_px: float = 0.0) -> Rim | None:
    """The rim near `seed` by all colours or, where these are at odds, by red less green alone, whichever is better.

    All colours together measure best. But a thin white line round the disc, as on a road sign, is a second edge a few
    pixels farther out, and so is a highlight or a bright edge behind: all these are grey, and vanish in R - G.
    `reach_px`: how far off the seed's rim may be, if that is more than usual.
    """
    search_px = max(reach_px, SEARCH_PX, SEARCH * seed.semi_minor_px)
    rim = refine(image, seed, search_px=search_px)
    if rim is not None and quality(rim) >= GOOD:
        return rim
    reach = AROUND * seed.semi_major_px + 2 * search_px + 8
    height, width = image.shape[:2]
    x0, y0 = max(0, floor(seed.u_px - reach)), max(0, floor(seed.v_px - reach))
    x1, y1 = min(width, ceil(seed.u_px + reach) + 1), min(height, ceil(seed.v_px + reach) + 1)
    if x1 <= x0 or y1 <= y0:
        return rim
    near = image[y0:y1, x0:x1]
    red = np.asarray(cv2.cvtColor(cv2.subtract(near[..., 2], near[..., 1]), cv2.COLOR_GRAY2BGR), np.uint8)
    other = refine(red, replace(seed, u_px=seed.u_px - x0, v_px=seed.v_px - y0), search_px=search_px)
    if other is None or (rim is not None and quality(other) <= quality(rim)):
        return rim
    e = other.ellipse
    return replace(other, ellipse=replace(e, u_px=e.u_px + x0, v_px=e.v_px + y0))
