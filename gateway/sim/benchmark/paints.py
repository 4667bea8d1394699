"""What is painted on the marker, lies over it, or is there in its place: textures in mm round the marker's centre.

A paint changes the marker's own texture, so the disc keeps its rim; a cover is laid over it with a shape of its own.
"""

import math
from collections.abc import Callable

import cv2
import numpy as np

from gateway.sim.canvas import Canvas, Colour, Plane, clouds, u8
from gateway.sim.textures import FINE, RUST, TextureLevel
from gateway.sim.weather import Chance

RED: Colour = (46, 38, 176)
WHITE: Colour = (226, 228, 226)
CEMENT = (168.0, 172.0, 176.0)
Paint = Callable[[Canvas, float, Chance], None]  # on the marker's texture, its radius in mm
Cover = Callable[[float, Chance], TextureLevel]
MOST_HIDDEN = 0.5  # share of the rim under a crust, at most


def faded(canvas: Canvas, r: float, chance: Chance) -> None:
    """Bleached by the sun, unevenly: pink grey."""
    share = float(chance.uniform(0.5, 0.72)) + 0.06 * clouds(chance, canvas.image.shape[:2], (6, 6))
    _blend(canvas, np.clip(share, 0, 0.85), (172.0, 168.0, 192.0))


def lettered(canvas: Canvas, r: float, chance: Chance) -> None:
    canvas.text(str(chance.choice(["SILO 3", "CEM 42", "BAY 12"])), (-0.72 * r, -0.05 * r), 0.34 * r, WHITE)
    canvas.text(str(chance.choice(["MAX 2 BAR", "FILL HERE"])), (-0.66 * r, 0.42 * r), 0.2 * r, WHITE)


def white_ring(canvas: Canvas, r: float, chance: Chance) -> None:
    canvas.disc((0, 0), float(chance.uniform(0.6, 0.75)) * r, WHITE, ring=float(chance.uniform(0.12, 0.25)) * r)


def rust_lid(canvas: Canvas, r: float, chance: Chance) -> None:
    """A steel lid that has rusted all over."""
    _lid(canvas, r, RUST, chance, 0.2)


def brown_lid(canvas: Canvas, r: float, chance: Chance) -> None:
    _lid(canvas, r, (40, 60, 110), chance, 0.04)


def amber_lamp(canvas: Canvas, r: float, chance: Chance) -> None:
    """A lit lens with rings, brighter in the middle."""
    side = canvas.image.shape[0]
    canvas.image = np.full((side, side, 3), (24, 128, 238), dtype=np.uint8)
    for k in range(1, 7):
        canvas.disc((0, 0), r * k / 6.5, (18, 108, 206), ring=0.03 * r)
    away = np.hypot(*_axes(side, 1.1))
    _blend(canvas, 0.6 * np.exp(-((away / 0.4) ** 2)), (150.0, 214.0, 255.0))


