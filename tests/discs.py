"""Drawn red discs whose place is known exactly, and what was found of them. Pixel centres lie at integers."""

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle, Detection
from gateway.vision.pixels import Image
from gateway.vision.track.kalman_filter import Track

Colour = tuple[float, float, float]
CONCRETE: Colour = (95, 95, 92)
VIVID: Colour = (30, 30, 200)


def cover(u: float, v: float, r: float, size: tuple[int, int]) -> NDArray[np.float64]:
    """(H, W, 1): how much of every pixel lies in the disc."""
    y, x = np.mgrid[0 : size[0], 0 : size[1]]
    return np.asarray(np.clip(r + 0.5 - np.hypot(x - u, y - v), 0, 1)[..., None])


def painted(
    u: float, v: float, r: float, colour: Colour = VIVID, ground: Colour | Image = CONCRETE,
    size: tuple[int, int] = (240, 320),
) -> NDArray[np.float64]:  # fmt: skip
    """A disc on a ground, not yet rounded."""
    share = cover(u, v, r, size)
    return np.asarray((1 - share) * np.asarray(ground) + share * np.asarray(colour))


def disc(
    u: float, v: float, r: float, colour: Colour = VIVID, ground: Colour | Image = CONCRETE,
    size: tuple[int, int] = (240, 320),
) -> Image:  # fmt: skip
    return rounded(painted(u, v, r, colour, ground, size))


def rounded(plane: NDArray[np.floating]) -> Image:
    return np.asarray(np.clip(np.rint(plane), 0, 255), np.uint8)


def circle_of(found: Detection) -> Circle:
    assert found.circle is not None
    return found.circle


def track_of(circle: Circle, t_ns: int = 0) -> Track:
    track = Track.started(circle, t_ns)
    assert track is not None
    return track
