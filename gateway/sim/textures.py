"""The surfaces of the bay, painted once per scenario: a tank end with its filling port, the marker's paint, the yard.

Truck and paint are textures in the marker's plane, in mm from the marker's centre (x right, y down), at several
scales. Greys and yellows keep clear of the paper's red threshold on purpose (saturation below 43 or hue above 10);
only `clutter` and `rust` add red.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from gateway.sim import clutter
from gateway.sim.canvas import SHIFT, Canvas, Colour, Plane, clouds, u8
from gateway.sim.scenario import Camera, Scenario
from gateway.vision.pixels import Image

TRUCK_MM = (-960.0, -660.0, 1920.0, 1700.0)  # left, top, width, height of the painted part of the plane
NEAR_MM = (-300.0, -225.0, 600.0, 450.0)
TANK_CENTRE = (0.0, -10.0)
TANK_AXES = (760.0, 610.0)
FINE = 2.4  # px per mm of the near texture
COARSE = 1.0
COVER = 1.62  # half the side of the tarpaulin, in marker radii
RUST: Colour = (44, 62, 128)  # hue 6, saturation 167: inside the paper's first red range


@dataclass(frozen=True, slots=True)
class TextureLevel:
    """One texture at one scale. The centre of its pixel (i, j) lies at (left + (i + 0.5) / scale, ...) mm."""

    image: Image
    cover: Image | None  # 0 to 255; None: covers everything
    scale: float  # px per mm
    left_mm: float
    top_mm: float

    def halved(self) -> "TextureLevel":
        height, width = self.image.shape[:2]
        size = (width // 2, height // 2)
        cover = None if self.cover is None else u8(cv2.resize(self.cover, size, interpolation=cv2.INTER_AREA))
        image = u8(cv2.resize(self.image, size, interpolation=cv2.INTER_AREA))
        return TextureLevel(image, cover, self.scale / 2, self.left_mm, self.top_mm)


@dataclass(frozen=True, slots=True)
class Surfaces:
    near: TextureLevel  # the truck round the port, fine
    truck: tuple[TextureLevel, ...]  # all of it, finest first
    paint: tuple[TextureLevel, ...]  # the marker, a square somewhat larger than the disc; none: no marker
    cover: tuple[TextureLevel, ...]  # a tarpaulin over the port
    yard: Image  # (H, W, 3): the fixed background behind the truck
    over: tuple[TextureLevel, ...] = ()  # what lies over the marker, or in its place


def surfaces(scenario: Scenario) -> Surfaces:
    """Everything painted, in about half a second; scenarios that differ only in motion, light or dust share it."""
    size = Camera(width_px=scenario.camera.width_px, height_px=scenario.camera.height_px)
    seed, marker, surface, red = scenario.seed, scenario.marker, scenario.surface, scenario.clutter
    return _painted(Scenario(seed=seed, marker=marker, surface=surface, clutter=red, camera=size))


@lru_cache(maxsize=4)
def _painted(scenario: Scenario) -> Surfaces:
    r = scenario.marker.radius_mm
    chance = np.random.default_rng([scenario.seed, 11])
    tank = _tank(scenario, chance)
    coarse = Canvas(tank, COARSE, TRUCK_MM[0], TRUCK_MM[1])
    left, top, width, height = (round(v * COARSE) for v in NEAR_MM)
    x, y = left - round(TRUCK_MM[0] * COARSE), top - round(TRUCK_MM[1] * COARSE)
    crop = tank[y : y + height, x : x + width]
    size = (round(NEAR_MM[2] * FINE), round(NEAR_MM[3] * FINE))
    fine = Canvas(u8(cv2.resize(crop, size, interpolation=cv2.INTER_CUBIC)), FINE, NEAR_MM[0], NEAR_MM[1])
    things = clutter.things(scenario)
    rust = _rust(scenario, chance) if scenario.surface.rust > 0 else None
    for canvas, grain in ((coarse, 2.0), (fine, 3.5)):
        _fittings(canvas, r)
        if rust is not None:
            canvas.tint(rust if canvas is coarse else rust[y : y + height, x : x + width], RUST, chance)
        for thing in things:
            thing.draw(canvas)
        canvas.grain(grain, chance)
    cover = _silhouette(coarse)
    levels = [TextureLevel(coarse.image, cover, COARSE, TRUCK_MM[0], TRUCK_MM[1])]
    for _ in range(2):
        levels.append(levels[-1].halved())
    return Surfaces(
        near=TextureLevel(fine.image, None, FINE, NEAR_MM[0], NEAR_MM[1]),
        truck=tuple(levels),
        paint=pyramid(_paint(scenario, chance)),
        cover=pyramid(_tarpaulin(r, chance)),
        yard=_yard(scenario, chance),
    )


def pyramid(level: TextureLevel) -> tuple[TextureLevel, ...]:
    levels = [level]
    while levels[-1].scale > FINE / 8:
        levels.append(levels[-1].halved())
    return tuple(levels)


def _tank(scenario: Scenario, chance: np.random.Generator) -> Image:
    """The bare tank end: painted steel, dished, welded, weathered."""
    shape = (round(TRUCK_MM[3] * COARSE), round(TRUCK_MM[2] * COARSE))
    xs = ((np.arange(shape[1], dtype=np.float32) + 0.5) / COARSE + TRUCK_MM[0])[None, :]
    ys = ((np.arange(shape[0], dtype=np.float32) + 0.5) / COARSE + TRUCK_MM[1])[:, None]
    rim2 = ((xs - TANK_CENTRE[0]) / TANK_AXES[0]) ** 2 + ((ys - TANK_CENTRE[1]) / TANK_AXES[1]) ** 2
    rim = np.sqrt(rim2)
    light = 0.66 - 0.30 * np.minimum(rim2 * rim2 * rim2 * rim, 1.4)
    light += -0.05 * xs / TANK_AXES[0] - 0.10 * ys / TANK_AXES[1]
    # The sheen of a dished end under a lamp, and the knuckle where it turns into the shell.
    light += 0.07 * np.exp(-(((xs + 260) / 190) ** 2)) * np.exp(-(((ys + 250) / 130) ** 2))
    light += 0.06 * np.exp(-(((rim - 0.90) / 0.025) ** 2)) - 0.05 * np.exp(-(((rim - 0.945) / 0.02) ** 2))
    light += 0.016 * clouds(chance, shape, (9, 11)) + 0.010 * clouds(chance, shape, (60, 75))
    light += 0.008 * clouds(chance, shape, (12, 500))
    for x in (-335.0, 350.0):  # vertical weld beads: a rippled ridge, lit from the left
        at = round((x - TRUCK_MM[0]) * COARSE)
        near = slice(at - 14, at + 15)
        ripple = 0.6 + 0.4 * np.sin(ys * 1.3 + 0.3 * clouds(chance, (shape[0], 1), (40, 2)))
        ridge = 0.07 * np.exp(-(((xs[:, near] - x + 2) / 2.2) ** 2)) - 0.09 * np.exp(
            -(((xs[:, near] - x - 2.5) / 2.5) ** 2)
        )
        light[:, near] += ripple * ridge
    stains = scenario.surface.stains
    if stains > 0:
        # Rain carries cement and grime down from the catwalk: columns of noise, fading at different heights.
        columns = clouds(chance, (1, shape[1]), (2, 150))[0] + 0.7 * clouds(chance, (1, shape[1]), (2, 420))[0]
        length = 0.55 + 0.35 * clouds(chance, (1, shape[1]), (2, 60))[0]
        fall = np.clip(1.15 - (ys - TRUCK_MM[1]) / TRUCK_MM[3] / np.maximum(length, 0.15), 0, 1)
        grime = fall * np.clip(columns - 0.5, 0, 1.6) * (0.8 + 0.3 * clouds(chance, shape, (50, 200)))
        cement = np.clip(clouds(chance, shape, (14, 18)) + 0.5 * clouds(chance, shape, (70, 90)) - 1.1, 0, 1)
        light += stains * (0.14 * cement - 0.16 * np.clip(grime, 0, 1.3))
        tint = stains * np.clip(grime, 0, 1)
    else:
        tint = np.zeros((1, 1), dtype=np.float32)
    light *= 255
    image = np.empty((*shape, 3), dtype=np.float32)
    for channel, (paint, soiled) in enumerate(((1.015, 0.09), (1.0, 0.045), (0.985, 0.0))):  # cool paint, brown dirt
        np.clip(light * (paint * (1 - soiled * tint)), 0, 255, out=image[..., channel])
    return u8(image.astype(np.uint8))


def _rust(scenario: Scenario, chance: np.random.Generator) -> Plane:
    """Share of rust, 0 to 1, over the truck: it creeps from under the port's flange, runs down, and sits in patches."""
    shape = (round(TRUCK_MM[3] * COARSE), round(TRUCK_MM[2] * COARSE))
    r, rust = scenario.marker.radius_mm, scenario.surface.rust
    xs = ((np.arange(shape[1], dtype=np.float32) + 0.5) / COARSE + TRUCK_MM[0])[None, :]
    ys = ((np.arange(shape[0], dtype=np.float32) + 0.5) / COARSE + TRUCK_MM[1])[:, None]
    away = np.hypot(xs, ys) / r
    cells = (17, 19), (68, 76), (200, 225), (560, 620)
    fractal = sum((clouds(chance, shape, c) * w for c, w in zip(cells, (0.55, 0.45, 0.4, 0.3), strict=True)), 0 * away)
    runs = np.clip(clouds(chance, (1, shape[1]), (2, 220)) + 0.5 * clouds(chance, (1, shape[1]), (2, 620)) + 0.3, 0, 2)
    starts = np.clip(ys / (0.4 * r), 0, 1) * np.clip((1.45 * r - np.abs(xs)) / (0.2 * r), 0, 1)
    below = starts * np.exp(-np.maximum(away - 1.1, 0) / (0.4 + 1.6 * rust))
    flange = np.exp(-((np.maximum(np.abs(away - 1.15) - 0.12, 0) / 0.18) ** 2))
    amount = np.clip(1.1 * (fractal - 1.75 + 1.1 * rust + 1.2 * rust * flange), 0, 1) + 0.8 * rust * runs * below
    return np.asarray(np.clip(amount, 0, 0.93), dtype=np.float32)


