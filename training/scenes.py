"""Small pictures with and without a marker, to train on. Seeded.

They are clear and well lit; `training.weather` adds dust, darkness, dirt, rain and the rest. All of them are generated:
no photo is among them.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gateway.sim.render import Painter
from gateway.sim.scenario import Camera, Clutter, Dust, Fault, FaultKind, Light, Marker, Scenario, Surface
from gateway.sim.world import World
from tests import decoys
from training.scene import HEIGHT, WIDTH, WITHOUT, Chance, Place, Scene, place_of, red_paint
from training.shapes import shapes
from training.worn import worn

BAY_FRAMES, SHEET_FRAMES = 16, 3  # of one painted bay, of one drawn ground: these take longer than what is put on them
HIDDEN_S = 1000.0  # world time from which on the marker is covered
DECOYS = tuple(decoys.DECOYS.values())
GROUNDS = tuple(decoys.GROUNDS)


def scenes(seed: int, count: int) -> Iterator[Scene]:
    """`count` of them: some of one bay, of another bay's worn markers, of four grounds, and 40 of shapes, in turn."""
    kinds = (rendered, worn, *[drawn] * 4, *[shapes] * 40)
    made = 0
    for number in range(count):
        for scene in kinds[number % len(kinds)](np.random.default_rng([seed, number])):
            yield scene
            made += 1
            if made == count:
                return


def rendered(chance: Chance) -> Iterator[Scene]:
    """One bay of the simulator from many places: stained, rusty, worn, with red things and a lamp."""
    hidden = Fault(kind=FaultKind.MARKER_HIDDEN, at_s=HIDDEN_S, for_s=HIDDEN_S)
    scenario = Scenario(
        seed=int(chance.integers(1 << 30)),
        camera=Camera(width_px=WIDTH, height_px=HEIGHT, focal_px=225.0, noise=0.0, exposure_ms=0.0),
        marker=Marker(wear=float(chance.uniform(0, 1))),
        light=Light(
            gradient=float(chance.uniform(0, 0.5)), gradient_deg=float(chance.uniform(-180, 180)),
            shadow=float(chance.choice([0.0, 0.3, 0.6])),
        ),
        dust=Dust(density=0.0),
        surface=Surface(stains=float(chance.uniform(0, 1)), rust=float(chance.choice([0.0, 0.4, 0.8, 1.0]))),
        clutter=Clutter(things=int(chance.integers(0, 11)), seed=int(chance.integers(1000))),
        faults=(hidden,),
    )  # fmt: skip
    painter, start = Painter(scenario), World(scenario).truth(0.0)
    for number in range(BAY_FRAMES):
        u, v, radius = place_of(chance)
        without = chance.random() < WITHOUT
        truth = replace(
            start, t_s=1.5 * HIDDEN_S if without else 0.0, u_px=u, v_px=v, radius_px=radius,
            camera_mm=225.0 * 90.0 / radius, spout=float(chance.uniform(0, 0.4)) if chance.random() < 0.15 else 0.0,
            lamp=bool(chance.random() < 0.3),
        )  # fmt: skip
        yield Scene(painter.frame(truth, number), () if without else ((u, v, radius),))


def drawn(chance: Chance) -> Iterator[Scene]:
    """Up to three decoys on a ground of `tests.decoys`, and mostly a disc or a ball before them."""
    ground, seed = str(chance.choice(GROUNDS)), int(chance.integers(1 << 30))
    for number in range(SHEET_FRAMES):
        sheet = decoys.sheet(WIDTH, HEIGHT, ground, seed)
        sheet.chance = np.random.default_rng([seed, number])
        for _ in range(int(chance.integers(0, 4))):
            u, v, size = place_of(chance)
            DECOYS[int(chance.integers(len(DECOYS)))](sheet, u, v, float(np.clip(size, 6, 45)))
        if chance.random() < WITHOUT:
            places: tuple[Place, ...] = ()
        else:
            places = (place_of(chance),)
            ((u, v, radius),) = places
            red = red_paint(chance)
            if chance.random() < 0.5:
                sheet.ball(u, v, radius, red)
            else:
                sheet.disc(u, v, radius, red)
            if chance.random() < 0.3:  # something hangs before a part of it
                _before(sheet, chance, places[0])
        yield Scene(sheet.finished(float(chance.uniform(0, 1.2)), float(chance.uniform(0, 3))), places)


def _before(sheet: decoys.Drawing, chance: Chance, place: Place) -> None:
    u, v, radius = place
    turn, grey = chance.uniform(0, 2 * np.pi), float(chance.uniform(20, 200))
    away = float(chance.uniform(0.75, 1.1)) * radius
    half = float(chance.uniform(0.1, 0.6)) * radius
    sheet.box(u + away * np.cos(turn), v + away * np.sin(turn), half, half, (grey, grey, grey))
