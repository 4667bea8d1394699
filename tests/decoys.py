"""Drawn pictures of a red disc among other red things, and of these only: seeded, pure, with exact truth.

Where the simulated bay is one place in many weathers, these are many places: grounds from concrete to wood, and every
red thing that has fooled a detector. They are for tests, benchmarks and the documentation's pictures.

Shapes are drawn at SUPER times the size and reduced, which smooths their edges; units are px of the finished picture.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Circle
from gateway.sim.canvas import Plane, clouds
from gateway.vision.pixels import Image

SUPER = 4
RED = (45, 35, 190)
Colour = tuple[float, float, float]


@dataclass(slots=True)
class Drawing:
    """A picture being painted, `SUPER` times as large as it will be."""

    width: int
    height: int
    chance: np.random.Generator
    paint: NDArray[np.float32]

    def fill(self, cover: NDArray[np.bool_] | Plane, colour: Colour | NDArray[np.float32]) -> None:
        """Lay a colour over by `cover` (0 to 1); the ground's light and shade stay visible in it a little."""
        share = cover.astype(np.float32)[..., None]
        self.paint += share * (np.asarray(colour, np.float32) - self.paint)

    def far(self, u: float, v: float) -> tuple[Plane, Plane]:
        """Of every fine pixel from a point: du, dv in px of the finished picture."""
        x = (np.arange(self.width * SUPER, dtype=np.float32) + 0.5) / SUPER - 0.5 - u
        y = (np.arange(self.height * SUPER, dtype=np.float32) + 0.5) / SUPER - 0.5 - v
        return np.broadcast_to(x, (y.size, x.size)), np.broadcast_to(y[:, None], (y.size, x.size))

    def disc(self, u: float, v: float, radius: float, colour: Colour = RED) -> None:
        du, dv = self.far(u, v)
        self.fill(du * du + dv * dv <= radius * radius, colour)

    def ball(self, u: float, v: float, radius: float, colour: Colour = RED) -> None:
        """Lit from above left, with a highlight."""
        du, dv = self.far(u, v)
        share = np.clip((du * du + dv * dv) / radius**2, 0, 1)
        light = np.sqrt(1 - share) * 0.55 + 0.45 - 0.3 * (du + dv) / radius
        gloss = np.exp(-((du + 0.4 * radius) ** 2 + (dv + 0.4 * radius) ** 2) / (0.15 * radius) ** 2)
        shaded = np.array(colour, np.float32) * light[..., None] + 200 * gloss[..., None]
        self.fill(share < 1, np.clip(shaded, 0, 255).astype(np.float32))

    def ring(self, u: float, v: float, outer: float, inner: float, colour: Colour = RED) -> None:
        du, dv = self.far(u, v)
        square = du * du + dv * dv
        self.fill((square <= outer * outer) & (square >= inner * inner), colour)

    def polygon(self, points: list[tuple[float, float]], colour: Colour = RED) -> None:
        mask = np.zeros(self.paint.shape[:2], np.uint8)
        corners = np.rint([[(x + 0.5) * SUPER * 16, (y + 0.5) * SUPER * 16] for x, y in points]).astype(np.int32)
        cv2.fillPoly(mask, [corners], 1, cv2.LINE_8, 4)
        self.fill(mask > 0, colour)

    def box(self, u: float, v: float, half_width: float, half_height: float, colour: Colour = RED) -> None:
        du, dv = self.far(u, v)
        self.fill((np.abs(du) <= half_width) & (np.abs(dv) <= half_height), colour)

    def text(self, words: str, u: float, v: float, size: float, colour: Colour = RED) -> None:
        mask = np.zeros(self.paint.shape[:2], np.uint8)
        where = (round(u * SUPER), round(v * SUPER))
        cv2.putText(mask, words, where, cv2.FONT_HERSHEY_SIMPLEX, size * SUPER / 20, 1, round(size * SUPER / 5))
        self.fill(mask > 0, colour)

    def finished(self, blur_px: float = 0.7, noise: float = 2.0) -> Image:
        small = cv2.resize(self.paint, (self.width, self.height), interpolation=cv2.INTER_AREA)
        soft = cv2.GaussianBlur(small, (0, 0), blur_px) if blur_px > 0 else small
        grainy = soft + self.chance.standard_normal(soft.shape, dtype=np.float32) * np.float32(noise)
        return np.asarray(np.clip(np.rint(grainy), 0, 255), np.uint8)


