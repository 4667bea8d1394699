"""Red things that are not the marker: where they are, how they look. Each is smaller than it, and none touches it."""

import math
import random
from dataclasses import dataclass

from gateway.sim.canvas import Canvas, Point, Spine
from gateway.sim.scenario import Scenario


@dataclass(frozen=True, slots=True)
class ClutterItem:
    """A red thing: a chain of discs (x, y, radius, mm) that contains it, and its description."""

    kind: str
    spine: Spine

    def draw(self, canvas: Canvas) -> None:
        x, y, size = self.spine[0]
        if self.kind == "lamp":
            canvas.shade((x + 3, y + 4), size * 1.3, 0.5, size * 0.5)
            canvas.disc((x, y), size, (36, 36, 37))
            canvas.disc((x, y), size * 0.84, (34, 28, 158))
            canvas.disc((x - size * 0.1, y - size * 0.1), size * 0.5, (58, 44, 205))
            canvas.disc((x - size * 0.3, y - size * 0.32), size * 0.16, (190, 170, 245))
        elif self.kind == "wheel":
            canvas.shade((x + 4, y + 5), size, 0.35, size * 0.4)
            for k in range(3):
                a = math.pi * (k / 3 + 0.2)
                reach = (size * 0.8 * math.cos(a), size * 0.8 * math.sin(a))
                canvas.line([(x - reach[0], y - reach[1]), (x + reach[0], y + reach[1])], size * 0.16, (38, 36, 140))
            canvas.disc((x, y), size * 0.86, (44, 40, 168), ring=size * 0.26)
            canvas.disc((x, y), size * 0.2, (90, 90, 92))
        elif self.kind == "hose":
            points = [(px, py) for px, py, _ in self.spine]
            canvas.line([(px + 5, py + 6) for px, py in points], 2 * size, (62, 62, 63))
            canvas.line(points, 2 * size, (34, 32, 134))
            canvas.line([(px - size * 0.35, py - size * 0.2) for px, py in points], size * 0.5, (62, 58, 186))
            for px, py in (points[0], points[-1]):
                canvas.disc((px, py), size * 1.15, (120, 120, 120))
        else:
            canvas.run(self.spine, (44, 58, 132))


def things(scenario: Scenario) -> list[ClutterItem]:
    """Place the clutter: clear of the port, of each other and of the frame's far edge. The same every time."""
    chance = random.Random(f"clutter {scenario.seed} {scenario.clutter.seed}")
    r = scenario.marker.radius_mm
    s = r / 90.0
    placed: list[ClutterItem] = []
    if scenario.clutter.things > 0:  # tail lamps, two dome lamps on the bumper
        placed += [ClutterItem("lamp", ((x, 668.0, 34 * s),)) for x in (-730.0, 730.0)]
    kinds = ["hose", "lamp", "run", "wheel", "run"]
    wanted = len(placed) + scenario.clutter.things
    for attempt in range(400):
        if len(placed) == wanted:
            break
        turn, reach = chance.uniform(0, 2 * math.pi), r * 1.45 + chance.uniform(0.05, 0.3 + attempt / 100) * 300
        at = (1.25 * reach * math.cos(turn), reach * math.sin(turn))
        thing = _shape(kinds[len(placed) % len(kinds)], at, s, chance)
        inside = all(abs(x) < 640 - w and abs(y) < 470 - w for x, y, w in thing.spine)
        clear = all(math.hypot(x, y) - w > 1.66 * r for x, y, w in thing.spine)
        isolated = all(
            math.hypot(x - a, y - b) > w + c + 12
            for other in placed
            for a, b, c in other.spine
            for x, y, w in thing.spine
        )
        if inside and clear and isolated:
            placed.append(thing)
    return placed


def _shape(kind: str, at: Point, s: float, chance: random.Random) -> ClutterItem:
    x, y = at
    if kind == "lamp":
        return ClutterItem(kind, ((x, y, chance.uniform(22, 30) * s),))
    if kind == "wheel":
        return ClutterItem(kind, ((x, y, chance.uniform(26, 32) * s),))
    if kind == "hose":
        length, bend, lean = chance.uniform(120, 170) * s, chance.uniform(-40, 40) * s, chance.uniform(-0.5, 0.5)
        steps = [k / 12 - 0.5 for k in range(13)]
        return ClutterItem(
            kind,
            tuple((x + bend * (4 * k * k - 0.5) + lean * length * k, y + length * k, 7.5 * s) for k in steps),
        )
    length, sway = chance.uniform(90, 160) * s, chance.uniform(0, 6)
    return ClutterItem(
        "run",
        tuple((x + 3 * s * math.sin(sway + k / 5), y + length * k / 30, (6.5 - 4.5 * k / 30) * s) for k in range(31)),
    )
