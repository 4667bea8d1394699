"""How bright the marker and the bay are in a picture: what the exposure is controlled by. Pure; 0.1 ms at VGA."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle, Detection, Ellipse
from gateway.vision.pixels import Image

CLIPPED = 250  # grey level from which a pixel counts as clipped
INSIDE = 0.88  # of the marker's semi-axes: the rim's mixed pixels are left out
MARKER_PERCENTILE = 90  # the brighter part of the disc is kept inside the range, small highlights are not
SAMPLES = 4096  # pixels of a region that are looked at, about
LEAST_PX = 20  # fewer pixels of the marker in the picture say nothing
HELD_NS = 1_500_000_000  # the place where the marker was last seen counts for this time


@dataclass(frozen=True, slots=True)
class RegionLight:
    """Of one region, in the brightest of the three channels. A red disc clips in its red first."""

    level: float  # grey level, 0 to 255: of the marker the 90th percentile, of the bay the median
    clipped: float  # share of the pixels at 250 and above


@dataclass(frozen=True, slots=True)
class FrameLight:
    """Of one frame. `marker` is None where it is not in sight and was not for `HELD_NS`."""

    seq: int
    t_ns: int
    bay: RegionLight
    marker: RegionLight | None = None
    seen: bool = False  # the marker was found in this frame; else `marker` is the place where it was, or should be


class LightMeter:
    """Of one camera's frames, in order."""

    def __init__(self) -> None:
        self._place: Ellipse | None = None
        self._seen_ns = 0

    def measure(self, image: Image, seq: int, t_ns: int, found: Detection) -> FrameLight:
        """`found`: in this (H, W, 3) uint8 BGR frame of capture time `t_ns`."""
        if found.circle is not None:
            self._place, self._seen_ns = found.ellipse or _round(found.circle), t_ns
        elif found.predicted is not None and self._place is not None:
            self._place = _round(found.predicted)
        if not 0 <= t_ns - self._seen_ns <= HELD_NS:
            self._place = None
        marker = None if self._place is None else marker_light(image, self._place)
        return FrameLight(seq, t_ns, bay_light(image), marker, seen=marker is not None and found.circle is not None)


def marker_light(image: Image, place: Ellipse) -> RegionLight | None:
    """Inside the ellipse; None: hardly any of it is in the picture."""
    height, width = image.shape[:2]
    reach = INSIDE * place.semi_major_px
    if not (1 <= place.semi_minor_px <= place.semi_major_px and math.isfinite(reach + place.u_px + place.v_px)):
        return None
    x0, x1 = max(0, math.ceil(place.u_px - reach)), min(width, math.floor(place.u_px + reach) + 1)
    y0, y1 = max(0, math.ceil(place.v_px - reach)), min(height, math.floor(place.v_px + reach) + 1)
    if x0 >= x1 or y0 >= y1:
        return None
    stride = _stride(x1 - x0, y1 - y0)
    u = np.arange(x0, x1, stride) - place.u_px
    v = np.arange(y0, y1, stride)[:, None] - place.v_px
    cos, sin = math.cos(place.angle_rad), math.sin(place.angle_rad)
    along, across = (u * cos + v * sin) / reach, (v * cos - u * sin) / (INSIDE * place.semi_minor_px)
    levels = image[y0:y1:stride, x0:x1:stride].max(axis=2)[along * along + across * across <= 1]
    return None if levels.size < LEAST_PX else _light(levels, MARKER_PERCENTILE)


def bay_light(image: Image) -> RegionLight:
    """Of the complete picture. Sky, lamps and the sun do not change a median while they fill less than half of it."""
    stride = _stride(image.shape[1], image.shape[0])
    return _light(image[stride // 2 :: stride, stride // 2 :: stride].max(axis=2).ravel(), 50)


def _light(levels: NDArray[np.uint8], percentile: int) -> RegionLight:
    counts = np.cumsum(np.bincount(levels, minlength=256))
    level = int(np.searchsorted(counts, percentile / 100 * levels.size))
    return RegionLight(float(level), 1 - float(counts[CLIPPED - 1]) / levels.size)


def _stride(width: int, height: int) -> int:
    return max(1, math.floor(math.sqrt(width * height / SAMPLES)))


def _round(circle: Circle) -> Ellipse:
    return Ellipse(circle.u_px, circle.v_px, circle.radius_px, circle.radius_px, 0.0)
