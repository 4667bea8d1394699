"""Views of one bay of `gateway benchmark`, of bays that it never shows: worn or hidden markers, and what stands there
instead. The simulator draws them; weather, light and the camera come from `training.weather`."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gateway.sim.benchmark.conditions import CONDITIONS
from gateway.sim.benchmark.scene import anywhere, bay, view
from gateway.sim.render import disc_cover
from training.scene import HEIGHT, WIDTH, WITHOUT, Chance, Place, Scene, place_of, red_paint, seen

VIEWS = 24  # of one painted bay
FIRST_BAY = 1 << 20  # seeds below are those that figures are reported on
WEAR = (
    "clear", "crust", "crust", "faded", "lettered", "white-ring", "tail-lamps", "wet-floor", "vibration", "defocus",
    "motion", "low-sun", "tilt", "occluded",
)  # fmt: skip
KINDS = {condition.name: condition for condition in CONDITIONS}
INSTEAD = tuple(condition.name for condition in CONDITIONS if not condition.marker)


def worn(chance: Chance) -> Iterator[Scene]:
    seed, red = FIRST_BAY + int(chance.integers(1 << 30)), bool(chance.random() < 0.7)
    here = bay(seed, 0, WIDTH, HEIGHT, red)
    for _ in range(VIEWS):
        kind = KINDS[str(chance.choice(INSTEAD if chance.random() < WITHOUT else WEAR))]
        place = place_of(chance)
        radius = min(place[2], kind.radii_px[1] * WIDTH / 640)
        at = place[:2] if kind.place is anywhere else kind.place(chance, radius, WIDTH, HEIGHT)
        shot = view(here, at, radius, chance, marker=kind.marker, paint=kind.paint, cover=kind.cover)
        if kind.effect is not None:
            shot = kind.effect(shot, chance)
        u, v, a, b = shot.rim
        rim = u, v, float(np.sqrt(a * b))
        markers: tuple[Place, ...] = (rim,) if kind.marker else ()
        if kind.marker and chance.random() < 0.15:
            other = beside(rim, chance)
            cover = disc_cover(*other, (0, 0, WIDTH, HEIGHT))[..., None]
            paint = np.array(red_paint(chance), np.float32)
            shot = replace(shot, light=np.asarray(shot.light + cover * (paint - shot.light), np.float32))
            markers = (*markers, other)
        yield Scene(seen(shot.light), markers)


def beside(place: Place, chance: Chance) -> Place:
    """A second disc, not before the first: what is named is both."""
    u, v, radius = place
    size = radius * float(chance.uniform(0.4, 1.1))
    turn, away = float(chance.uniform(0, 2 * np.pi)), radius + size * float(chance.uniform(1.1, 2.0))
    return u + away * float(np.cos(turn)), v + away * float(np.sin(turn)), size
