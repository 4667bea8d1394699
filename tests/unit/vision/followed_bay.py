"""A bay whose frames show what a test wants, followed from frame to frame."""

import math

import numpy as np

from gateway.core.detection import Circle, Detection, Rejection
from gateway.vision.detect.radii import WITHDRAWN, MarkerRadii
from gateway.vision.pixels import Image
from gateway.vision.track.follower import Follower
from gateway.vision.track.kalman_filter import Prediction

FRAME_NS = 33_000_000
WIDTH, HEIGHT = 640, 480
FRAME = np.zeros((HEIGHT, WIDTH, 3), np.uint8)


class Bay:
    """A search that finds the first of what is in sight and possible, and rejects the rest; with `narrow` it sees the
    rest in a full frame only."""

    def __init__(self, *, narrow: bool = False) -> None:
        self.n = -1
        self.sight: tuple[Circle, ...] = ()
        self.narrow = narrow
        self.find = Follower(self._search, 0.3)

    def _search(
        self, image: Image, t_ns: int, expected: Prediction | None, radii_px: tuple[float, float] | None
    ) -> Detection:
        low, high = radii_px or (0.0, math.inf)
        fitting = [circle for circle in self.sight if low <= circle.radius_px <= high]
        others = [Rejection(c, "weaker" if c in fitting else "size") for c in self.sight if c not in fitting[:1]]
        if self.narrow and expected is not None:
            others = []
        wrong = next((other.circle for other in others if other.why == "size"), None)
        return Detection(fitting[0] if fitting else None, rejected=tuple(others), wrong_size=None if fitting else wrong)

    def frames(self, count: int, *sight: Circle, radii: MarkerRadii = WITHDRAWN) -> list[Detection]:
        self.find.expect(radii)
        self.sight = sight
        found = []
        for _ in range(count):
            self.n += 1
            found.append(self.find(FRAME, self.n * FRAME_NS))
        return found
