"""Pictures sampled along rays from a centre outwards, for many candidates at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.compiled.sizes import RADIAL
from gateway.vision.detect.robust.redness import Plane, PyramidLevel, redness
from gateway.vision.pixels import Colours

RAYS = RADIAL
ANGLES = np.arange(RAYS, dtype=np.float32) * np.float32(2 * np.pi / RAYS)
COS, SIN = np.cos(ANGLES), np.sin(ANGLES)

Shapes = NDArray[np.float64]  # (K, 5): u, v, two semi-axes (px of the candidate's level), angle of the first (rad)


@dataclass(frozen=True, slots=True)
class RaySamples:
    """All (K, RAYS, S)."""

    red: Plane  # redness
    seen: NDArray[np.bool_]  # whether the sample lies in the picture
    bgr: Colours  # with a fourth axis of 3


def sample_rays(levels: Sequence[PyramidLevel], which: NDArray[np.intp], shapes: Shapes, shares: Plane) -> RaySamples:
    """Samples of K ellipses, each on the level `which` (K,), at `shares` (S,) of the way from centre to rim.

    A ray's angle is the parameter of the ellipse, so that each ray meets the rim at share 1.
    """
    u, v, along, across, _ = (column[:, None] for column in shapes.T.astype(np.float32))
    turn = shapes[:, 4:]
    cos, sin = np.cos(turn).astype(np.float32), np.sin(turn).astype(np.float32)
    x, y = along * COS, across * SIN
    du, dv = x * cos - y * sin, x * sin + y * cos  # (K, RAYS)
    map_u = u[..., None] + du[..., None] * shares
    map_v = v[..., None] + dv[..., None] * shares
    seen = np.empty(map_u.shape, np.bool_)
    bgr = np.empty((*map_u.shape, 3), levels[0].bgr.dtype)
    for number in np.unique(which):
        mine = np.nonzero(which == number)[0]
        bgr[mine], seen[mine] = _sampled(levels[number].bgr, map_u[mine], map_v[mine])
    return RaySamples(redness(bgr, levels[0].gain), seen, bgr)


def _sampled(picture: Colours, map_u: Plane, map_v: Plane) -> tuple[Colours, NDArray[np.bool_]]:
    height, width = picture.shape[:2]
    seen = (map_u >= -0.5) & (map_u <= width - 0.5) & (map_v >= -0.5) & (map_v <= height - 0.5)
    flat = (-1, map_u.shape[-1])
    taken: Any = cv2.remap(
        picture, map_u.reshape(flat), map_v.reshape(flat), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return taken.reshape(*map_u.shape, 3), seen
