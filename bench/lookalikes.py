"""Which of two discs, rings in a marker, and what is red but no disc: drawn with exact truth, beside true discs.

    .venv/bin/python -m bench.lookalikes                  # 8 pictures of each kind
    .venv/bin/python -m bench.lookalikes --seeds 20 --from 100

"Right" is a circle within 5 % of the marker's radius in centre and R, or no marker where there is none; "wrong" is any
other circle, "missed" none at all.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.robust import detect as robust
from gateway.vision.pixels import Image
from tests.decoys import GROUNDS, Colour, Drawing, sheet

WIDTH, HEIGHT = 480, 360
WHITE: Colour = (228, 232, 230)
NEAR = 0.05  # of R
METHODS = {"paper": pipeline.detect, "robust": robust.detect}


@dataclass
class Plane:
    """A flat sign in the scene: its points are in units of its radius, tilted and seen in perspective."""

    drawing: Drawing
    u: float
    v: float
    radius: float
    tilt: float = 0.0  # rad
    toward: float = 0.0
    turn: float = 0.0

    def project(self, points: np.ndarray) -> np.ndarray:
        c, s = np.cos(self.turn), np.sin(self.turn)
        along = points @ np.array([[c, s], [-s, c]])
        t = np.array([np.cos(self.toward), np.sin(self.toward)])
        depth = (along @ t) * np.sin(self.tilt)
        flat = along - np.outer(along @ t, t) * (1 - np.cos(self.tilt))
        return np.asarray((self.u, self.v) + self.radius * flat / (1 + 0.12 * depth[:, None]))

    def paint(self, points: np.ndarray, colour: Colour) -> None:
        self.drawing.polygon([(float(u), float(v)) for u, v in self.project(points)], colour)

    def disc(self, radius: float, colour: Colour) -> None:
        self.paint(radius * polygon(240), colour)

    def truth(self) -> Circle:
        (u, v), axes, _ = cv2.fitEllipse(self.project(polygon(240)).astype(np.float32))
        return Circle(u, v, max(axes) / 2)


def polygon(corners: int, rounding: float = 0.0) -> np.ndarray:
    """Regular, circumradius 1; `rounding` 0 to 1: corners cut by arcs of so much of the inscribed circle."""
    at = np.arange(corners) * 2 * np.pi / corners + np.pi / corners
    sharp = np.stack([np.cos(at), np.sin(at)], axis=1)
    if not rounding:
        return sharp
    arc = np.linspace(-np.pi / corners, np.pi / corners, 16)
    radius = rounding * np.cos(np.pi / corners)
    parts = [
        (1 - rounding) * p + radius * np.stack([np.cos(a + arc), np.sin(a + arc)], axis=1)
        for p, a in zip(sharp, at, strict=True)
    ]
    return np.concatenate(parts)


def red(chance: np.random.Generator) -> Colour:
    return (chance.uniform(20, 60), chance.uniform(20, 55), chance.uniform(130, 215))


def plane(s: Drawing, radius: tuple[float, float] = (30, 80), tilt_deg: float = 25, turn: float = np.pi) -> Plane:
    c = s.chance
    size = float(np.exp(c.uniform(*np.log(radius))))
    room_u, room_v = max(0.0, WIDTH / 2 - 1.15 * size), max(0.0, HEIGHT / 2 - 1.15 * size)
    u, v = WIDTH / 2 + c.uniform(-1, 1) * room_u, HEIGHT / 2 + c.uniform(-1, 1) * room_v
    tilt, toward = np.radians(c.uniform(0, tilt_deg)), c.uniform(0, 2 * np.pi)
    return Plane(s, u, v, size, tilt, toward, c.uniform(-turn, turn))


def marker(s: Drawing, **how: object) -> tuple[Plane, Circle]:
    p = plane(s, **how)  # type: ignore[arg-type]
    p.disc(1, red(s.chance))
    return p, p.truth()


def blotch(s: Drawing, u: float, v: float, size: float, colour: Colour, rough: float = 0.25) -> None:
    at = np.arange(90) * 2 * np.pi / 90
    reach = np.ones(90)
    for k in range(2, 9):
        reach += rough * s.chance.normal() / k * np.cos(k * at + s.chance.uniform(0, 2 * np.pi))
    s.polygon(
        [(u + size * r * np.cos(a), v + size * r * np.sin(a)) for a, r in zip(at, np.maximum(reach, 0.2), strict=True)],
        colour,
    )


Truth = Circle | None
KINDS: dict[str, Callable[[Drawing], Truth]] = {}


def kind(function: Callable[[Drawing], Truth]) -> Callable[[Drawing], Truth]:
    KINDS[function.__name__.replace("_", " ")] = function
    return function


@kind
def disc(s: Drawing) -> Truth:
    return marker(s)[1]


@kind
def disc_small(s: Drawing) -> Truth:
    return marker(s, radius=(9, 16))[1]


@kind
def disc_tilted(s: Drawing) -> Truth:
    return marker(s, tilt_deg=50)[1]


@kind
def disc_worn(s: Drawing) -> Truth:
    """Crusts and chips of the ground's colour along a third of the rim."""
    p, truth = marker(s)
    for _ in range(s.chance.integers(2, 6)):
        a = s.chance.uniform(0, 2 * np.pi)
        u, v = p.project(s.chance.uniform(0.85, 1.15) * np.array([[np.cos(a), np.sin(a)]]))[0].tolist()
        grey = s.chance.uniform(100, 170)
        blotch(s, u, v, s.chance.uniform(0.08, 0.3) * p.radius, (grey - 6, grey, grey + 4))
    return truth


