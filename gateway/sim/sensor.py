"""A camera's sensor: what it makes of light, exposure time and gain. Pure.

Light is in units of white: a white surface in the full light of a scenario, exposed for `camera.exposure_ms` without
gain, just fills the range and the wells. The camera is linear.
"""

import random

import numpy as np
from numpy.typing import NDArray

from gateway.vision.pixels import Image

FULL_WELL_E = 10_000.0  # electrons: the most that a pixel holds, whatever the gain
READ_NOISE_E = 8.0  # standard deviation, electrons
MARGIN_PX = 64  # the noise is so much larger than the frame; a window of it moves about
Light = NDArray[np.float32]  # (H, W, 3), BGR


class Sensor:
    """Of one simulated camera. `noise`: False: neither shot nor read noise."""

    def __init__(self, width_px: int, height_px: int, seed: int, *, noise: bool) -> None:
        self._seed = seed
        self._size = (width_px, height_px)
        self._noise: Light | None = None
        if noise:
            shape = (height_px + MARGIN_PX, width_px + MARGIN_PX, 3)
            self._noise = np.random.default_rng([seed, 14]).standard_normal(shape, dtype=np.float32)

    def picture(self, light: Light, exposed: float, gain_db: float, frame_index: int) -> Image:
        """(H, W, 3) uint8. `exposed`: the exposure time as a multiple of that which fills the range.

        `light` is written into.
        """
        light *= np.float32(FULL_WELL_E * exposed)
        electrons = np.clip(light, 0, FULL_WELL_E, out=light)
        if self._noise is not None:
            width, height = self._size
            place = random.Random(f"sensor {self._seed} {frame_index}")
            x, y = place.randrange(MARGIN_PX), place.randrange(MARGIN_PX)
            noise = np.sqrt(electrons + np.float32(READ_NOISE_E**2))
            noise *= self._noise[y : y + height, x : x + width]
            electrons += noise
        electrons *= np.float32(255 / FULL_WELL_E * 10 ** (gain_db / 20))
        return np.rint(np.clip(electrons, 0, 255, out=electrons)).astype(np.uint8)
