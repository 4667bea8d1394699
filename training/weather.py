"""What dust, light, dirt, rain, snow and the camera make of a small clear picture, for training. Seeded.

Everything happens at the size that the net sees, in float: noise and drops are as weak as they are after the reduction.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.sim import weather
from gateway.sim.ambient import glare_map
from gateway.sim.scenario import Glare
from gateway.vision.detect.robust.proposer import HEIGHT, WIDTH
from training import scene as clear
from training.scene import Chance, Place, Scene

Picture = NDArray[np.float32]  # (HEIGHT, WIDTH, 3) BGR, 0 to 255


@dataclass(frozen=True, slots=True)
class Sample:
    """What the net sees, and where the discs are in it, px."""

    picture: Picture
    markers: tuple[Place, ...]


def weathered(scene: Scene, chance: Chance) -> Sample:
    """A part of the scene, mirrored perhaps, in some weather."""
    picture, markers = part(scene, chance)
    if chance.random() < 0.2:
        picture = _smeared(picture, chance)
    if chance.random() < 0.2:
        picture = _dirty(picture, chance)
    if chance.random() < 0.15:
        picture = _toned(picture, chance)
    share = _veil(chance)
    if share > 0:
        picture = _veiled(picture, share, chance)
    if chance.random() < 0.2:
        picture = _drops(picture, chance)
    if chance.random() < 0.07:
        picture = _sunny(picture, chance)
    picture = _seen(picture, share, chance)
    if chance.random() < 0.15:
        picture = _stored(picture, chance)
    if chance.random() < 0.02:  # the rest of the frame never arrived
        picture[int(chance.integers(HEIGHT // 3, HEIGHT)) :] = 128
    return Sample(picture, markers)


def part(scene: Scene, chance: Chance) -> tuple[Picture, tuple[Place, ...]]:
    """A window of the scene that has the shape of the net's picture, scaled to it."""
    across = float(chance.uniform(0.6, 1.0)) * clear.HEIGHT * WIDTH / HEIGHT
    step = across / WIDTH
    x = float(chance.uniform(0, clear.WIDTH - across))
    y = float(chance.uniform(0, clear.HEIGHT - step * HEIGHT))
    mirrored = bool(chance.random() < 0.5)
    matrix = np.array([[step, 0, x + (step - 1) / 2], [0, step, y + (step - 1) / 2]])
    if mirrored:
        matrix[0] = [-step, 0, x + across - 1 - (step - 1) / 2]
    sharp = cv2.GaussianBlur(scene.image, (0, 0), 0.35 * step)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    cut = np.asarray(cv2.warpAffine(sharp.astype(np.float32), matrix, (WIDTH, HEIGHT), flags=flags), np.float32)
    at = [((u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1], r / step) for u, v, r in scene.markers]
    return cut, tuple((float(u), float(v), float(r)) for u, v, r in at if 0 <= u < WIDTH and 0 <= v < HEIGHT)


def _veil(chance: Chance) -> float:
    """Clear air in a quarter, thick dust in half."""
    kind = chance.random()
    if kind < 0.25:
        return 0.0
    return float(chance.uniform(0.1, 0.7) if kind < 0.5 else chance.uniform(0.7, 0.96))


def _cloud(chance: Chance) -> NDArray[np.float32]:
    """(HEIGHT, WIDTH): smooth, 0 to 1, of structure of a drawn size."""
    cells = int(chance.integers(2, 9))
    small = chance.uniform(0, 1, (cells, cells + 1)).astype(np.float32)
    return np.asarray(np.clip(cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), 0, 1), np.float32)


def _veiled(picture: Picture, share: float, chance: Chance) -> Picture:
    """Airlight of a drawn light and a weak tint over it, in clouds."""
    depth = -np.log(1 - share) * (1 + float(chance.uniform(0, 0.8)) * (_cloud(chance) * 2 - 1))
    cover = (1 - np.exp(-np.clip(depth, 0, 3.6)))[..., None].astype(np.float32)
    tinted = 0.06 if chance.random() < 0.8 else 0.4  # dust, or murky water
    air = float(chance.uniform(90, 235)) * chance.uniform(1 - tinted, 1 + min(tinted, 0.15), 3)
    light = 1 + float(chance.uniform(0, 0.15)) * (_cloud(chance)[..., None] * 2 - 1)
    return np.asarray(picture * (1 - cover) + air.astype(np.float32) * light * cover, np.float32)


def _dirty(picture: Picture, chance: Chance) -> Picture:
    """Out of focus dirt on the lens, over a fifth of the picture or so."""
    cover = np.zeros((HEIGHT, WIDTH), np.float32)
    for _ in range(int(chance.integers(2, 14))):
        at = (int(chance.integers(WIDTH)), int(chance.integers(HEIGHT)))
        cv2.circle(cover, at, int(chance.integers(2, 18)), float(chance.uniform(0.3, 0.95)), -1)
    cover = np.asarray(cv2.GaussianBlur(cover, (0, 0), float(chance.uniform(1, 4))), np.float32)[..., None]
    tone = float(chance.uniform(20, 190)) * np.array([0.85, 0.95, 1.0], np.float32)
    return np.asarray(picture + cover * (tone - picture), np.float32)


