"""Redness along fans of rays from a centre outwards, for many candidates at once."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.pixels import Image
from gateway.vision.robust.redness import Plane, redness

RAYS = 48
ANGLES = np.arange(RAYS, dtype=np.float32) * np.float32(2 * np.pi / RAYS)


@dataclass(frozen=True, slots=True)
class Fan:
    """`red`: (K, RAYS, S) redness; `seen`: the same shape, whether the sample lies in the picture."""

    red: Plane
    seen: NDArray[np.bool_]
    bgr: Image  # (K, RAYS, S, 3)


def fan(bgr: Image, u: Plane, v: Plane, along: Plane, across: Plane, turn: Plane, shares: Plane) -> Fan:
    """Samples of K ellipses, (K,) each, px of `bgr`: at `shares` (S,) of the way from the centre to the rim.

    `along` and `across` are the semi-axes, `turn` the angle of the first; a ray's angle is the ellipse's parameter.
    """
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x, y = along[:, None] * np.cos(ANGLES), across[:, None] * np.sin(ANGLES)
    du, dv = x * cos - y * sin, x * sin + y * cos  # (K, RAYS)
    map_u = np.asarray(u[:, None, None] + du[..., None] * shares, np.float32)
    map_v = np.asarray(v[:, None, None] + dv[..., None] * shares, np.float32)
    height, width = bgr.shape[:2]
    seen = (map_u >= -0.5) & (map_u <= width - 0.5) & (map_v >= -0.5) & (map_v <= height - 0.5)
    flat = (map_u.size // shares.size, shares.size)
    taken = cv2.remap(bgr, map_u.reshape(flat), map_v.reshape(flat), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    samples = np.asarray(taken, np.uint8).reshape(*map_u.shape, 3)
    return Fan(redness(samples), seen, samples)