@kind
def disc_lettered(s: Drawing) -> Truth:
    p, truth = marker(s)
    s.text("17", p.u - 0.55 * p.radius, p.v + 0.35 * p.radius, 0.9 * p.radius, WHITE)
    return truth


@kind
def disc_hidden(s: Drawing) -> Truth:
    p, truth = marker(s)
    side = s.chance.choice([-1, 1])
    s.box(p.u + side * s.chance.uniform(1.0, 1.3) * p.radius, p.v, 0.6 * p.radius, 1.6 * p.radius, (70, 74, 72))
    return truth


@kind
def disc_cut(s: Drawing) -> Truth:
    p = plane(s, tilt_deg=15)
    out = s.chance.uniform(-0.9, -0.25) * p.radius
    side = s.chance.integers(4)
    p.u = (p.u, p.u, -out, WIDTH - 1 + out)[side]
    p.v = (-out, HEIGHT - 1 + out, p.v, p.v)[side]
    p.disc(1, red(s.chance))
    return p.truth()


@kind
def ring(s: Drawing) -> Truth:
    p, truth = marker(s)
    outer = s.chance.uniform(0.45, 0.92)
    inner = outer - s.chance.uniform(0.08, min(0.3, outer - 0.2))
    colours = (WHITE, (30, 32, 30), (60, 200, 220), (150, 70, 40), (130, 134, 132))
    colour = colours[s.chance.integers(len(colours))]
    paint = red(s.chance)
    p.disc(1, paint)
    p.disc(outer, colour)
    p.disc(inner, paint if s.chance.random() < 0.7 else red(s.chance))
    return truth


@kind
def ring_tilted(s: Drawing) -> Truth:
    p, truth = marker(s, tilt_deg=45)
    paint = red(s.chance)
    p.disc(1, paint)
    p.disc(s.chance.uniform(0.6, 0.8), WHITE)
    p.disc(s.chance.uniform(0.35, 0.55), paint)
    return truth


@kind
def rings(s: Drawing) -> Truth:
    """A target: red, white, red, white, red."""
    p, truth = marker(s)
    paint = red(s.chance)
    for n, share in enumerate((1.0, 0.8, 0.6, 0.4, 0.2)):
        p.disc(share, WHITE if n % 2 else paint)
    return truth


@kind
def red_in_red(s: Drawing) -> Truth:
    """A darker or lighter red disc in the middle of the marker."""
    p, truth = marker(s)
    p.disc(s.chance.uniform(0.4, 0.75), red(s.chance))
    return truth