def _fittings(canvas: Canvas, r: float) -> None:
    """What is bolted, welded and painted onto the tank; the port's neck and flange scale with the marker."""
    dark, steel, bright = (52, 53, 54), (104, 105, 106), (178, 178, 177)
    canvas.text("CEM II 42.5 R", (-250, -330), 52, (92, 88, 84))
    canvas.text("PNEUMATIC DISCHARGE MAX 2 BAR", (-232, 300), 15, (96, 93, 90))
    _ladder(canvas)
    _blow_pipe(canvas)
    _bumper(canvas)
    canvas.shade((0.07 * r, 0.10 * r), 1.42 * r, 0.55, 0.3 * r)
    for quarter in range(4):  # swing clamps of the lid
        turn = math.radians(45 + 90 * quarter)
        along, across = (math.cos(turn), math.sin(turn)), (-math.sin(turn), math.cos(turn))
        for half, reach, colour in ((0.13, 1.60, dark), (0.10, 1.57, steel), (0.03, 1.57, bright)):
            ends = [(1.2, -half), (reach, -half), (reach, half), (1.2, half)]
            canvas.polygon(
                [(r * (a * along[0] + b * across[0]), r * (a * along[1] + b * across[1])) for a, b in ends], colour
            )
    canvas.disc((0.02 * r, 0.02 * r), 1.375 * r, (38, 38, 39))
    canvas.disc((0, 0), 1.35 * r, bright)
    canvas.disc((0.012 * r, 0.012 * r), 1.33 * r, (122, 122, 122))
    for bolt in range(16):
        turn = 2 * math.pi * (bolt + 0.5) / 16
        x, y = 1.2 * r * math.cos(turn), 1.2 * r * math.sin(turn)
        canvas.disc((x + 0.015 * r, y + 0.018 * r), 0.072 * r, (48, 48, 49))
        canvas.disc((x, y), 0.062 * r, (138, 138, 137))
        hexagon = [
            (x + 0.046 * r * math.cos(turn + k), y + 0.046 * r * math.sin(turn + k)) for k in np.arange(6) * 1.0472
        ]
        canvas.polygon(hexagon, (88, 88, 89))
    canvas.disc((0, 0), 1.075 * r, (84, 84, 85))  # the gasket's groove: the dark ring round the marker
    canvas.disc((0, 0), 1.05 * r, (70, 70, 71))


