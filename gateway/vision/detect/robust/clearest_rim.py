"""The rim of a candidate, measured where it is clearest: in what colours, and behind a thick veil on what pixels.

All colours together measure best where the disc is of one colour and evenly lit. But a thin white line round the disc,
as on a road sign, is a second edge a few pixels farther out, and so is a highlight, a bright edge behind, a shadow
below: these are lighter or darker, but no redder, and vanish in Lab's a*.

The refinement decides ray by ray which edges count; behind 90 % dust a ray's edge is some ten grey levels high and the
noise two. Smoothing along and across the rim and the same gain for all channels lift the edges over its thresholds.
Neither moves the rim: the refinement corrects for blur. But it costs exactness (0.04 px became 0.1 px in the median),
so the pixels as they are come first.
"""

import math
from dataclasses import replace

import cv2
import numpy as np

from gateway.core.detection import Ellipse
from gateway.vision.compiled.sizes import SECTORS
from gateway.vision.detect.robust.refinement import fall, refine
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.pixels import Colours, Image

GOOD, EVEN_PX = 0.95, 0.05  # quality from which on, and `wave_px` up to which nothing better is searched for
BY_CHANCE = 1.3  # of the rms over a sector's edges: so much wave has a rim that is merely noisy
MOST, WELL = 0.6, 0.25  # of the total fall, so much is at the rim and not in creases; of the semi-minor axis
CLEARLY = 0.05  # more quality is required of red against green where all colours lie evenly on their ellipse
SEARCH_PX, SEARCH = 3.0, 0.08  # the rim is searched for so far off; the latter of its semi-minor axis
# Behind a veil, and in the dark.
FAINT = 0.6  # share of airlight from which on
DARK_GREY = 10.0  # grey levels across the rim up to which
ENOUGH = 0.8  # quality of the rim on the pixels as they are, from which on it is taken
REACH = 1.4  # radii
MARGIN_PX = 16.0
SMOOTH, LEAST_PX, MOST_PX = 0.02, 0.7, 2.0  # sigma: share of the radius, and its limits
RANGE, LEAST_GAIN, MOST_GAIN = 230.0, 2.0, 8.0  # grey levels that the part is stretched to; with less nothing is faint
TAILS, SPARSE = (1.0, 99.0), 8  # percent; every so many pixels tell whether it is worth it


def roundness(rim: Rim) -> float:
    """1 where all edges lie on the ellipse; a half where they scatter by 1 % of it and half a pixel (small: 3 %)."""
    size_px = rim.ellipse.semi_minor_px
    return 1 / (1 + (rim.rms_px / (min(0.5, 0.03 * size_px) + 0.01 * size_px)) ** 2)


def quality(rim: Rim) -> float:
    """0 to 1: how much of the rim in the picture is an edge, and how well these edges lie on one ellipse."""
    return rim.support * roundness(rim)


def even(rim: Rim) -> bool:
    """Do the edges lie on the ellipse but for their noise, rather than off it for complete sectors?"""
    return rim.wave_px <= max(EVEN_PX, BY_CHANCE * rim.rms_px * math.sqrt(SECTORS / rim.inliers))


def search_px(seed: Ellipse) -> float:
    """How far the rim may be from where the evidence saw it."""
    return max(SEARCH_PX, SEARCH * seed.semi_minor_px)


def clearest_rim(image: Colours, seed: Ellipse, reach_px: float = 0.0) -> Rim | None:
    """The rim near `seed` by all colours or, where these are at odds, by red against green only, whichever is better.

    `reach_px`: how far off the seed's rim may be, if that is more than usual.
    """
    near_px = max(reach_px, search_px(seed))
    rim = refine(image, seed, near_px)
    if rim is not None and quality(rim) >= GOOD and even(rim):
        return rim
    other = refine(image, seed, near_px, opponent=True)
    if other is None or other.contrast < MOST * fall(image, other.ellipse, WELL):
        return rim
    if rim is None:
        return other
    # Half hidden, but even: both see the same. Colours mixed by a lens weigh a little more in a* than in truth.
    better_by = CLEARLY if even(rim) else 0.0
    return other if quality(other) > quality(rim) + better_by else rim


def rim_behind_veil(image: Colours, seed: Ellipse, share: float, reach_px: float = 0.0) -> Rim | None:
    """`clearest_rim`; where that is poor and the edge faint, by `share` of airlight or in the dark, the better of it
    and the smoothed one's."""
    rim = clearest_rim(image, seed, reach_px)
    dark = rim is not None and rim.contrast <= DARK_GREY
    if (share < FAINT and not dark) or (rim is not None and quality(rim) >= ENOUGH):
        return rim
    smooth = _smoothed_rim(image, seed, reach_px)
    return smooth if rim is None or (smooth is not None and quality(smooth) > quality(rim)) else rim


def _smoothed_rim(image: Colours, seed: Ellipse, reach_px: float) -> Rim | None:
    half = REACH * seed.semi_major_px + MARGIN_PX + reach_px
    if not all(map(math.isfinite, (seed.u_px, seed.v_px, half))):
        return None
    height, width = image.shape[:2]
    x0, y0 = max(0, math.floor(seed.u_px - half)), max(0, math.floor(seed.v_px - half))
    x1, y1 = min(width, math.ceil(seed.u_px + half) + 1), min(height, math.ceil(seed.v_px + half) + 1)
    if x1 - x0 < 8 or y1 - y0 < 8:
        return None
    part = image[y0:y1, x0:x1]
    low, high = np.percentile(part[::SPARSE, ::SPARSE], TAILS)
    if LEAST_GAIN * (high - low) > RANGE:
        return None
    bright, gain = _stretched(part, min(max(SMOOTH * seed.semi_minor_px, LEAST_PX), MOST_PX))
    rim = clearest_rim(bright, replace(seed, u_px=seed.u_px - x0, v_px=seed.v_px - y0), reach_px)
    if rim is None:
        return None
    ellipse = replace(rim.ellipse, u_px=rim.ellipse.u_px + x0, v_px=rim.ellipse.v_px + y0)
    return replace(rim, ellipse=ellipse, contrast=rim.contrast / gain)


def _stretched(part: Colours, sigma_px: float) -> tuple[Image, float]:
    """(H, W, 3) uint8, and the gain."""
    # From 8 bits at once: GaussianBlur of single precision takes three times as long.
    weights = cv2.getGaussianKernel(round(8 * sigma_px + 1) | 1, sigma_px, cv2.CV_32F)
    smooth = np.asarray(cv2.sepFilter2D(part, cv2.CV_32F, weights, weights), np.float32)
    low, high = np.percentile(smooth[::4, ::4], TAILS)
    gain = min(MOST_GAIN, max(1.0, RANGE / max(float(high - low), 1.0)))
    level = 128 - gain * float(low + high) / 2
    return np.asarray(cv2.addWeighted(smooth, gain, smooth, 0.0, level, dtype=cv2.CV_8U), np.uint8), gain