def _two(s: Drawing, ratio: float, soften: int) -> tuple[Plane, Plane]:
    c = s.chance
    size = c.uniform(40, 75)
    left = c.random() < 0.5
    u = [c.uniform(90, 120), c.uniform(335, 385)]
    big = Plane(s, u[not left], c.uniform(100, 260), size, np.radians(c.uniform(0, 15)), c.uniform(0, 6))
    small = Plane(s, u[left], c.uniform(100, 260), ratio * size, np.radians(c.uniform(0, 15)), c.uniform(0, 6))
    for n, p in enumerate((big, small)):
        deep = n != soften
        p.disc(
            1, (18, 12, c.uniform(130, 200)) if deep else (c.uniform(60, 85), c.uniform(55, 80), c.uniform(150, 210))
        )
        if not deep:
            s.paint = np.ascontiguousarray(s.paint)
            x0, x1 = (0, s.paint.shape[1] // 2) if p.u < WIDTH / 2 else (s.paint.shape[1] // 2, s.paint.shape[1])
            s.paint[:, x0:x1] = cv2.GaussianBlur(s.paint[:, x0:x1], (0, 0), 4 * c.uniform(0.5, 2.5))
    return big, small


@kind
def two_large_is_duller(s: Drawing) -> Truth:
    return _two(s, s.chance.uniform(0.45, 0.85), 0)[0].truth()


@kind
def two_small_is_duller(s: Drawing) -> Truth:
    return _two(s, s.chance.uniform(0.45, 0.85), 1)[0].truth()


@kind
def two_large_is_half_hidden(s: Drawing) -> Truth:
    big, _ = _two(s, s.chance.uniform(0.45, 0.8), 0)
    s.box(big.u, big.v + 1.25 * big.radius, 1.3 * big.radius, 0.6 * big.radius, (80, 84, 82))
    return big.truth()


@kind
def two_equal(s: Drawing) -> Truth:
    """Nobody can know: no marker is right."""
    _two(s, s.chance.uniform(0.98, 1.02), 2)
    return None


@kind
def octagon(s: Drawing) -> Truth:
    p = plane(s)
    p.paint(polygon(8), red(s.chance))
    return None


@kind
def octagon_sign(s: Drawing) -> Truth:
    """A stop sign: white border, red field, white letters."""
    p = plane(s, turn=0.2)
    p.paint(polygon(8), WHITE)
    p.paint(s.chance.uniform(0.88, 0.95) * polygon(8), red(s.chance))
    s.text("STOP", p.u - 0.6 * p.radius, p.v + 0.2 * p.radius, 0.5 * p.radius, WHITE)
    return None


@kind
def octagon_small(s: Drawing) -> Truth:
    p = plane(s, radius=(14, 22))
    p.paint(polygon(8), red(s.chance))
    return None


@kind
def octagon_tilted(s: Drawing) -> Truth:
    p = plane(s, tilt_deg=50)
    p.paint(polygon(8), red(s.chance))
    return None


@kind
def polygon_other(s: Drawing) -> Truth:
    p = plane(s)
    p.paint(polygon(int(s.chance.choice([4, 5, 6, 7, 9, 10]))), red(s.chance))
    return None


@kind
def rounded_square(s: Drawing) -> Truth:
    p = plane(s)
    p.paint(polygon(4, s.chance.uniform(0.2, 0.65)), red(s.chance))
    return None


@kind
def polygon_cut(s: Drawing) -> Truth:
    """By the frame's edge, or its corner."""
    p = plane(s)
    side = s.chance.integers(4)
    out = s.chance.uniform(-0.6, 0.4) * p.radius
    p.u = (p.u, p.u, -out, WIDTH - 1 + out)[side]
    p.v = (-out, HEIGHT - 1 + out, p.v, p.v)[side]
    p.paint(polygon(int(s.chance.choice([4, 4, 6, 8]))), red(s.chance))
    return None


@kind
def rust_patch(s: Drawing) -> Truth:
    p = plane(s, radius=(15, 50))
    blotch(s, p.u, p.v, p.radius, (s.chance.uniform(30, 45), s.chance.uniform(40, 60), s.chance.uniform(110, 160)), 0.3)
    return None


@kind
def crust_with_a_hole(s: Drawing) -> Truth:
    """Only an irregular hole in a crust shows the marker's paint: no marker is right."""
    p, _ = marker(s, radius=(50, 80), tilt_deg=10)
    grey = s.chance.uniform(110, 170)
    blotch(s, p.u, p.v, 1.25 * p.radius, (grey - 6, grey, grey + 4), 0.1)
    blotch(s, p.u, p.v, s.chance.uniform(0.15, 0.35) * p.radius, red(s.chance), 0.3)
    return None


def picture(name: str, seed: int) -> tuple[Image, Truth]:
    """Blur and noise grow with the seed, every fourth is stored as JPEG."""
    drawing = sheet(WIDTH, HEIGHT, list(GROUNDS)[seed % 4] if seed % 3 == 0 else "concrete", seed)
    drawing.chance = np.random.default_rng([seed, *map(ord, name)])
    truth = KINDS[name](drawing)
    size = 10 if truth is None else truth.radius_px
    image = drawing.finished(0.5 + (seed % 4) * min(0.6, 0.02 * size), 1.0 + 2 * (seed % 3))
    if seed % 4 == 3:
        image = np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 60])[1], 1), np.uint8)
    return image, truth


def right(found: Circle | None, truth: Truth) -> bool:
    if found is None or truth is None:
        return found is truth
    off = max(abs(found.u_px - truth.u_px), abs(found.v_px - truth.v_px), abs(found.radius_px - truth.radius_px))
    return off <= NEAR * truth.radius_px + 0.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--from", type=int, default=0, dest="first")
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--each", action="store_true", help="print every picture that is not right")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    table = Table("kind", *(f"{method} {what}" for method in METHODS for what in ("right", "wrong", "missed")))
    console = Console(width=120)
    total = np.zeros(6, int)
    for name in args.only or KINDS:
        counts = np.zeros(6, int)
        for seed in range(args.first, args.first + args.seeds):
            image, truth = picture(name, seed)
            for n, (method, detect) in enumerate(METHODS.items()):
                found = detect(image, VisionConfig())
                verdict = 0 if right(found.circle, truth) else 1 if found.circle is not None else 2
                counts[3 * n + verdict] += 1
                if args.each and verdict and method == "robust":
                    print(
                        name,
                        seed,
                        truth,
                        found.circle,
                        found.confidence,
                        [(r.why, r.circle) for r in found.rejected][:3],
                    )
        table.add_row(name, *map(str, counts))
        total += counts
    table.add_row("all", *map(str, total))
    console.print(table)


if __name__ == "__main__":
    main()
