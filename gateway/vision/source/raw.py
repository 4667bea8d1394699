"""Samples of 10, 12 and 16 bits as V4L2 cameras give them, made a picture of 16 bits by the curve of sRGB. Pure.

A sensor's samples are proportional to the light, behind a mosaic of red, green and blue. Everything else in the gateway
expects colours as cameras give them in 8 bits: by sRGB's curve, and grey where the scene is grey. So the black level is
subtracted, the mosaic filled in, red and blue amplified, and the curve applied; 65535 is white, whatever the format.
Layouts: V4L2's documentation, "Raw Bayer formats"; the packed ones are those of MIPI CSI-2.
"""

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.pixels import DeepImage
from gateway.vision.source.raw_format import RawFormat

Samples = NDArray[np.uint16]

FILLED_IN = {
    "RGGB": cv2.COLOR_BayerRGGB2BGR,
    "GRBG": cv2.COLOR_BayerGRBG2BGR,
    "GBRG": cv2.COLOR_BayerGBRG2BGR,
    "BGGR": cv2.COLOR_BayerBGGR2BGR,
}


def picture(buffer: NDArray[Any], shape: tuple[int, int], raw: RawFormat) -> DeepImage:
    """A driver's buffer as (H, W, 3) BGR uint16, or as (H, W) grey where there is no mosaic. `shape`: H, W.

    Raises ValueError for a buffer that is too small for that.
    """
    samples = unpacked(buffer, shape, raw)
    blue, green, red = _curves(raw)
    if not raw.mosaic:
        return green[samples]
    bgr = np.asarray(cv2.cvtColor(samples, FILLED_IN[raw.mosaic]), np.uint16)
    made = np.empty_like(bgr)
    for channel, curve in enumerate((blue, green, red)):
        np.take(curve, bgr[..., channel], out=made[..., channel])
    return made


def unpacked(buffer: NDArray[Any], shape: tuple[int, int], raw: RawFormat) -> Samples:
    """(H, W) samples, 0 to 2^bits - 1. Rows may be longer than their samples; what is more than white is white."""
    height, width = shape
    data = np.ascontiguousarray(buffer).reshape(-1).view(np.uint8)
    pitch = data.size // max(height, 1)
    group = {10: (4, 5), 12: (2, 3)}[raw.bits] if raw.packed else (1, 2)  # samples, bytes
    row = -(-width // group[0]) * group[1]
    if min(height, width) < 2 or pitch < row:
        raise ValueError(f"{data.size} bytes are no {width} x {height} px of {raw.name}")
    rows = data[: height * pitch].reshape(height, pitch)[:, :row]
    if not raw.packed:
        samples = np.ascontiguousarray(rows).view("<u2").astype(np.uint16)
        return np.minimum(samples, np.uint16((1 << raw.bits) - 1))
    parts = rows.reshape(height, -1, group[1]).astype(np.uint16)
    low_bits = raw.bits - 8
    low = parts[..., -1:] >> (low_bits * np.arange(group[0], dtype=np.uint16))
    both = parts[..., :-1] << low_bits | low & ((1 << low_bits) - 1)
    return np.asarray(both.reshape(height, -1)[:, :width], np.uint16)


@lru_cache(maxsize=4)
def _curves(raw: RawFormat) -> tuple[Samples, Samples, Samples]:
    """Of blue, green and red: from a sample to 16 bits by sRGB's curve (IEC 61966-2-1)."""
    white = (1 << raw.bits) - 1
    light = np.clip((np.arange(white + 1) - raw.black_level) / max(1, white - raw.black_level), 0, 1)
    curves = []
    for gain in (raw.blue_gain, 1.0, raw.red_gain):
        lit = np.minimum(gain * light, 1)
        curve = np.where(lit <= 0.0031308, 12.92 * lit, 1.055 * lit ** (1 / 2.4) - 0.055)
        curves.append(np.rint(65535 * curve).astype(np.uint16))
    return curves[0], curves[1], curves[2]