def _ladder(canvas: Canvas) -> None:
    for x in (430.0, 590.0):
        canvas.box(x + 10, -660, 26, 1160, (78, 78, 79))  # its shadow on the tank
        canvas.box(x, -660, 24, 1160, (172, 172, 170))
        canvas.box(x + 3, -660, 6, 1160, (205, 205, 203))
        canvas.box(x + 19, -660, 5, 1160, (120, 120, 120))
    for y in range(-560, 480, 170):
        canvas.box(454, y + 9, 138, 14, (84, 84, 85))
        canvas.box(452, y, 140, 16, (150, 150, 149))
        canvas.box(452, y + 2, 140, 4, (192, 192, 190))


def _blow_pipe(canvas: Canvas) -> None:
    """The discharge pipe: a cylinder lit from the left, with two flanged joints."""
    canvas.box(-548, -640, 92, 1150, (74, 74, 75))
    for step in range(20):
        tone = 70 + round(125 * max(0.0, math.sin(math.pi * (step + 2) / 23)) ** 1.4)
        canvas.box(-565 + 4.2 * step, -640, 4.6, 1150, (tone, tone, tone - 2))
    for y in (-300.0, 210.0):
        canvas.box(-585, y, 124, 26, (58, 58, 59))
        canvas.box(-583, y + 3, 120, 8, (132, 132, 131))
        for k in range(5):
            canvas.disc((-570 + 23 * k, y + 17), 6, (150, 150, 149))


