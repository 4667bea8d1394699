"""The colour of places in the picture as it is, with no veil subtracted. Pure."""

from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.conic import outline
from gateway.vision.pixels import Colours

LEAST_RED = 1.0  # grey levels: red above green
_SHARES = np.linspace(0.1, 0.8, 8)  # of the radius
_AROUND = np.arange(72.0) * (2 * np.pi / 72)


def scaled(rim: Ellipse, share: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(72,), (72,): places u, v on the ellipse round the same centre, `share` as large, px."""
    major_px, minor_px = share * rim.semi_major_px, share * rim.semi_minor_px
    u, v = outline(replace(rim, semi_major_px=major_px, semi_minor_px=minor_px), _AROUND)
    return u, v


def colours_at(image: Colours, u: NDArray[np.float64], v: NDArray[np.float64]) -> Colours:
    """(N, 3): the nearest pixels of the places in the picture."""
    height, width = image.shape[:2]
    seen = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    rows, columns = (np.rint(at[seen]).astype(np.intp) for at in (v, u))
    return cast("Colours", image[rows, columns])


def is_red_itself(image: Colours, rim: Ellipse) -> bool:
    """Whether what lies within a rim is redder than grey. `image`: (H, W, 3) BGR, grey levels."""
    places = np.concatenate([np.stack(scaled(rim, float(share))) for share in _SHARES], axis=1)
    inside = colours_at(image, *places).astype(np.float32)
    return len(inside) > 0 and float(np.median(inside[:, 2] - inside[:, 1])) >= LEAST_RED
