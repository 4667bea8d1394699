"""What dust, light, motion, lenses and cables do to a picture: seeded, pure, for benchmarks and tests.

Every disturbance takes a (H, W, 3) uint8 BGR picture and gives a new one of the same shape; none moves the marker (the
blur is centred on it). Lengths are shares of the picture's diagonal, so that a small picture suffers like a large one.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.pixels import Image

AIRLIGHT = (206.0, 206.0, 204.0)  # of cement dust in daylight, BGR
READ_NOISE = 2.0  # grey levels a camera adds when it has less light

Strength = float


def dust(image: Image, share: float, *, at: tuple[float, float], uneven: bool, seed: int = 0, shot: int = 0) -> Image:
    """Thick dust: exactly `share` airlight at the pixel `at` (u, v), then the sensor's noise, then rounding to 8 bits.

    `share` is below 1. Even: the same everywhere. Uneven: the extinction differs by up to 30 % between clouds a quarter
    of the frame wide, the airlight by 15 % from one side of the frame to the other. The airlight's level and tint are
    drawn. Two shots of one `seed` differ by their noise.
    """
    height, width = image.shape[:2]
    chance = np.random.default_rng([seed, 4])
    depth = np.full((height, width), -math.log(1 - share), np.float32)
    light = np.ones((height, width), np.float32)
    if uneven:
        cells = chance.uniform(0.7, 1.3, (4, 5)).astype(np.float32)
        clouds = np.asarray(cv2.resize(cells, (width, height), interpolation=cv2.INTER_CUBIC))
        depth *= clouds / clouds[round(at[1]), round(at[0])]
        turn = float(chance.uniform(0, 2 * math.pi))
        x, y = np.linspace(-0.15, 0.15, width), np.linspace(-0.15, 0.15, height)
        light += (math.cos(turn) * x + math.sin(turn) * y[:, None]).astype(np.float32)
    tint = 1 + float(chance.uniform(-0.02, 0.04)) * np.array((-1, 0, 1), np.float32)
    airlight = float(chance.uniform(0.8, 1.08)) * np.array(AIRLIGHT, np.float32) * tint
    left = np.exp(-depth)[..., None]
    seen = image * left + airlight * light[..., None] * (1 - left)
    return _u8(seen + np.float32(READ_NOISE) * _normal(image.shape, seed, shot))


def veil(image: Image, share: Strength, seed: int = 0) -> Image:
    """Dust: each pixel is `share` airlight, in clouds of half as much to half as much again."""
    height, width = image.shape[:2]
    cells = np.random.default_rng([seed, 1]).uniform(0.5, 1.5, (5, 7)).astype(np.float32)
    clouds = np.asarray(cv2.resize(cells, (width, height), interpolation=cv2.INTER_CUBIC))
    part = np.clip(share * clouds, 0, 0.95)[..., None]
    return _u8(image * (1 - part) + np.array(AIRLIGHT, np.float32) * part)


def gain(image: Image, times: Strength, seed: int = 0) -> Image:
    """Less light, with the camera's own noise on top, or more of it than the sensor can hold."""
    lit = image.astype(np.float32) * np.float32(times)
    if times < 1:
        lit += READ_NOISE * _normal(image.shape, seed)
    return _u8(lit)


def motion(image: Image, share: Strength, seed: int = 0) -> Image:
    """A straight smear, `share` of the diagonal long, in a direction drawn from the seed."""
    length = share * math.hypot(*image.shape[:2])
    turn = float(np.random.default_rng([seed, 2]).uniform(0, math.pi))
    half = max(1, math.ceil(length / 2))
    along = np.linspace(-length / 2, length / 2, 8 * half + 1)
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    x, y = half + along * math.cos(turn), half + along * math.sin(turn)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    for i, weight_x in ((left, 1 - (x - left)), (left + 1, x - left)):
        for j, weight_y in ((top, 1 - (y - top)), (top + 1, y - top)):
            inside = (i <= 2 * half) & (j <= 2 * half)
            np.add.at(kernel, (j[inside], i[inside]), (weight_x * weight_y)[inside])
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT_101), np.uint8)


def warm(image: Image, strength: Strength, seed: int = 0) -> Image:
    """Sodium light or a low sun: at 1 half the blue is gone."""
    return _cast(image, (1 - 0.5 * strength, 1 - 0.12 * strength, 1 + 0.1 * strength))


def cold(image: Image, strength: Strength, seed: int = 0) -> Image:
    """Shade under a blue sky, or a wrong white balance: at 1 a third of the red is gone."""
    return _cast(image, (1 + 0.15 * strength, 1 - 0.05 * strength, 1 - 0.35 * strength))


def jpeg(image: Image, quality: Strength, seed: int = 0) -> Image:
    """Through a JPEG file: blocks, ringing, colour at half the resolution."""
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, round(quality)])
    if not done:
        raise ValueError(f"cannot be stored as JPEG: {image.shape}")
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def noise(image: Image, sigma: Strength, seed: int = 0) -> Image:
    """Sensor noise, grey levels, each channel its own."""
    return _u8(image + np.float32(sigma) * _normal(image.shape, seed))


@dataclass(frozen=True, slots=True)
class Disturbance:
    name: str
    apply: Callable[[Image, Strength, int], Image]
    strengths: tuple[Strength, ...]  # from mild to worst
    unit: str


DISTURBANCES = (
    Disturbance("dust veil", veil, (0.25, 0.4, 0.5, 0.6), "mean share of airlight"),
    Disturbance("low light", gain, (0.6, 0.4, 0.25), "times the light"),
    Disturbance("over-exposure", gain, (1.3, 1.6, 2.0, 2.5), "times the light"),
    Disturbance("motion blur", motion, (0.004, 0.008, 0.012), "share of the diagonal"),
    Disturbance("warm cast", warm, (0.4, 0.7, 1.0), "1: half the blue gone"),
    Disturbance("cold cast", cold, (0.4, 0.7, 1.0), "1: a third of the red gone"),
    Disturbance("JPEG", jpeg, (70, 50, 30), "quality"),
    Disturbance("noise", noise, (6, 12, 20), "grey levels, sigma"),
)


def _cast(image: Image, gains: tuple[float, float, float]) -> Image:
    return _u8(image.astype(np.float32) * np.array(gains, np.float32))


def _normal(shape: tuple[int, ...], seed: int, shot: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng([seed, 3, shot] if shot else [seed, 3]).standard_normal(shape, dtype=np.float32)


def _u8(values: NDArray[np.float32]) -> Image:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
