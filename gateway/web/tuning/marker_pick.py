"""A click on the marker for the robust method: its colour in the method's own measure, and what it proposes. Pure."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.config.sections.vision import LEAST_LEVEL, LEAST_SATURATION
from gateway.vision.detect.robust.marker_colour import (
    BRIGHTEST,
    FULL_REDNESS,
    NEAR_DEG,
    PAPER_RED,
    MarkerColour,
    distance,
    hue,
    marker_of,
)
from gateway.vision.detect.robust.redness import redness
from gateway.vision.pixels import Image
from gateway.web.tuning.eyedropper import window
from gateway.web.tuning.response_models import MarkerPickView

SMOOTH_PX = 5  # side of the Gaussian: single pixels' noise is no spread of the paint
MOST_SPREAD_DEG = 3 * NEAR_DEG  # of hue: noise and the light on a ball reach two thirds of it
LEAST_CHROMA = 0.5  # of the median: where a part of the patch has less, not all of it is paint
FARTHEST = 10.0  # of a distance, which may be infinite


@dataclass(frozen=True, slots=True)
class _Paint:
    """Seen in clear air."""

    colour: tuple[float, float, float]
    redness: float
    haze: float = 0.0
    veil: float = 0.0


def pick(image: Image, u_px: float, v_px: float, size_px: int, present: str | None) -> MarkerPickView:
    """A square of side `size_px` round (u, v), as far as it is in the picture. `present`: `vision.marker_colour`.

    Raises ValueError for a click beside the picture.
    """
    near = window(image, u_px, v_px, size_px)
    smooth = np.asarray(cv2.GaussianBlur(image, (SMOOTH_PX, SMOOTH_PX), 0), np.uint8)
    bgr = smooth[near].reshape(1, -1, 3)
    middle = np.rint(np.median(bgr[0], axis=0)).astype(np.uint8)
    colour = f"#{middle[::-1].tobytes().hex()}"
    own = marker_of(colour)
    hue_deg = hue(*map(float, middle))
    low, high = (float(off_deg) + hue_deg for off_deg in np.percentile(_off_deg(bgr, hue_deg), (5, 95)))
    chromas = redness(_seen(bgr, own))
    weakest, strongest = map(float, np.percentile(chromas, (5, 95)))
    warnings = list(_warnings(bgr, middle, own, (low, high), weakest))
    off = distance(_paint(bgr, marker_of(present)), marker_of(present))
    red = distance(_paint(bgr, PAPER_RED), PAPER_RED) == 0
    keys: dict[str, str | None] = {"marker_colour": None if red else colour}
    return MarkerPickView(
        colour=colour,
        hue_deg=round(hue_deg, 1),
        hues_deg=(round(low, 1), round(high, 1)),
        chroma=round(float(np.median(chromas)), 2),
        chromas=(round(weakest, 2), round(strongest, 2)),
        distance=round(min(FARTHEST, off), 2),
        keys={} if warnings or off == 0 else keys,
        warnings=warnings,
    )


def _seen(bgr: Image, marker: MarkerColour) -> Image:
    return np.asarray(marker.seen(bgr), np.uint8)


def _paint(bgr: Image, marker: MarkerColour) -> _Paint:
    seen = _seen(bgr, marker)
    blue, green, red = np.median(seen[0], axis=0).tolist()
    return _Paint((blue, green, red), float(np.median(redness(seen))))


def _off_deg(bgr: Image, hue_deg: float) -> NDArray[np.float32]:
    hsv = np.asarray(cv2.cvtColor(bgr.astype(np.float32) / 255, cv2.COLOR_BGR2HSV), np.float32)
    return np.asarray((hsv[..., 0] - np.float32(hue_deg) + 180) % 360 - 180, np.float32)


def _warnings(
    bgr: Image,
    middle: NDArray[np.uint8],
    own: MarkerColour,
    hues_deg: tuple[float, float],
    weakest: float,
) -> Iterator[str]:
    most, least = int(middle.max()), int(middle.min())
    paint = _paint(bgr, own)
    if most < LEAST_LEVEL:
        yield f"nearly black ({most} of 255): its hue is noise; more light, or a longer exposure"
    elif most >= BRIGHTEST:
        yield f"over-exposed ({most} of 255): its hue is not that of the paint; a shorter exposure"
    elif most - least < LEAST_SATURATION * most or distance(paint, own) > 0:
        yield f"too pale (chroma {paint.redness:.2f}, paint has {FULL_REDNESS:g} and more): choose a clearer spot"
    elif hues_deg[1] - hues_deg[0] > MOST_SPREAD_DEG or weakest < LEAST_CHROMA * paint.redness:
        yield (
            f"many colours: hues over {hues_deg[1] - hues_deg[0]:.0f} degrees, chroma from {weakest:.2f}; choose a "
            "smaller patch, or one within the marker"
        )
