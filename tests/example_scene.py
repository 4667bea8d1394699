"""A drawn loading bay, with exact truth, for tests and the documentation's pictures. Pure, seeded.

Red disc with a white ring on stained concrete behind steel bars; dust and chips on the disc, flakes and streaks of rust
round it, a red lamp, three scratches of red paint that leave the rim, uneven light, blur and sensor noise.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle
from gateway.vision.pixels import Image

WIDTH, HEIGHT = 640, 480
TRUTH = Circle(u_px=352.3, v_px=236.8, radius_px=92.4)

Plane = NDArray[np.float64]


def scene(seed: int = 7) -> Image:
    """(480, 640, 3) uint8 BGR, the same for the same seed; the disc is TRUTH for every seed."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    stains = np.asarray(cv2.resize(rng.normal(0, 14, (12, 16)), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC))
    grain = np.asarray(cv2.GaussianBlur(rng.normal(0, 30, (HEIGHT, WIDTH)), (0, 0), 2.0))
    light = 0.75 + 0.5 * x / WIDTH
    picture = (118 + stains + grain)[..., None] * light[..., None] * np.array([0.97, 1.0, 0.99])

    for bar in range(30, WIDTH, 150):
        across = x - bar - 0.06 * y
        _paint(picture, 0.9 * _inside(9 - np.abs(across)), (70, 66, 62))
        _paint(picture, 0.8 * _inside(1.5 - np.abs(across + 5)), (160, 158, 150))
    for bar in (70, 410):
        _paint(picture, 0.9 * _inside(7 - np.abs(y - bar - 0.03 * x)), (84, 80, 78))
    for u, v, size in zip(rng.uniform(0, WIDTH, 9), rng.uniform(0, HEIGHT, 9), rng.uniform(3, 9, 9), strict=True):
        streak = np.hypot((x - u) / size, (y - v) / (2.2 * size)) + grain / 60
        _paint(picture, 0.85 * _inside(1.2 - streak), (52, 62, 128))

    radius = TRUTH.radius_px
    dx, dy = x - TRUTH.u_px, y - TRUTH.v_px
    _paint(picture, _inside(radius + 14.5 - np.hypot(dx, dy)), (188, 190, 186))
    _paint(picture, _inside(radius + 0.5 - np.hypot(dx, dy)), np.array([38, 34, 196]) * light[..., None])
    angles, far, sizes = rng.uniform(0, 2 * np.pi, 30), rng.uniform(0, 0.9, 30), rng.uniform(0.8, 4.2, 30)
    chips = radius * np.sqrt(far) * np.stack([np.cos(angles), np.sin(angles)])
    for u, v, size in zip(TRUTH.u_px + chips[0], TRUTH.v_px + chips[1], sizes, strict=True):
        _dot(picture, u, v, size, (150, 152, 150))
    for angle, length in ((0.5, 26), (2.4, 34), (4.4, 22)):
        along = dx * np.cos(angle) + dy * np.sin(angle)
        across = dy * np.cos(angle) - dx * np.sin(angle)
        scratch = _inside(1.6 - np.abs(across)) * ((along > radius - 4) & (along < radius + length))
        _paint(picture, scratch, (40, 38, 190))
    flakes = rng.uniform(0, WIDTH, 160), rng.uniform(0, HEIGHT, 160), rng.uniform(0.7, 2, 160)
    for u, v, size in zip(*flakes, strict=True):
        _dot(picture, u, v, size, (50, 60, 150))
    _paint(picture, _inside(11.5 - np.hypot(x - 90, y - 150)), (40, 40, 215))

    noisy = cv2.GaussianBlur(picture, (0, 0), 0.8) + rng.normal(0, 1.5, picture.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


def _inside(depth_px: Plane) -> Plane:
    """Coverage of a pixel that lies so deep inside a shape, px: an anti-aliased edge."""
    return np.clip(depth_px, 0.0, 1.0)


def _paint(picture: Plane, cover: Plane, colour: Sequence[int] | Plane) -> None:
    """Lay a colour over the picture, in place."""
    picture += cover[..., None] * (np.asarray(colour, np.float64) - picture)


def _dot(picture: Plane, u: float, v: float, radius_px: float, colour: Sequence[int]) -> None:
    """A small disc; only its surroundings are computed."""
    left, top = max(0, int(u - radius_px) - 1), max(0, int(v - radius_px) - 1)
    near = picture[top : int(v + radius_px) + 3, left : int(u + radius_px) + 3]
    y, x = np.mgrid[top : top + near.shape[0], left : left + near.shape[1]]
    _paint(near, 0.9 * _inside(radius_px + 0.5 - np.hypot(x - u, y - v)), colour)
