"""One clear view of a bay with the marker at a drawn place, and what is known of it."""

import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from gateway.sim import weather
from gateway.sim.benchmark.paints import Cover, Paint, hidden_share
from gateway.sim.canvas import Canvas, u8
from gateway.sim.render import Painter
from gateway.sim.scenario import Camera, Clutter, Dust, Light, Marker, Pose, Scenario, Surface
from gateway.sim.textures import Surfaces, TextureLevel, pyramid, surfaces
from gateway.sim.weather import Chance
from gateway.sim.world import World

FOCAL = 600 / 640  # of the camera, frame widths
RADIUS_MM = 90.0
Place = Callable[[Chance, float, int, int], tuple[float, float]]  # radius, frame's width and height, px -> u, v


class TrueRim(NamedTuple):
    """The marker's rim in the frame, px; a circle has a = b. What stands in its place has one, too."""

    u: float
    v: float
    a: float
    b: float


@dataclass(frozen=True, slots=True)
class Shot:
    light: weather.Light
    rim: TrueRim
    z_mm: float
    visible: float | None = None  # share of the rim, where something covers it


def anywhere(chance: Chance, radius: float, width: int, height: int) -> tuple[float, float]:
    """Completely in the frame."""
    u = chance.uniform(radius + 2, max(radius + 2.01, width - 3 - radius))
    v = chance.uniform(radius + 2, max(radius + 2.01, height - 3 - radius))
    return float(u), float(v)


class PaintedBay(NamedTuple):
    scenario: Scenario
    surfaces: Surfaces
    painter: Painter


@lru_cache(maxsize=2)
def bay(seed: int, number: int, width: int, height: int, red: bool) -> PaintedBay:
    """The bay of one number: its surfaces, light and, where `red`, things that are red besides the marker."""
    chance = random.Random(f"benchmark {seed} {number}")
    scenario = Scenario(
        seed=chance.randrange(1 << 30),
        start=Pose(distance_cm=60.0),
        marker=Marker(radius_mm=RADIUS_MM, wear=chance.uniform(0, 0.6)),
        camera=Camera(width_px=width, height_px=height, focal_px=FOCAL * width, noise=0),
        light=Light(
            level=chance.uniform(0.75, 1.1), gradient_deg=chance.uniform(-180, 180), warmth=chance.uniform(-0.15, 0.2)
        ),
        dust=Dust(density=0),
        surface=Surface(stains=chance.uniform(0, 1), rust=chance.choice((0.0, 0.0, 0.5)) if red else 0.0),
        clutter=Clutter(things=chance.choice((0, 3, 5)) if red else 0),
    )
    return PaintedBay(scenario, surfaces(scenario), Painter(scenario))


def view(
    here: PaintedBay,
    place: tuple[float, float],
    radius: float,
    chance: Chance,
    *,
    marker: bool,
    paint: Paint | None,
    cover: Cover | None,
) -> Shot:
    """What the camera sees before weather and sensor do anything."""
    own = here.surfaces
    layers = own.paint if marker or paint else ()
    if paint is not None:
        canvas = Canvas(own.paint[0].image.copy(), own.paint[0].scale, own.paint[0].left_mm, own.paint[0].top_mm)
        paint(canvas, RADIUS_MM, chance)
        layers = pyramid(replace(own.paint[0], image=canvas.image))
    over: tuple[TextureLevel, ...] = ()
    visible = None
    if cover is not None:
        level = cover(RADIUS_MM, chance)
        over, visible = pyramid(level), 1 - hidden_share(u8(level.cover) > 127, -level.left_mm / RADIUS_MM)
    z_mm = FOCAL * here.scenario.camera.width_px * RADIUS_MM / radius
    truth = replace(
        World(here.scenario).truth(0),
        distance_mm=z_mm,
        camera_mm=z_mm,
        u_px=place[0],
        v_px=place[1],
        radius_px=radius,
        u_px_s=0.0,
        v_px_s=0.0,
    )
    image = here.painter.repainted(replace(own, paint=layers, over=over)).frame(truth, 0)
    rim = TrueRim(*place, radius, radius)
    return Shot(np.asarray(image, np.float32), rim, z_mm, visible)
