"""Small pictures with and without a marker, to train on: rendered bays, drawn scenes, loose shapes. Seeded.

They are clear and well lit; `training.weather` adds dust, darkness, dirt, rain and the rest. All of them are generated:
no photo is among them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.sim.canvas import clouds
from gateway.sim.render import Painter
from gateway.sim.scenario import Camera, Clutter, Dust, Fault, FaultKind, Light, Marker, Scenario, Surface
from gateway.sim.world import World
from gateway.vision.pixels import Image
from tests import decoys

WIDTH, HEIGHT = 240, 180
SMALLEST, LARGEST = 0.012, 0.34  # radius of a marker, share of the diagonal
BAY_FRAMES, SHEET_FRAMES = 12, 3  # of one painted bay, of one drawn ground: these take longer than what is put on them
WITHOUT = 0.25  # share of the pictures without a marker
HIDDEN_S = 1000.0  # world time from which on the marker is covered
DECOYS = tuple(decoys.DECOYS.values())
GROUNDS = tuple(decoys.GROUNDS)

Chance = np.random.Generator
Place = tuple[float, float, float]  # u, v, radius, px
Ground = NDArray[np.float32]  # (HEIGHT, WIDTH, 3) BGR, 0 to 255


@dataclass(frozen=True, slots=True)
class Scene:
    """A (HEIGHT, WIDTH, 3) uint8 BGR picture and the marker in it; its radius is the geometric mean of its axes."""

    image: Image
    marker: Place | None


def scenes(seed: int, count: int) -> Iterator[Scene]:
    """`count` of them, about a third of each kind."""
    kinds = (rendered, *[drawn] * 4, *[shapes] * 11)  # a dozen pictures of one bay, three of one ground, one of shapes
    made = 0
    for number in range(count):
        chance = np.random.default_rng([seed, number])
        for scene in kinds[number % len(kinds)](chance):
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
        u, v, radius = _place(chance)
        without = chance.random() < WITHOUT
        truth = replace(
            start, t_s=1.5 * HIDDEN_S if without else 0.0, u_px=u, v_px=v, radius_px=radius,
            camera_mm=225.0 * 90.0 / radius, spout=float(chance.uniform(0, 0.4)) if chance.random() < 0.15 else 0.0,
            lamp=bool(chance.random() < 0.3),
        )  # fmt: skip
        yield Scene(painter.frame(truth, number), None if without else (u, v, radius))


def drawn(chance: Chance) -> Iterator[Scene]:
    """Up to three decoys on a ground of `tests.decoys`, and mostly a disc or a ball before them."""
    ground, seed = str(chance.choice(GROUNDS)), int(chance.integers(1 << 30))
    for number in range(SHEET_FRAMES):
        sheet = decoys.sheet(WIDTH, HEIGHT, ground, seed)
        sheet.chance = np.random.default_rng([seed, number])
        for _ in range(int(chance.integers(0, 4))):
            u, v, size = _place(chance)
            DECOYS[int(chance.integers(len(DECOYS)))](sheet, u, v, float(np.clip(size, 6, 45)))
        if chance.random() < WITHOUT:
            place = None
        else:
            place = u, v, radius = _place(chance)
            red = _red(chance)
            if chance.random() < 0.5:
                sheet.ball(u, v, radius, red)
            else:
                sheet.disc(u, v, radius, red)
            if chance.random() < 0.3:  # something hangs before a part of it
                _before(sheet, chance, place)
        yield Scene(sheet.finished(float(chance.uniform(0, 1.2)), float(chance.uniform(0, 3))), place)


def _before(sheet: decoys.Drawing, chance: Chance, place: Place) -> None:
    u, v, radius = place
    turn, grey = chance.uniform(0, 2 * np.pi), float(chance.uniform(20, 200))
    away = float(chance.uniform(0.75, 1.1)) * radius
    half = float(chance.uniform(0.1, 0.6)) * radius
    sheet.box(u + away * np.cos(turn), v + away * np.sin(turn), half, half, (grey, grey, grey))


def shapes(chance: Chance) -> Iterator[Scene]:
    """Shapes of every colour on a mottled ground, red ones among them, and mostly a tilted disc before or behind."""
    ground = _mottled(chance)
    for _ in range(int(chance.integers(0, 16))):
        _shape(ground, chance, _any_colour(chance))
    place = None
    if chance.random() >= WITHOUT:
        place = _tilted_disc(ground, chance)
        for _ in range(int(chance.integers(0, 3))):  # these may hide some of it, seldom most
            _shape(ground, chance, _any_colour(chance), 0.12)
    soft = cv2.GaussianBlur(ground, (0, 0), float(chance.uniform(0.4, 1.4)))
    yield Scene(np.asarray(np.clip(np.rint(soft), 0, 255), np.uint8), place)


def _mottled(chance: Chance) -> Ground:
    """(HEIGHT, WIDTH, 3) float: a colour with texture of several sizes, light from one side."""
    shape = (HEIGHT, WIDTH)
    colour = np.array(_any_colour(chance), np.float32)
    light = np.ones(shape, np.float32)
    for cells in (3, 9, 30, 80):
        light += float(chance.uniform(0, 0.22)) * clouds(chance, shape, (cells, cells * 4 // 3))
    y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j].astype(np.float32)
    light += float(chance.uniform(-0.4, 0.4)) * x + float(chance.uniform(-0.4, 0.4)) * y
    tint = 1 + float(chance.uniform(0, 0.15)) * np.stack([clouds(chance, shape, (8, 10)) for _ in range(3)], axis=2)
    return np.ascontiguousarray(np.clip(light, 0.05, 2)[..., None] * tint * colour, np.float32)


def _any_colour(chance: Chance) -> tuple[float, float, float]:
    """Grey in two of five cases, wood and rust in one, any colour in one, red in one."""
    kind, light = chance.random(), float(chance.uniform(15, 235))
    if kind < 0.4:
        return light, light * float(chance.uniform(0.9, 1.1)), light * float(chance.uniform(0.9, 1.1))
    if kind < 0.6:  # between red and orange, weak
        ratio = float(chance.uniform(1.2, 2.1))
        return light / ratio**1.7, light / ratio, light
    if kind < 0.8:
        b, g, r = (float(value) for value in chance.uniform(10, 240, 3))
        return b, g, r
    return _red(chance)


def _red(chance: Chance) -> tuple[float, float, float]:
    """Paint, BGR: bright or dark, fresh or pale, leaning to magenta or orange a little."""
    red = float(chance.uniform(70, 240))
    green = red / float(chance.uniform(2.2, 7.0))
    return green * float(chance.uniform(0.6, 1.5)), green, red


def _shape(ground: Ground, chance: Chance, colour: decoys.Colour, largest: float = 0.5) -> None:
    """A bar, a polygon, a ring, an ellipse, a line or a text, in place; a filled ellipse is never red."""
    size = float(np.exp(chance.uniform(np.log(3), np.log(largest * HEIGHT))))
    at = chance.uniform((0, 0), (WIDTH, HEIGHT))
    kind = int(chance.integers(6))
    fixed = [round(float(value) * 16) for value in at]
    if kind == 0:
        turn, flat = chance.uniform(0, np.pi), chance.uniform(0.05, 1)
        along = np.array([np.cos(turn), np.sin(turn)]) * size
        across = np.array([-np.sin(turn), np.cos(turn)]) * size * flat
        corners = np.array([at + along + across, at + along - across, at - along - across, at - along + across])
        cv2.fillPoly(ground, [np.rint(corners * 16).astype(np.int32)], colour, cv2.LINE_AA, 4)
    elif kind == 1:
        turns = np.sort(chance.uniform(0, 2 * np.pi, int(chance.integers(3, 7))))
        corners = at + size * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        cv2.fillPoly(ground, [np.rint(corners * 16).astype(np.int32)], colour, cv2.LINE_AA, 4)
    elif kind == 2:
        wide = max(1, round(size * float(chance.uniform(0.1, 0.4))))
        cv2.circle(ground, fixed, round(size * 16), colour, wide, cv2.LINE_AA, 4)
    elif kind == 3:
        grey = (colour[0], colour[0], colour[0])
        axes = [round(size * 16), round(size * float(chance.uniform(0.3, 1)) * 16)]
        cv2.ellipse(ground, fixed, axes, float(chance.uniform(0, 180)), 0, 360, grey, -1, cv2.LINE_AA, 4)
    elif kind == 4:
        to = [round(float(value) * 16) for value in chance.uniform((0, 0), (WIDTH, HEIGHT))]
        cv2.line(ground, fixed, to, colour, max(1, round(size * 0.15)), cv2.LINE_AA, 4)
    else:
        words = "".join(chance.choice(list("ABDEFHKLMNPRSTUXYZ0123456789"), 5))
        where = (round(float(at[0]) - size), round(float(at[1])))
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        cv2.putText(mask, words, where, cv2.FONT_HERSHEY_SIMPLEX, size / 25, 255, max(1, round(size / 8)), cv2.LINE_AA)
        ground += mask[..., None].astype(np.float32) / 255 * (np.array(colour, np.float32) - ground)


def _tilted_disc(ground: Ground, chance: Chance) -> Place:
    """A disc with light and shade, in place."""
    u, v, radius = _place(chance)
    flat, turn = 1 - float(chance.uniform(0, 1)) ** 2 * 0.4, float(chance.uniform(0, np.pi))
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    du, dv = x - np.float32(u), y - np.float32(v)
    along, across = du * np.cos(turn) + dv * np.sin(turn), dv * np.cos(turn) - du * np.sin(turn)
    axes = radius / np.sqrt(flat), radius * np.sqrt(flat)
    far = np.sqrt((along / axes[0]) ** 2 + (across / axes[1]) ** 2)
    cover = np.clip((1 - far) * radius + 0.5, 0, 1)
    lean = chance.uniform(-0.35, 0.35, 2)
    worn = 0.12 * clouds(chance, (HEIGHT, WIDTH), (30, 40))
    light = np.clip(1 + (lean[0] * du + lean[1] * dv) / radius + worn, 0.2, 1.6)
    paint = light[..., None] * np.array(_red(chance), np.float32)
    if chance.random() < 0.3:  # a white or dark ring round it
        tone = float(chance.choice([30.0, 215.0]))
        ring = np.clip((1 + float(chance.uniform(0.05, 0.25)) - far) * radius + 0.5, 0, 1)
        ground += ring[..., None] * (np.float32(tone) - ground)
    ground += cover[..., None].astype(np.float32) * (paint.astype(np.float32) - ground)
    return u, v, radius


def _place(chance: Chance) -> Place:
    """The radius is spread evenly over the logarithm; a border of the picture cuts off a third of the disc at most."""
    radius = float(np.exp(chance.uniform(np.log(SMALLEST), np.log(LARGEST)))) * float(np.hypot(WIDTH, HEIGHT))
    u, v = (float(chance.uniform(0.35 * radius, side - 1 - 0.35 * radius)) for side in (WIDTH, HEIGHT))
    return u, v, radius