def _lid(canvas: Canvas, r: float, colour: Colour, chance: Chance, mottled: float) -> None:
    side = canvas.image.shape[0]
    shade = (
        1 + mottled * clouds(chance, (side, side), (12, 12)) + 0.5 * mottled * clouds(chance, (side, side), (60, 60))
    )
    canvas.image = u8(np.clip(shade[..., None] * np.array(colour, np.float32), 0, 255).astype(np.uint8))
    dark: Colour = (colour[0] // 2, colour[1] // 2, colour[2] // 2)
    canvas.disc((0.01 * r, 0.012 * r), 0.7 * r, dark, ring=0.03 * r)
    canvas.line([(-0.36 * r, 0.05 * r), (0.38 * r, 0.05 * r)], 0.13 * r, dark)
    canvas.line([(-0.37 * r, 0.0), (0.37 * r, 0.0)], 0.12 * r, colour)


def crust(r: float, chance: Chance) -> TextureLevel:
    """Cement that has set on the lower third and in patches over the rim; the dark ring of the port shows beyond it."""
    half = 1.2 * r
    side = round(2 * half * FINE)
    x, y = _axes(side, 1.2)
    rough = 0.6 * clouds(chance, (side, side), (9, 9)) + 0.4 * clouds(chance, (side, side), (40, 40))
    ends = 1.015 + 0.018 * rough - np.hypot(x, y)
    depth = np.minimum(y - 0.36 + 0.1 * rough, ends)
    for _ in range(5):
        turn, size = float(chance.uniform(0, 2 * math.pi)), float(chance.uniform(0.14, 0.3))
        lump = size + 0.07 * rough - np.hypot(x - 0.97 * math.cos(turn), y - 0.97 * math.sin(turn))
        more = np.maximum(depth, np.minimum(lump, ends))
        if hidden_share(more > 0, 1.2) <= MOST_HIDDEN:
            depth = more
    tone = 0.94 + 0.05 * rough + 0.06 * clouds(chance, (side, side), (90, 90))
    # Thick at its edge: lit above, in the shade below.
    slope = cv2.GaussianBlur(np.clip(depth, 0, 0.06).astype(np.float32), (0, 0), 3)
    tone -= 2.5 * np.asarray(np.gradient(np.asarray(slope), axis=0)) * FINE
    paint = np.clip(tone[..., None] * np.array(CEMENT, np.float32), 0, 255).astype(np.uint8)
    share = np.clip(depth * r * FINE + 0.5, 0, 1)
    return TextureLevel(u8(paint), (share * 255).astype(np.uint8), FINE, -half, -half)


def hidden_share(covered: np.ndarray, half: float) -> float:
    """Of the rim (radius 1) in a square mask that reaches `half` to either side."""
    turns = np.linspace(0, 2 * math.pi, 720, endpoint=False)
    side = covered.shape[0]
    at = [np.clip((0.99 * f(turns) / half + 1) / 2 * side, 0, side - 1).astype(int) for f in (np.sin, np.cos)]
    return float(covered[at[0], at[1]].mean())


def octagon(r: float, chance: Chance) -> TextureLevel:
    """A stop sign, with a border and letters or plain."""
    points = [(1.15 * r * math.cos(a), 1.15 * r * math.sin(a)) for a in (np.arange(8) + 0.5) * math.pi / 4]
    sign, mask = _sheet(r, RED)
    mask.polygon(points, (255,) * 3)
    if chance.random() < 0.5:
        sign.polygon(points, WHITE)
        sign.polygon([(0.93 * x, 0.93 * y) for x, y in points], RED)
        sign.text("STOP", (-0.6 * r, 0.17 * r), 0.36 * r, WHITE)
    return _level(sign, mask)


def square(r: float, chance: Chance) -> TextureLevel:
    """A red plate with four screws."""
    plate, mask = _sheet(r, RED)
    mask.box(-0.95 * r, -0.95 * r, 1.9 * r, 1.9 * r, (255,) * 3)
    for x in (-0.8, 0.8):
        for y in (-0.8, 0.8):
            plate.disc((x * r, y * r), 0.06 * r, (30, 26, 116))
    return _level(plate, mask)


def half_disc(r: float, chance: Chance) -> TextureLevel:
    """Half of a red disc, its straight side to the right."""
    disc, mask = _sheet(r, RED)
    mask.disc((0, 0), r, (255,) * 3)
    mask.box(0, -1.3 * r, 1.3 * r, 2.6 * r, (0,) * 3)
    return _level(disc, mask)


def hose_ring(r: float, chance: Chance) -> TextureLevel:
    """A red hose, coiled up."""
    hose, mask = _sheet(r, (34, 32, 134))
    wide = float(chance.uniform(0.14, 0.22)) * r
    mask.disc((0, 0), 0.9 * r, (255,) * 3, ring=wide)
    hose.disc((-0.02 * r, -0.03 * r), 0.9 * r, (62, 58, 186), ring=0.3 * wide)
    return _level(hose, mask)


def letters(r: float, chance: Chance) -> TextureLevel:
    paint, mask = _sheet(r, RED)
    mask.text(str(chance.choice(["STOP", "COOP", "BOX 8"])), (-1.15 * r, 0.2 * r), 0.55 * r, (255,) * 3)
    return _level(paint, mask)


def _sheet(r: float, colour: Colour) -> tuple[Canvas, Canvas]:
    """To paint on, and to mark on what of it is there; 1.3 radii to either side."""
    side = round(2.6 * r * FINE)
    shape = (side, side, 3)
    paint = np.full(shape, colour, dtype=np.uint8)
    return Canvas(paint, FINE, -1.3 * r, -1.3 * r), Canvas(np.zeros(shape, np.uint8), FINE, -1.3 * r, -1.3 * r)


def _level(paint: Canvas, mask: Canvas) -> TextureLevel:
    return TextureLevel(paint.image, np.ascontiguousarray(mask.image[..., 0]), FINE, paint.left, paint.top)


def _axes(side: int, half: float) -> tuple[Plane, Plane]:
    """x and y of the texture's pixels in marker radii."""
    along = (((np.arange(side, dtype=np.float32) + 0.5) / side) * 2 - 1) * np.float32(half)
    return np.broadcast_to(along, (side, side)), np.broadcast_to(along[:, None], (side, side))


def _blend(canvas: Canvas, share: np.ndarray, colour: tuple[float, float, float]) -> None:
    part = np.asarray(share, np.float32)[..., None]
    mixed = canvas.image * (1 - part) + np.array(colour, np.float32) * part
    canvas.image = u8(np.clip(mixed, 0, 255).astype(np.uint8))
