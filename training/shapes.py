"""Shapes of every colour on mottled grounds, red ones among them, and mostly tilted discs before or behind.

They look like nothing in particular, so that the net learns discs and not a simulator's bay.
"""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.sim.canvas import Plane, clouds
from training.scene import HEIGHT, WIDTH, WITHOUT, Chance, Place, Scene, place_of, red_paint, seen

Colour = tuple[float, float, float]  # BGR
Ground = NDArray[np.float32]  # (HEIGHT, WIDTH, 3) BGR, 0 to 255


def shapes(chance: Chance) -> Iterator[Scene]:
    ground = _grounds(chance)
    for _ in range(int(chance.integers(0, 16))):
        _shape(ground, chance, _any_colour(chance))
    places: tuple[Place, ...] = ()
    if chance.random() >= WITHOUT:
        places = tuple(_tilted_disc(ground, chance) for _ in range(int(chance.choice([1, 1, 1, 1, 2]))))
        places = places[-1:] if len(places) == 2 and _near(*places) else places
        for _ in range(int(chance.integers(0, 3))):  # these may hide some of it, seldom most
            _shape(ground, chance, _any_colour(chance), 0.12)
    soft = cv2.GaussianBlur(ground, (0, 0), float(chance.uniform(0.4, 1.4)))
    yield Scene(seen(np.asarray(soft, np.float32)), places)


def _near(one: Place, other: Place) -> bool:
    """The later is drawn over the earlier."""
    return float(np.hypot(one[0] - other[0], one[1] - other[1])) < 0.8 * one[2] + other[2]


def _grounds(chance: Chance) -> Ground:
    """One, or one beside another."""
    ground = _mottled(chance)
    for _ in range(int(chance.choice([0, 0, 1, 2]))):
        turn, at = float(chance.uniform(0, 2 * np.pi)), chance.uniform((0, 0), (WIDTH, HEIGHT))
        y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
        share = np.clip((x - at[0]) * np.cos(turn) + (y - at[1]) * np.sin(turn) + 0.5, 0, 1)[..., None]
        ground += share.astype(np.float32) * (_mottled(chance) - ground)
    return ground


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


def _any_colour(chance: Chance) -> Colour:
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
    return red_paint(chance)


def _shape(ground: Ground, chance: Chance, colour: Colour, largest: float = 0.5) -> None:
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
    """A disc or a ball with light and shade, fresh or worn, in place."""
    u, v, radius = place_of(chance)
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
    if chance.random() < 0.2:  # a ball
        light = light * (0.35 + 0.65 * np.sqrt(np.clip(1 - 0.98 * far * far, 0, 1)))
    paint = light[..., None] * np.array(red_paint(chance), np.float32)
    if chance.random() < 0.3:  # a white or dark ring round it
        tone = float(chance.choice([30.0, 215.0]))
        ring = np.clip((1 + float(chance.uniform(0.05, 0.25)) - far) * radius + 0.5, 0, 1)
        ground += ring[..., None] * (np.float32(tone) - ground)
    if chance.random() < 0.4:
        colour = float(chance.uniform(20, 235)) * chance.uniform(0.9, 1.05, 3)
        mark = _mark(chance, along / radius, across / radius, far, radius)
        paint = paint + mark[..., None] * (colour - paint)
    ground += cover[..., None].astype(np.float32) * (paint.astype(np.float32) - ground)
    return u, v, radius


def _mark(chance: Chance, x: Plane, y: Plane, far: Plane, radius: float) -> Plane:
    """(HEIGHT, WIDTH) 0 to 1 of what is printed on a disc or has set on it; x, y, far: of each pixel, in radii."""
    kind, wide = int(chance.integers(6)), float(chance.uniform(0.06, 0.22))
    if kind == 0:  # a ring
        inside = wide - np.abs(far - float(chance.uniform(0.3, 0.8)))
    elif kind == 1:  # a bar, as of a no-entry sign
        inside = np.minimum(wide - np.abs(y), 0.8 - np.abs(x))
    elif kind == 2:  # a hole, a lamp's reflection
        at = chance.uniform(-0.5, 0.5, 2)
        inside = 2 * wide - np.hypot(x - at[0], y - at[1])
    elif kind == 3:  # lines of letters
        columns, rows = float(chance.uniform(8, 20)), float(chance.uniform(5, 9))
        inside = np.minimum(np.sin(columns * x + 3 * np.sin(2 * x)) + 0.3, np.sin(rows * y) - 0.2) / columns
        inside = np.minimum(inside, 0.75 - far)
    else:  # cement or mud on the lower third and in patches over the rim
        rough = 0.1 * clouds(chance, (HEIGHT, WIDTH), (30, 40))
        inside = y - float(chance.uniform(0.2, 0.7)) + rough
        for _ in range(int(chance.integers(0, 4))):
            turn, size = float(chance.uniform(0, 2 * np.pi)), float(chance.uniform(0.14, 0.35))
            inside = np.maximum(inside, size + rough - np.hypot(x - 0.97 * np.cos(turn), y - 0.97 * np.sin(turn)))
    return np.asarray(np.clip(inside * radius + 0.5, 0, 1), np.float32)