def _drops(picture: Picture, chance: Chance) -> Picture:
    """Rain as slanted streaks, or snow as dots, lighter than what is behind."""
    cover = np.zeros((HEIGHT, WIDTH), np.float32)
    rain, slant = chance.random() < 0.5, float(chance.uniform(-0.3, 0.3))
    for _ in range(int(chance.integers(20, 220))):
        x, y = (int(value) for value in chance.uniform((0, 0), (WIDTH, HEIGHT)))
        if rain:
            length = float(chance.uniform(3, 16))
            end = round(x + slant * length), round(y + length)
            cv2.line(cover, (x, y), end, float(chance.uniform(0.1, 0.5)), 1, cv2.LINE_AA)
        else:
            size = int(chance.integers(8, 40))
            cv2.circle(cover, (x * 16, y * 16), size, float(chance.uniform(0.3, 1.0)), -1, cv2.LINE_AA, 4)
    return np.asarray(picture + cover[..., None] * (np.float32(chance.uniform(170, 245)) - picture), np.float32)


def _smeared(picture: Picture, chance: Chance) -> Picture:
    """Motion or focus."""
    if chance.random() < 0.5:
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), float(chance.uniform(0.4, 2))), np.float32)
    kernel = np.zeros((7, 7), np.float32)
    turn = float(chance.uniform(0, np.pi))
    reach = np.array([np.cos(turn), np.sin(turn)]) * 3 * chance.uniform(0.3, 1)
    ends = [tuple(int(v) for v in np.rint((np.array([3, 3]) + sign * reach) * 16)) for sign in (-1, 1)]
    cv2.line(kernel, ends[0], ends[1], 1.0, 1, cv2.LINE_AA, 4)
    kernel[3, 3] = max(kernel[3, 3], 1.0)
    return np.asarray(cv2.filter2D(picture, -1, kernel / kernel.sum()), np.float32)


def _toned(picture: Picture, chance: Chance) -> Picture:
    """Paler, by up to half, and another gamma."""
    grey = picture.mean(axis=2, keepdims=True)
    pale = picture + float(chance.uniform(0, 0.5)) * (grey - picture)
    return np.asarray(255 * (np.clip(pale, 0, 400) / 255) ** float(chance.uniform(0.6, 1.6)), np.float32)


def _sunny(picture: Picture, chance: Chance) -> Picture:
    """A low sun in the picture or just outside, and what the lens scatters."""
    u, v = chance.uniform((-20, -20), (WIDTH + 20, HEIGHT))
    sun = Glare(u_px=float(u), v_px=float(v), radius_px=float(chance.uniform(1, 6)), level=60.0, scatter=0.02)
    return np.asarray(picture + 255 * glare_map(sun, WIDTH, HEIGHT)[..., None], np.float32)


def _seen(picture: Picture, share: float, chance: Chance) -> Picture:
    """The camera: colour cast, light, noise (reduced with the picture), saturation.

    What nobody could see in the end is left out: thick dust is not in the dark as well, and most of it is not clipped.
    """
    kind, level = chance.random(), 1.0
    if kind < 0.3:
        level = float(np.exp(chance.uniform(np.log(0.3 if share > 0.5 else 0.03), 0)))
    elif kind < 0.45:
        level = min(float(chance.uniform(1, 2.2)), max(1.0, 235 / max(1.0, float(np.percentile(picture, 60)))))
    elif kind < 0.55 and share < 0.5:
        level = float(chance.uniform(2, 3.6))
    cast = np.ones(3)
    if chance.random() < 0.5:
        cast = chance.uniform(0.75, 1.1, 3) if chance.random() < 0.75 else np.exp(chance.uniform(-0.7, 0.5, 3))
    lit = picture * (level * cast).astype(np.float32)
    reduced = float(chance.uniform(1.5, 10))  # the camera's picture is so much larger
    sigma = float(chance.choice([1.0, 2.0, 5.0, 12.0])) / reduced
    noisy = lit + np.float32(sigma) * chance.standard_normal(lit.shape, np.float32)
    return np.asarray(np.clip(noisy, 0, 255), np.float32)


def _stored(picture: Picture, chance: Chance) -> Picture:
    """A JPEG of a picture that is up to four times as large."""
    more = int(chance.integers(1, 5))
    large = cv2.resize(picture, None, fx=more, fy=more, interpolation=cv2.INTER_LINEAR)
    coded = weather.jpeg(np.asarray(np.rint(large), np.uint8), int(chance.integers(8, 60)))
    small = cv2.resize(coded.astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)
