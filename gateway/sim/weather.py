"""What dust, light, weather, lenses and cables do to a picture: seeded, pure, and none of it moves the marker.

Light is (H, W, 3) float32 BGR in grey levels, beyond white, too; `photographed` makes the camera's picture of it.
Lengths are shares of the picture's width or diagonal, so that a small picture suffers like a large one.
"""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.pixels import Image

AIRLIGHT = (206.0, 206.0, 204.0)  # of cement dust in daylight, BGR
READ_NOISE = 2.0  # grey levels: the sensor's own
DIRT = (60.0, 70.0, 76.0)
Light = NDArray[np.float32]
Plane = NDArray[np.float32]  # (H, W)
Chance = np.random.Generator


def photographed(light: Light, chance: Chance, noise: float = READ_NOISE) -> Image:
    """With the sensor's noise (sigma, grey levels), clipped at white and rounded to 8 bits."""
    grainy = light + np.float32(noise) * chance.standard_normal(light.shape, np.float32)
    return np.clip(np.rint(grainy), 0, 255).astype(np.uint8)


def dust(image: Image, share: float, *, at: tuple[float, float], uneven: bool, seed: int = 0, shot: int = 0) -> Image:
    """A picture through `veiled`, then the sensor's noise. Two shots of one `seed` differ by their noise."""
    light = veiled(image, share, np.random.default_rng([seed, 4]), at=at, uneven=uneven)
    return photographed(light, np.random.default_rng([seed, 3, shot] if shot else [seed, 3]))


def veiled(
    light: Light | Image, share: float, chance: Chance, *, at: tuple[float, float], uneven: bool = True
) -> Light:
    """Thick dust: exactly `share` airlight, below 1, at the pixel `at` (u, v).

    Even: the same everywhere. Uneven: the extinction differs by up to 30 % between clouds a quarter of the frame wide,
    the airlight by 15 % from one side of the frame to the other. The airlight's level and tint are drawn.
    """
    height, width = light.shape[:2]
    depth = np.full((height, width), -math.log(1 - share), np.float32)
    lamp = np.ones((height, width), np.float32)
    if uneven:
        cells = chance.uniform(0.7, 1.3, (4, 5)).astype(np.float32)
        clouds = np.asarray(cv2.resize(cells, (width, height), interpolation=cv2.INTER_CUBIC))
        depth *= clouds / clouds[round(at[1]), round(at[0])]
        turn = float(chance.uniform(0, 2 * math.pi))
        x, y = np.linspace(-0.15, 0.15, width), np.linspace(-0.15, 0.15, height)
        lamp += (math.cos(turn) * x + math.sin(turn) * y[:, None]).astype(np.float32)
    tint = 1 + float(chance.uniform(-0.02, 0.04)) * np.array((-1, 0, 1), np.float32)
    airlight = float(chance.uniform(0.8, 1.08)) * np.array(AIRLIGHT, np.float32) * tint
    left = np.exp(-depth)[..., None]
    return np.asarray(light * left + airlight * lamp[..., None] * (1 - left), np.float32)


def rain(light: Light, chance: Chance) -> Light:
    """Light streaks, all slanted alike, and a thin haze."""
    height, width = light.shape[:2]
    cover = np.zeros((height, width), np.float32)
    slant = float(chance.uniform(-0.25, 0.25))
    for _ in range(500):
        x, y = int(chance.integers(width)), int(chance.integers(height))
        length = float(chance.uniform(0.02, 0.09)) * height
        cv2.line(cover, (x, y), (round(x + slant * length), round(y + length)), float(chance.uniform(0.2, 0.6)), 1)
    return _laid(light, np.maximum(np.asarray(cv2.GaussianBlur(cover, (0, 0), 0.7)), 0.12), (205.0,) * 3)


def snow(light: Light, chance: Chance) -> Light:
    """White flakes, near ones large, and a thin haze."""
    height, width = light.shape[:2]
    cover = np.zeros((height, width), np.float32)
    for _ in range(700):
        at = (int(chance.integers(width)), int(chance.integers(height)))
        cv2.circle(cover, at, int(chance.choice([1, 1, 2, 3, 5])), float(chance.uniform(0.5, 1.0)), -1)
    return _laid(light, np.maximum(np.asarray(cv2.GaussianBlur(cover, (0, 0), 0.8)), 0.15), (228.0,) * 3)


def dirt(light: Light, chance: Chance, spared: tuple[float, float, float] = (0, 0, 0), share: float = 0.22) -> Light:
    """Blurred spots on the lens over `share` of the picture; none covers the middle of a disc `spared` (u, v, r)."""
    height, width = light.shape[:2]
    cover = np.zeros((height, width), np.float32)
    u, v, radius = spared
    while cover.mean() < share:
        at, size = (
            (int(chance.integers(width)), int(chance.integers(height))),
            int(chance.integers(width // 60, width // 14)),
        )
        if math.hypot(at[0] - u, at[1] - v) > size + 0.4 * radius:
            cv2.circle(cover, at, size, 1.0, -1)
    return _laid(light, 0.85 * np.asarray(cv2.GaussianBlur(cover, (0, 0), width / 100)), DIRT)


def defocused(light: Light, radius_px: float) -> Light:
    """A point becomes a disc of this radius."""
    half = math.ceil(radius_px)
    x = np.arange(-half, half + 1, dtype=np.float32)
    kernel = np.clip(radius_px + 0.5 - np.hypot(x, x[:, None]), 0, 1)
    return _filtered(light, kernel)


def smeared(light: Light, way: NDArray[np.float64]) -> Light:
    """The mean along a way of (N, 2) offsets in px, which the marker follows during the exposure; their mean is 0."""
    half = max(1, math.ceil(float(np.abs(way).max())))
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    x, y = half + way[:, 0], half + way[:, 1]
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    for i, weight_x in ((left, 1 - (x - left)), (left + 1, x - left)):
        for j, weight_y in ((top, 1 - (y - top)), (top + 1, y - top)):
            inside = (i <= 2 * half) & (j <= 2 * half)
            np.add.at(kernel, (j[inside], i[inside]), (weight_x * weight_y)[inside])
    # filter2D correlates: a way that is not symmetric would be mirrored.
    return _filtered(light, np.ascontiguousarray(kernel[::-1, ::-1]))


def jpeg(image: Image, quality: int) -> Image:
    """Through a JPEG file: blocks, ringing, colour at half the resolution."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def _laid(light: Light, cover: Plane, colour: tuple[float, ...]) -> Light:
    share = np.asarray(cover, np.float32)[..., None]
    return np.asarray(light * (1 - share) + np.array(colour, np.float32) * share, np.float32)


def _filtered(light: Light, kernel: NDArray[Any]) -> Light:
    return np.asarray(
        cv2.filter2D(light, cv2.CV_32F, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT_101), np.float32
    )
