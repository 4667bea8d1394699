"""The brightness of the beacon's place in a picture, against what is around it. Pure."""

import numpy as np
from numpy.typing import NDArray

from gateway.config import BeaconConfig
from gateway.vision.pixels import Image

AROUND = 2.0  # radii: the ring that is compared ends there


class BeaconMeter:
    """Of one beacon. The ring takes away what lights the whole place: lamps, shadows, another exposure."""

    def __init__(self, config: BeaconConfig) -> None:
        self._config = config
        self._weights: NDArray[np.float32] | None = None
        self._box = (slice(0), slice(0))
        self._size: tuple[int, int] = (0, 0)

    def level(self, image: Image) -> float | None:
        """Grey levels, 0 to 255, that it is brighter than its ring; None: it is not in the picture."""
        if image.shape[:2] != self._size:
            self._prepare(image.shape[0], image.shape[1])
        if self._weights is None:
            return None
        return float(np.einsum("vuc,vu->", image[self._box], self._weights, dtype=np.float32))

    def _prepare(self, height: int, width: int) -> None:
        """The weights: the mean of the disc less the mean of the ring, of three channels."""
        place, self._size = self._config, (height, width)
        reach = AROUND * place.radius_px
        rows = slice(max(0, round(place.v_px - reach)), max(0, min(height, round(place.v_px + reach) + 1)))
        columns = slice(max(0, round(place.u_px - reach)), max(0, min(width, round(place.u_px + reach) + 1)))
        self._box, self._weights = (rows, columns), None
        if rows.start >= rows.stop or columns.start >= columns.stop:
            return
        v, u = np.mgrid[rows, columns]
        away = np.hypot(v - place.v_px, u - place.u_px)
        disc, ring = away <= place.radius_px, (away > place.radius_px) & (away <= reach)
        if disc.any() and ring.any():
            self._weights = (disc / (3 * disc.sum()) - ring / (3 * ring.sum())).astype(np.float32)
