"""Frames with a marker for the tuning page's tests: small, seeded, with exact truth."""

import cv2
import numpy as np

from gateway.vision.pixels import Image
from gateway.vision.transport.ring import Snapshot

WIDTH, HEIGHT = 160, 120
MARKER = (80.0, 60.0, 26.0)  # u, v, R
PERIOD_NS = 100_000_000


def picture(u: float = MARKER[0], v: float = MARKER[1], radius: float = MARKER[2], *, seed: int = 1) -> Image:
    """A red disc on textured grey, with a white patch far from it; edges over a pixel."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    plain = 120 + 12 * np.sin(x / 9) + rng.normal(0, 2, (HEIGHT, WIDTH))
    image = np.repeat(plain[..., None], 3, axis=2)
    cover = np.clip(radius + 0.5 - np.hypot(x - u, y - v), 0, 1)[..., None]
    image += cover * (np.array([40.0, 36.0, 190.0]) - image)
    cv2.circle(image, (12, 12), 6, (245, 245, 245), -1)
    return np.asarray(np.clip(np.rint(cv2.GaussianBlur(image, (0, 0), 0.7)), 0, 255), np.uint8)


def frame(seq: int = 1, u: float = MARKER[0], v: float = MARKER[1], radius: float = MARKER[2]) -> Snapshot:
    return Snapshot(picture(u, v, radius, seed=seq), seq, 1_000_000_000 + seq * PERIOD_NS)


def empty(seq: int = 1) -> Snapshot:
    """Without a marker."""
    return Snapshot(picture(radius=-5.0, seed=seq), seq, 1_000_000_000 + seq * PERIOD_NS)


class Ticks:
    """A clock that goes on by a millisecond with every look at it."""

    def __init__(self, step_ns: int = 1_000_000) -> None:
        self.at_ns = 0
        self._step_ns = step_ns

    def __call__(self) -> int:
        self.at_ns += self._step_ns
        return self.at_ns
