"""A picture to train on, and what all kinds of them share."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.vision.pixels import Image

WIDTH, HEIGHT = 240, 180
SMALLEST, LARGEST = 0.012, 0.4  # radius of a marker, share of the diagonal
WITHOUT = 0.25  # share of the pictures without a marker

Chance = np.random.Generator
Place = tuple[float, float, float]  # u, v, radius, px


@dataclass(frozen=True, slots=True)
class Scene:
    """A (HEIGHT, WIDTH, 3) uint8 BGR picture and the discs in it; a radius is the geometric mean of the axes."""

    image: Image
    markers: tuple[Place, ...]


def place_of(chance: Chance) -> Place:
    """The radius is spread evenly over the logarithm; a border of the picture cuts off a third of the disc at most."""
    radius = float(np.exp(chance.uniform(np.log(SMALLEST), np.log(LARGEST)))) * float(np.hypot(WIDTH, HEIGHT))
    u, v = (float(chance.uniform(0.35 * radius, side - 1 - 0.35 * radius)) for side in (WIDTH, HEIGHT))
    return u, v, radius


def red_paint(chance: Chance) -> tuple[float, float, float]:
    """Paint, BGR: bright or dark, fresh or pale, leaning to magenta or orange a little."""
    red = float(chance.uniform(70, 240))
    green = red / float(chance.uniform(2.2, 7.0))
    return green * float(chance.uniform(0.6, 1.5)), green, red


def seen(light: NDArray[np.float32]) -> Image:
    return np.asarray(np.clip(np.rint(light), 0, 255), np.uint8)
