"""The colour of places in the picture as it is, with no veil subtracted. Pure."""

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.constants import WHITE
from gateway.vision.detect.robust.redness import redness
from gateway.vision.pixels import Colours

LEAST_RED = 1.0  # grey levels: red above green
BURNT, AT_RIM = 0.08, 0.6  # share of the middle that is white; of the fall of redness, so much less lies at the rim
_MIDDLE, _SHARES = np.array((0.1, 0.2, 0.3, 0.4, 0.5)), np.linspace(0.1, 0.8, 8)  # of the radius
_INSIDE, _OUTSIDE = tuple(np.arange(0.3, 0.91, 0.1)), (1.1, 1.3)
_AROUND = np.arange(72.0) * (2 * np.pi / 72)
_COS, _SIN = np.cos(_AROUND), np.sin(_AROUND)


def scaled(rim: Ellipse, share: float | NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places u, v, px, on the ellipse round the same centre, `share` as large: (72,) each, of shares (n,) (n, 72)."""
    along = np.multiply.outer(np.multiply(share, rim.semi_major_px), _COS)
    across = np.multiply.outer(np.multiply(share, rim.semi_minor_px), _SIN)
    c, s = math.cos(rim.angle_rad), math.sin(rim.angle_rad)
    return rim.u_px + c * along - s * across, rim.v_px + s * along + c * across


def colours_at(image: Colours, u: NDArray[np.float64], v: NDArray[np.float64]) -> Colours:
    """(N, 3): the nearest pixels of the places, of any shape, that lie in the picture."""
    height, width = image.shape[:2]
    seen = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    rows, columns = (np.rint(at[seen]).astype(np.intp) for at in (v, u))
    return cast("Colours", image[rows, columns])


def is_red_itself(image: Colours, rim: Ellipse) -> bool:
    """Whether what lies within a rim is redder than grey. `image`: (H, W, 3) BGR, grey levels."""
    inside = colours_at(image, *scaled(rim, _SHARES)).astype(np.float32)
    return len(inside) > 0 and float(np.median(inside[:, 2] - inside[:, 1])) >= LEAST_RED


def is_glow(image: Colours, rim: Ellipse) -> bool:
    """Whether a lamp blinds the camera there: white in the middle, and round it a red that falls off with no edge.

    White has no redness, so that the evidence of the core does not tell.
    """
    middle = colours_at(image, *scaled(rim, _MIDDLE))
    if len(middle) == 0 or float((middle.min(axis=1) >= WHITE).mean()) < BURNT:
        return False
    inside, outside = ([_redness_at(image, rim, share) for share in shares] for shares in (_INSIDE, _OUTSIDE))
    return inside[-1] - outside[0] < AT_RIM * (max(inside) - outside[-1])


def _redness_at(image: Colours, rim: Ellipse, share: float) -> float:
    seen = redness(colours_at(image, *scaled(rim, share)))
    return float(np.median(seen)) if seen.size else 0.0