def _bumper(canvas: Canvas) -> None:
    for x in (-790.0, 490.0):  # twin tyres
        canvas.box(x, 734, 300, 262, (40, 40, 41))
        for step in range(8):
            canvas.box(x + 8 + 36 * step, 734, 20 if step not in (3, 4) else 30, 262, (54, 54, 55))
        canvas.box(x + 142, 734, 16, 262, (24, 24, 25))
    canvas.box(-490, 734, 980, 60, (34, 34, 35))
    canvas.box(-900, 560, 1800, 44, (40, 41, 42))
    canvas.box(-900, 604, 1800, 130, (66, 67, 68))
    canvas.box(-900, 604, 1800, 8, (104, 104, 104))
    for x in range(-560, 560, 80):  # hazard stripes: yellow, hue 24, is outside both red ranges
        canvas.polygon([(x, 700), (x + 40, 700), (x + 80, 640), (x + 40, 640)], (44, 168, 196))
    canvas.box(-150, 622, 300, 74, (196, 197, 196))
    canvas.text("BC 4207", (-118, 676), 40, (44, 44, 44))


def _silhouette(canvas: Canvas) -> Image:
    """Where the truck is, 0 or 255 with soft edges: the tank's ellipse, the ladder, the bumper."""
    mask = Canvas(np.zeros_like(canvas.image), canvas.scale, canvas.left, canvas.top)
    white = (255, 255, 255)
    axes = (round(TANK_AXES[0] * COARSE * (1 << SHIFT)), round(TANK_AXES[1] * COARSE * (1 << SHIFT)))
    cv2.ellipse(mask.image, mask.px(*TANK_CENTRE), axes, 0, 0, 360, white, -1, cv2.LINE_AA, SHIFT)
    mask.box(430, -658, 24, 1158, white)
    mask.box(590, -658, 24, 1158, white)
    mask.box(430, -560, 184, 20, white)
    mask.box(-565, -638, 88, 1148, white)
    mask.box(-900, 560, 1800, 174, white)
    mask.box(-490, 734, 980, 60, white)
    for x in (-790.0, 490.0):
        mask.box(x, 734, 300, 262, white)
    cover = mask.image[..., 0].astype(np.float32)
    shadow = Canvas(np.zeros_like(canvas.image), canvas.scale, canvas.left, canvas.top)
    shadow.polygon([(-800, 960), (800, 960), (860, 1000), (-860, 1000)], (190, 190, 190))
    soft = np.asarray(cv2.GaussianBlur(shadow.image[..., 0], (0, 0), 12 * COARSE), dtype=np.float32)
    bare = (cover < 8) & (soft > 0)  # there the truck's plane shows nothing but its shadow on the floor
    canvas.image[bare] = (22, 22, 23)
    return np.maximum(cover, soft).astype(np.uint8)


