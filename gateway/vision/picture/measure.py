"""Figures of a picture itself: brightness, contrast, sharpness, dust veil. Pure; 0.4 ms at VGA, twice a second.

All but the sharpness are taken from a picture halved until it is at most 240 px wide, where the sensor's noise is gone.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.readings import PictureHealth
from gateway.vision.picture.background import Background
from gateway.vision.pixels import Image

PERIOD_NS = 500_000_000
SMALL_PX = 240
BURNT = 250  # grey level from which a pixel is clipped
# Sharpness: the steepest step of 2 px in a window of 32 px, as a share of all that the window spans.
ROWS, WINDOW = 16, 32
LEAST_LEVELS, LEAST_WINDOWS, STRONGEST = 24.0, 8, 40
EDGELESS = 0.25  # a picture of so much contrast has edges; where none are found it is blurred beyond measure
# Dust veil: A is the airlight, the veil the share of it in the darkest of the picture.
AIRLIGHT_SHARE, DARKEST_SHARE, VEIL_GAIN, LEAST_AIRLIGHT = 0.70, 0.003, 0.97, 10

Grey = NDArray[np.uint8]


class PictureMeter:
    """Of one vision process; frames in order. Measures one every half second."""

    def __init__(self) -> None:
        self._background = Background()
        self._due_ns = 0

    def measure(self, image: Image, t_ns: int, *, marker: bool) -> PictureHealth | None:
        """(H, W, 3) uint8 BGR of capture time `t_ns`; None: not due. `marker`: it was found or is followed."""
        if 0 < self._due_ns - t_ns <= PERIOD_NS:
            return None
        self._due_ns = t_ns + PERIOD_NS
        small = halved(image)
        grey = np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.uint8)
        shares = np.cumsum(np.bincount(grey.ravel(), minlength=256)) / grey.size
        low, high = np.searchsorted(shares, (0.05, 0.95))
        brightness, contrast = float(grey.mean()) / 255, float(high - low) / 255
        sharp = sharpness(image)
        shift = self._background.shift(grey, t_ns, marker=marker)
        return PictureHealth(
            brightness=brightness,
            clipped=1 - float(shares[BURNT - 1]),
            contrast=contrast,
            sharpness=0.0 if sharp is None and contrast >= EDGELESS else sharp,
            veil=veil(np.ascontiguousarray(small[::2, ::2])),
            shift_px=None if shift is None else shift * image.shape[1] / grey.shape[1],
        )


def halved(image: Image) -> Image:
    """Small enough, by means of 2 x 2 pixels."""
    while image.shape[1] > SMALL_PX and image.shape[0] >= 2:
        size = (image.shape[1] // 2, image.shape[0] // 2)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return image


def sharpness(image: Image) -> float | None:
    """0 to 1: a step from one pixel to the next gives 0.6, blurred by a Gaussian of 2 px 0.3, of 4 px 0.2, of 8 px 0.1.

    Rows of windows, each of 3 x 3 means; what noise would give is subtracted. Of the windows that span most the
    upper quartile, since others hold shades and no edge. None: too few windows with anything in them.
    """
    height, width = image.shape[:2]
    across = (width - 4) // WINDOW
    if height < 3 or across < 1:
        return None
    rows = np.clip((2 * np.arange(ROWS) + 1) * height // (2 * ROWS), 1, height - 2)
    green = image[np.concatenate([rows - 1, rows, rows + 1])][:, :, 1].astype(np.int16).reshape(3, ROWS, width)
    band = green.sum(axis=0, dtype=np.int16)  # 3 times the mean
    bend = np.sort(np.abs(band[:, :-2:3] - 2 * band[:, 1:-1:3] + band[:, 2::3]), axis=None)
    noise = float(bend[bend.size // 2]) / (3 * 0.6745 * 6**0.5)  # standard deviation, grey levels
    mean = band[:, :-2] + band[:, 1:-1] + band[:, 2:]  # 9 times
    windows = (ROWS, across, WINDOW)
    steps = np.abs(mean[:, 2 : across * WINDOW + 2] - mean[:, : across * WINDOW]).reshape(windows).max(axis=2)
    parts = mean[:, : across * WINDOW].reshape(windows)
    spans = (parts.max(axis=2) - parts.min(axis=2)).ravel() / 9 - 3 * noise / 3**0.5
    telling = np.flatnonzero(spans >= max(LEAST_LEVELS, 6 * noise))
    if len(telling) < LEAST_WINDOWS:
        return None
    best = telling[np.argsort(spans[telling])[-STRONGEST:]]
    shares = np.sort((steps.ravel()[best] / 9 - 2.5 * noise * 2 / 3) / spans[best])
    return min(1.0, max(0.0, float(shares[3 * len(shares) // 4])))


def veil(small: Image) -> float | None:
    """Share of airlight that lies over the picture, 0 to 1: of haze, dust, a film on the lens. None: too dark to
    measure.

    A is the 70th percentile of each channel; the veil 0.97 times the 0.3rd percentile of the least channel of I / A. A
    scene without anything dark appears veiled: 0.1 to 0.3 in a clean bay.
    """
    count = small.shape[0] * small.shape[1]
    lookup = np.empty((1, 256, 3), np.uint8)
    for channel in range(3):
        levels = cv2.calcHist([small], [channel], None, [256], [0, 256]).ravel()
        airlight = int(np.searchsorted(np.cumsum(levels), AIRLIGHT_SHARE * count))
        if airlight < LEAST_AIRLIGHT:
            return None
        lookup[0, :, channel] = np.minimum(255, np.arange(256) * 200 // airlight)
    shares = np.asarray(cv2.LUT(small, lookup))
    least = cv2.min(cv2.min(shares[:, :, 0], shares[:, :, 1]), shares[:, :, 2])
    levels = np.bincount(np.asarray(least).ravel(), minlength=256)
    darkest = int(np.searchsorted(np.cumsum(levels), DARKEST_SHARE * count))
    return min(1.0, VEIL_GAIN * darkest / 200)
