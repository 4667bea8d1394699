"""The rim of a candidate behind a thick veil: where the pixels as they are show it poorly, on smoothed ones. Pure.

The refinement decides ray by ray which edges count; behind 90 % dust a ray's edge is some ten grey levels high and the
noise two. Smoothing along and across the rim and the same gain for all channels lift the edges over its thresholds.
Neither moves the rim: the refinement corrects for blur. But it costs exactness (0.04 px became 0.1 px in the median),
so the pixels as they are come first.
"""

from dataclasses import replace
from math import ceil, floor, isfinite

import cv2
import numpy as np

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.colours import clearest_rim, quality
from gateway.vision.detect.robust.rim import Rim
from gateway.vision.pixels import Colours, Image

FAINT = 0.6  # share of airlight from which on
ENOUGH = 0.8  # quality of the rim on the pixels as they are, from which on it is taken
REACH = 1.4  # radii
MARGIN_PX = 16.0
SMOOTH, LEAST_PX, MOST_PX = 0.02, 0.7, 2.0  # sigma: share of the radius, and its limits
RANGE, MOST_GAIN = 230.0, 8.0  # grey levels that the part is stretched to
TAILS = (1.0, 99.0)  # percent


def rim_behind_veil(image: Colours, seed: Ellipse, share: float, reach_px: float = 0.0) -> Rim | None:
    """`clearest_rim`; behind `share` of airlight and where that is poor, the better of it and the smoothed one's."""
    rim = clearest_rim(image, seed, reach_px)
    if share < FAINT or (rim is not None and quality(rim) >= ENOUGH):
        return rim
    smooth = _smoothed_rim(image, seed, reach_px)
    return smooth if rim is None or (smooth is not None and quality(smooth) > quality(rim)) else rim


def _smoothed_rim(image: Colours, seed: Ellipse, reach_px: float) -> Rim | None:
    half = REACH * seed.semi_major_px + MARGIN_PX + reach_px
    if not all(map(isfinite, (seed.u_px, seed.v_px, half))):
        return None
    height, width = image.shape[:2]
    x0, y0 = max(0, floor(seed.u_px - half)), max(0, floor(seed.v_px - half))
    x1, y1 = min(width, ceil(seed.u_px + half) + 1), min(height, ceil(seed.v_px + half) + 1)
    if x1 - x0 < 8 or y1 - y0 < 8:
        return None
    part, gain = _stretched(image[y0:y1, x0:x1], min(max(SMOOTH * seed.semi_minor_px, LEAST_PX), MOST_PX))
    rim = clearest_rim(part, replace(seed, u_px=seed.u_px - x0, v_px=seed.v_px - y0), reach_px)
    if rim is None:
        return None
    ellipse = replace(rim.ellipse, u_px=rim.ellipse.u_px + x0, v_px=rim.ellipse.v_px + y0)
    return replace(rim, ellipse=ellipse, contrast=rim.contrast / gain)


def _stretched(part: Colours, sigma_px: float) -> tuple[Image, float]:
    """(H, W, 3) uint8, and the gain."""
    smooth = np.asarray(cv2.GaussianBlur(part.astype(np.float32), (0, 0), sigma_px), np.float32)
    low, high = np.percentile(smooth[::4, ::4], TAILS)
    gain = min(MOST_GAIN, max(1.0, RANGE / max(float(high - low), 1.0)))
    stretched = np.float32(gain) * (smooth - np.float32((low + high) / 2)) + np.float32(128)
    return np.clip(np.rint(stretched), 0, 255).astype(np.uint8), gain