def _concrete(chance: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    grey = 125 + 14 * clouds(chance, shape, (9, 12)) + 9 * clouds(chance, shape, (90, 120))
    return np.asarray(grey[..., None] * np.array([0.97, 1.0, 1.0], np.float32), np.float32)


def _wood(chance: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Planks with a grain, red-brown."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32) / shape[0]
    warp = 0.05 * clouds(chance, shape, (4, 3))
    grain = np.sin(140 * (y + warp)) * 0.5 + np.sin(47 * (y + warp) + 3 * x) * 0.5
    planks = (np.floor(x * 5) * 0.377) % 1 - 0.5
    light = 1 + 0.13 * grain + 0.18 * planks + 0.05 * clouds(chance, shape, (60, 80))
    return np.asarray(light[..., None] * np.array([68, 96, 152], np.float32), np.float32)


def _rust(chance: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Painted steel with blooms of rust."""
    steel = 105 + 8 * clouds(chance, shape, (60, 80))
    bloom = 1 / (1 + np.exp(-4 * (clouds(chance, shape, (14, 18)) + 0.5 * clouds(chance, shape, (60, 80)) - 0.6)))
    base = steel[..., None] * np.array([1.0, 1.0, 0.97], np.float32)
    rusty = np.array([44, 66, 128], np.float32) * (1 + 0.15 * clouds(chance, shape, (100, 130)))[..., None]
    return np.asarray(base + bloom[..., None] * (rusty - base), np.float32)


def _leaves(chance: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    rough = np.exp(0.5 * clouds(chance, shape, (70, 95)))
    return np.asarray(rough[..., None] * np.array([38, 82, 62], np.float32), np.float32)


GROUNDS: Mapping[str, Callable[[np.random.Generator, tuple[int, int]], NDArray[np.float32]]] = {
    "concrete": _concrete,
    "wood": _wood,
    "rust": _rust,
    "leaves": _leaves,
}


def sheet(width: int, height: int, ground: str, seed: int) -> Drawing:
    """An empty ground to paint on."""
    return Drawing(width, height, np.random.default_rng([seed, 78]), _ground(width, height, ground, seed).copy())


@lru_cache(maxsize=4)
def _ground(width: int, height: int, ground: str, seed: int) -> NDArray[np.float32]:
    paint = GROUNDS[ground](np.random.default_rng([seed, 77]), (height * SUPER, width * SUPER))
    return np.asarray(np.clip(paint, 0, 255), np.float32)


Painter = Callable[[Drawing, float, float, float], None]  # sheet, centre u and v, size (px)


def _lorry(s: Drawing, u: float, v: float, r: float) -> None:
    """The back of a red lorry: a body with rounded corners, and two round tail lamps too small to be the marker."""
    s.box(u, v, 1.7 * r, 0.9 * r)
    s.box(u, v - 1.1 * r, 1.4 * r, 0.3 * r, (60, 55, 50))
    s.box(u, v + 0.6 * r, 0.5 * r, 0.2 * r, (230, 230, 230))


def _half(s: Drawing, u: float, v: float, r: float) -> None:
    du, dv = s.far(u, v)
    s.fill((du * du + dv * dv <= r * r) & (du + 0.3 * dv > 0), RED)


def _crescent(s: Drawing, u: float, v: float, r: float) -> None:
    du, dv = s.far(u, v)
    s.fill((du * du + dv * dv <= r * r) & ((du - 0.5 * r) ** 2 + dv * dv > (0.85 * r) ** 2), RED)


def _tube(s: Drawing, u: float, v: float, r: float) -> None:
    """A red pipe or gas bottle, shaded round."""
    du, dv = s.far(u, v)
    light = np.sqrt(np.clip(1 - (du / (0.7 * r)) ** 2, 0, 1)) * 0.8 + 0.3
    s.fill(
        (np.abs(du) < 0.7 * r) & (np.abs(dv) < 2 * r), (np.array(RED, np.float32) * light[..., None]).astype(np.float32)
    )


def _star(s: Drawing, u: float, v: float, r: float) -> None:
    turns = np.arange(10) * np.pi / 5
    reach = np.where(np.arange(10) % 2, 0.45, 1.1) * r
    s.polygon([(u + d * np.sin(t), v - d * np.cos(t)) for t, d in zip(turns, reach, strict=True)])


def _cross(s: Drawing, u: float, v: float, r: float) -> None:
    s.box(u, v, r, 0.35 * r)
    s.box(u, v, 0.35 * r, r)


def _triangle(s: Drawing, u: float, v: float, r: float) -> None:
    s.polygon([(u, v - 1.2 * r), (u + 1.1 * r, v + 0.8 * r), (u - 1.1 * r, v + 0.8 * r)])


DECOYS: Mapping[str, Painter] = {
    "square": lambda s, u, v, r: s.box(u, v, r, r),
    "oblong": lambda s, u, v, r: s.box(u, v, 1.8 * r, 0.7 * r),
    "triangle": _triangle,
    "star": _star,
    "cross": _cross,
    "ring": lambda s, u, v, r: s.ring(u, v, r, 0.68 * r),
    "half disc": _half,
    "crescent": _crescent,
    "tube": _tube,
    "lorry": _lorry,
    "text": lambda s, u, v, r: s.text("STOP 80", u - 2 * r, v + 0.5 * r, r),
    "blue disc": lambda s, u, v, r: s.disc(u, v, r, (190, 60, 35)),
    "green disc": lambda s, u, v, r: s.disc(u, v, r, (50, 160, 60)),
    "yellow disc": lambda s, u, v, r: s.disc(u, v, r, (30, 200, 215)),
    "grey disc": lambda s, u, v, r: s.disc(u, v, r, (190, 190, 190)),
}
"""Things that are not the marker, by name."""


def beside(s: Drawing, paint: Painter, marker: Circle) -> None:
    """A decoy of a drawn size near the marker, partly behind it perhaps: paint the marker afterwards."""
    turn = s.chance.uniform(0, 2 * np.pi)
    apart = s.chance.uniform(1.2, 2.2) * marker.radius_px + 0.22 * s.height
    size = s.chance.uniform(0.1, 0.25) * s.height
    paint(s, marker.u_px + apart * float(np.cos(turn)), marker.v_px + apart * float(np.sin(turn)), float(size))


def marker_at(s: Drawing, radius_share: float) -> Circle:
    """A place for a disc of `radius_share` of the shorter side, off the middle by a quarter of the room at most."""
    radius = radius_share * min(s.width, s.height)
    u = s.width / 2 + s.chance.uniform(-0.25, 0.25) * (s.width - 2.6 * radius)
    v = s.height / 2 + s.chance.uniform(-0.25, 0.25) * (s.height - 2.6 * radius)
    return Circle(float(u), float(v), float(radius))