def _paint(scenario: Scenario, chance: np.random.Generator) -> TextureLevel:
    """The marker: a red lid with a groove, a grip and screws in the same red, worn; a square of 1.1 radii."""
    r, wear = scenario.marker.radius_mm, scenario.marker.wear
    half = 1.1 * r
    side = round(2 * half * FINE)
    canvas = Canvas(np.full((side, side, 3), (46, 38, 176), dtype=np.uint8), FINE, -half, -half)
    shade = 1 + 0.045 * clouds(chance, (side, side), (5, 5)) + 0.03 * clouds(chance, (side, side), (24, 24))
    shade += 0.02 * clouds(chance, (side, side), (10, 160))
    ys = np.linspace(1.1, -1.1, side, dtype=np.float32)[:, None]
    shade += 0.06 * ys  # lit from above
    canvas.image = np.clip(canvas.image * shade[..., None], 0, 255).astype(np.uint8)
    canvas.disc((0.01 * r, 0.012 * r), 0.70 * r, (30, 26, 116), ring=0.03 * r)
    canvas.disc((-0.004 * r, -0.006 * r), 0.725 * r, (66, 58, 200), ring=0.012 * r)
    for k in range(8):
        turn = 2 * math.pi * (k + 0.25) / 8
        x, y = 0.85 * r * math.cos(turn), 0.85 * r * math.sin(turn)
        canvas.disc((x + 0.008 * r, y + 0.01 * r), 0.036 * r, (28, 24, 104))
        canvas.disc((x, y), 0.03 * r, (54, 46, 188))
    canvas.line([(-0.36 * r, 0.05 * r), (0.38 * r, 0.05 * r)], 0.13 * r, (26, 22, 100))
    canvas.line([(-0.37 * r, 0.0), (0.37 * r, 0.0)], 0.12 * r, (50, 42, 180))
    canvas.line([(-0.36 * r, -0.025 * r), (0.36 * r, -0.025 * r)], 0.03 * r, (92, 84, 218))
    _wear(canvas, r, wear, chance)
    canvas.grain(4.0, chance)
    return TextureLevel(canvas.image, None, FINE, -half, -half)


def _wear(canvas: Canvas, r: float, wear: float, chance: np.random.Generator) -> None:
    """Cement dust on the lower half, scratches, chips down to the primer; nothing that eats into the rim."""
    side = canvas.image.shape[0]
    ys = np.linspace(-1.1, 1.1, side, dtype=np.float32)[:, None]
    settled = np.clip(0.35 + 0.5 * ys + 0.45 * clouds(chance, (side, side), (14, 18)), 0, 1) * 0.32 * wear
    grey = np.array([168.0, 172.0, 176.0], dtype=np.float32)
    canvas.image = (canvas.image * (1 - settled[..., None]) + grey * settled[..., None]).astype(np.uint8)
    for _ in range(round(46 * wear)):
        x, y = chance.uniform(-0.85, 0.85, 2) * r
        turn, length = chance.uniform(0, math.pi), chance.uniform(0.03, 0.22) * r
        end = (x + length * math.cos(turn), y + length * math.sin(turn))
        if max(math.hypot(x, y), math.hypot(*end)) < 0.92 * r:
            canvas.line([(x, y), end], 0.6, (104, 100, 196))
    for _ in range(round(60 * wear)):
        turn, away = chance.uniform(0, 2 * math.pi), math.sqrt(chance.uniform(0.02, 0.9)) * r
        spot, colour = (away * math.cos(turn), away * math.sin(turn)), (96, 100, 128)
        canvas.disc(spot, chance.uniform(0.3, 1.6), colour)


