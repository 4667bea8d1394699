"""The simulated camera's controls, as a V4L2 driver would have them: exposure time, gain, brightness, white balance.

They change the picture's values as a whole (a table of 256 for each colour); at the defaults it is what it always was.
With `camera.exposure = "marker"` the time and the gain are the exposure control's (`SimExposure`), and not here.
"""

import errno
import os

import numpy as np

from gateway.vision.pixels import Image
from gateway.vision.source.v4l2_device import (
    AUTO_WHITE_BALANCE,
    BRIGHTNESS,
    EXPOSURE_ABSOLUTE,
    GAIN,
    WHITE_BALANCE_TEMPERATURE,
    Range,
)

DB_A_UNIT = 0.2  # of gain
DAYLIGHT_K = 4600
RANGES = {
    EXPOSURE_ABSOLUTE: Range(3, 330, 1, 50),
    GAIN: Range(0, 100, 1, 0),
    AUTO_WHITE_BALANCE: Range(0, 1, 1, 1),
    WHITE_BALANCE_TEMPERATURE: Range(2800, 6500, 10, DAYLIGHT_K),
    BRIGHTNESS: Range(-64, 64, 1, 0),
}


class SimControls:
    """Of one opened camera: each opening begins with the defaults."""

    def __init__(self) -> None:
        self._values = {control: offered.default for control, offered in RANGES.items()}
        self._table: Image | None = None  # (256, 1, 3); None: nothing is changed

    def range_of(self, control: int) -> Range | None:
        return RANGES.get(control)

    def get(self, control: int) -> int:
        return self._values[control]

    def set(self, control: int, value: int) -> int:
        """Raises OSError where an automatic has its way, as the driver of USB cameras does."""
        if control == WHITE_BALANCE_TEMPERATURE and self._values[AUTO_WHITE_BALANCE]:
            raise OSError(errno.EACCES, os.strerror(errno.EACCES))
        self._values[control] = min(max(value, RANGES[control].least), RANGES[control].most)
        self._table = self._made()
        return self._values[control]

    def close(self) -> None:
        pass

    def seen(self, image: Image) -> Image:
        """The picture with these settings."""
        if self._table is None:
            return image
        import cv2  # noqa: PLC0415 - OpenCV stays out of the main process

        return np.asarray(cv2.LUT(image, self._table), np.uint8)

    def _made(self) -> Image | None:
        values = self._values
        light = values[EXPOSURE_ABSOLUTE] / RANGES[EXPOSURE_ABSOLUTE].default * 10 ** (DB_A_UNIT * values[GAIN] / 20)
        warm = 1.0 if values[AUTO_WHITE_BALANCE] else values[WHITE_BALANCE_TEMPERATURE] / DAYLIGHT_K
        if (light, warm, values[BRIGHTNESS]) == (1.0, 1.0, 0):
            return None
        factors = light * np.array([1 / warm, 1.0, warm])  # BGR
        levels = np.arange(256)[:, None, None] * factors + values[BRIGHTNESS]
        return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)