def _tarpaulin(r: float, chance: np.random.Generator) -> TextureLevel:
    """A tarpaulin over the complete port: folds, eyelets along its upper hem, a ragged outline."""
    half = COVER * r
    side = round(2 * half * FINE)
    across = np.linspace(-1, 1, side, dtype=np.float32)[None, :]
    down = np.linspace(-1, 1, side, dtype=np.float32)[:, None]
    folds = 0.13 * clouds(chance, (1, side), (2, 9)) + 0.05 * clouds(chance, (side, side), (3, 26))
    folds = folds * (0.55 + 0.35 * down) + 0.03 * clouds(chance, (side, side), (24, 30)) - 0.05 * down
    tone = np.clip(104 * (1 + folds), 0, 255)[..., None] * np.array([0.99, 1.03, 0.98], dtype=np.float32)
    canvas = Canvas(tone.astype(np.uint8), FINE, -half, -half)
    for k in range(6):
        canvas.disc(((k - 2.5) * 0.5 * r, -0.94 * half), 0.035 * r, (150, 150, 148))
        canvas.disc(((k - 2.5) * 0.5 * r, -0.94 * half), 0.018 * r, (40, 41, 40))
    canvas.grain(3.0, chance)
    hem = 0.985 - 0.02 * np.abs(clouds(chance, (side, 1), (7, 2)))
    foot = 0.97 - 0.03 * np.abs(clouds(chance, (1, side), (2, 9)))
    cover = (
        np.clip((hem - np.abs(across)) * 60, 0, 1)
        * np.clip((foot - down) * 60, 0, 1)
        * np.clip((0.99 + down) * 60, 0, 1)
    )
    return TextureLevel(canvas.image, u8((cover * 255).astype(np.uint8)), FINE, -half, -half)


def _yard(scenario: Scenario, chance: np.random.Generator) -> Image:
    """The bay itself, out of focus: concrete walls and floor in perspective, daylight in the gateway behind."""
    width, height = scenario.camera.width_px, scenario.camera.height_px
    k = width / 640.0
    x, top, floor, side = 640.0 * k, -150.0 * k, 92.0 * k, 200.0 * k
    canvas = Canvas(np.full((height, width, 3), (66, 67, 68), dtype=np.uint8), 1.0, -width / 2, -height / 2)
    canvas.polygon([(-x, 2.6 * top), (-side, top), (-side, floor), (-x, 3.1 * floor)], (134, 134, 133))
    canvas.polygon([(x, 2.6 * top), (side, top), (side, floor), (x, 3.1 * floor)], (116, 117, 117))
    canvas.polygon(
        [(-side, floor), (side, floor), (x, 3.1 * floor), (x, x), (-x, x), (-x, 3.1 * floor)], (158, 159, 159)
    )
    canvas.box(-side, top, 2 * side, floor - top, (214, 212, 208))
    canvas.box(-side, floor - 34 * k, 2 * side, 34 * k, (150, 151, 150))  # the road outside
    for beam in range(5):
        y = top - 14 * k * 1.6**beam
        canvas.box(-x, y - 3 * k * 1.5**beam, 2 * x, 5 * k * 1.5**beam, (48, 49, 50))
    for step in range(1, 6):  # joints of the wall's formwork, closer together the farther away
        share = 1 / (1 + 0.55 * step)
        for sign in (-1, 1):
            at = sign * (side + (x - side) * (1 - share) * 0.9)
            lean = (abs(at) - side) / (x - side)
            canvas.line([(at, top * (1 + 1.6 * lean)), (at, floor * (1 + 2.1 * lean))], 2 * k, (88, 89, 89))
    for lane in range(-5, 6):
        canvas.line([(lane * 40 * k, floor), (lane * 40 * k * 6, floor + (x - floor) * 0.9)], 1.5 * k, (128, 129, 129))
    for sign in (-1, 1):  # tyre marks, and a steel post on either side of the gateway
        canvas.polygon(
            [(sign * 62 * k, floor), (sign * 84 * k, floor), (sign * 390 * k, x), (sign * 270 * k, x)], (124, 124, 124)
        )
        canvas.box(sign * side - 10 * k, top - 10 * k, 20 * k, floor - top + 16 * k, (86, 88, 89))
        canvas.box(sign * side - 10 * k, top - 10 * k, 5 * k, floor - top + 16 * k, (124, 126, 126))
    shape = (height, width)
    concrete = 1 + 0.05 * clouds(chance, shape, (14, 18)) + 0.04 * clouds(chance, shape, (80, 110))
    mottled = np.clip(canvas.image * concrete[..., None], 0, 255).astype(np.uint8)
    return u8(cv2.GaussianBlur(mottled, (0, 0), 1.8 * k))
