"""The conditions, as a table, and the frames of each: (seed, condition, number) -> picture and label."""

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial

import numpy as np

from gateway.errors import ConfigError
from gateway.sim.benchmark import effects, paints
from gateway.sim.benchmark.paints import Cover, Paint
from gateway.sim.benchmark.scene import Place, Shot, anywhere, bay, view
from gateway.sim.weather import READ_NOISE, Chance, jpeg, photographed
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.pixels import Image

GOLDEN = (math.sqrt(5) - 1) / 2
BASE_PX = 640  # radii are for frames of this width, and larger in larger ones


def _at_edge(chance: Chance, radius: float, width: int, height: int) -> tuple[float, float]:
    """A side of the frame takes 10 to 40 % of the diameter."""
    u, v = anywhere(chance, radius, width, height)
    reach = radius - float(chance.uniform(0.1, 0.4)) * 2 * radius
    return ((reach, v), (width - 1 - reach, v), (u, reach), (u, height - 1 - reach))[int(chance.integers(4))]


def _at_left(chance: Chance, radius: float, width: int, height: int) -> tuple[float, float]:
    return 0.93 * radius, anywhere(chance, radius, width, height)[1]


def _at_middle_row(chance: Chance, radius: float, width: int, height: int) -> tuple[float, float]:
    """Up to 40 % of the diameter lies below the middle."""
    u, _ = anywhere(chance, radius, width, height)
    return u, max(radius + 2, height / 2 - radius + float(chance.uniform(0.05, 0.4)) * 2 * radius)


def _upper(chance: Chance, radius: float, width: int, height: int) -> tuple[float, float]:
    u, _ = anywhere(chance, radius, width, height)
    return u, radius + 2 + float(chance.uniform(0, 0.15)) * (height - 2 * radius)


def _middle(chance: Chance, radius: float, width: int, height: int) -> tuple[float, float]:
    """Room on all sides."""
    return width * float(chance.uniform(0.42, 0.58)), height * float(chance.uniform(0.42, 0.58))


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    name: str
    meaning: str
    marker: bool = True
    radii_px: tuple[float, float] = (15.0, 220.0)  # of the marker, or of what stands in its place
    place: Place = anywhere
    paint: Paint | None = None
    cover: Cover | None = None
    effect: Callable[[Shot, Chance], Shot] | None = None
    noise: float = READ_NOISE  # grey levels, sigma
    stored: Callable[[Image], Image] | None = None


_with = Condition
_without = partial(Condition, marker=False, radii_px=(25.0, 160.0))
# fmt: off
CONDITIONS: tuple[Condition, ...] = (
    _with(name="clear", meaning="a clean frame: sensor noise of 2 grey levels, as in all"),
    _with(name="crust", meaning="cement on the lower third and in patches over the rim, up to half of it",
        cover=paints.crust),
    _with(name="faded", meaning="bleached to a pink grey", paint=paints.faded),
    _with(name="lettered", meaning="white letters on it", paint=paints.lettered, radii_px=(25.0, 220.0)),
    _with(name="white-ring", meaning="a white ring printed in it", paint=paints.white_ring),
    _with(name="second-disc", meaning="a smaller, darker, sharper disc beside it",
        effect=effects.second_disc, radii_px=(25.0, 110.0), place=_middle),
    _with(name="tail-lamps", meaning="two lit tail lamps beside it",
        effect=effects.tail_lamps, radii_px=(20.0, 100.0), place=_middle),
    _with(name="wet-floor", meaning="a wet floor mirrors it",
        effect=effects.wet_floor, radii_px=(20.0, 110.0), place=_upper),
    _with(name="vibration", meaning="swings of up to 8 px during the exposure", effect=effects.shaken),
    _with(name="defocus", meaning="out of focus by up to 6 px", effect=effects.defocused),
    _with(name="motion", meaning="a straight smear of up to 20 px", effect=effects.moving),
    _with(name="jpeg-10", meaning="JPEG of quality 10", stored=partial(jpeg, quality=10)),
    _with(name="low-resolution", meaning="half the size, 16:9: 320 x 180",
        effect=effects.reduced, radii_px=(30.0, 170.0), place=_middle),
    _with(name="orange-cast", meaning="sodium light: blue x 0.45, green x 0.8, red x 1.15",
        effect=partial(effects.cast, (0.45, 0.8, 1.15))),
    _with(name="blue-cast", meaning="blue x 1.7, green x 1.1, red x 0.62",
        effect=partial(effects.cast, (1.7, 1.1, 0.62))),
    _with(name="half-frame", meaning="the lower half of the frame is grey, up to 40 % of the marker in it",
        stored=effects.half_lost, place=_at_middle_row, radii_px=(15.0, 150.0)),
    _with(name="over-exposed", meaning="2.6 to 3.4 times the light, clipped",
        effect=partial(effects.brighter, 2.6, 3.4)),
    _with(name="low-sun", meaning="the sun beside it, scattered by the lens",
        effect=effects.sun, radii_px=(20.0, 130.0), place=_middle),
    _with(name="veil-0.5", meaning="dust: half of the light at the marker is airlight",
        effect=partial(effects.veiled, 0.5)),
    _with(name="veil-0.8", meaning="0.8 of it", effect=partial(effects.veiled, 0.8)),
    _with(name="veil-0.9", meaning="0.9 of it", effect=partial(effects.veiled, 0.9)),
    _with(name="dark", meaning="a twentieth of the light, noise of 1 % of white",
        effect=partial(effects.brighter, 0.05, 0.05), noise=2.55),
    _with(name="rain", meaning="streaks and a thin haze", effect=effects.rain),
    _with(name="snow", meaning="flakes and a thin haze", effect=effects.snow),
    _with(name="lens-dirt", meaning="blurred spots over 22 % of the frame", effect=effects.dirt),
    _with(name="tilt", meaning="the truck 20 to 40 degrees askew",
        effect=effects.tilted, radii_px=(10.0, 105.0), place=_middle),
    _with(name="occluded", meaning="a beam hides 30 % of the rim", effect=effects.occluded),
    _with(name="truncated", meaning="the frame's edge takes 10 to 40 % of the diameter", place=_at_edge),
    _without(name="octagon", meaning="a stop sign, plain or lettered", cover=paints.octagon),
    _without(name="square", meaning="a red plate", cover=paints.square),
    _without(name="half-disc", meaning="half of a red disc at the frame's edge",
        cover=paints.half_disc, place=_at_left),
    _without(name="hose-ring", meaning="a red hose, coiled up", cover=paints.hose_ring),
    _without(name="letters", meaning="red letters", cover=paints.letters),
    _without(name="rust-lid", meaning="a round lid, rusty all over", paint=paints.rust_lid),
    _without(name="brown-lid", meaning="a round brown lid", paint=paints.brown_lid),
    _without(name="amber-lamp", meaning="a round amber lamp", paint=paints.amber_lamp),
    _without(name="lamp-glow", meaning="a tail lamp that blinds the camera: a red glow",
        effect=effects.lamp_glow, radii_px=(20.0, 90.0)),
    _without(name="empty", meaning="an open port, nothing red"),
)
# fmt: on


def chosen(patterns: list[str]) -> tuple[Condition, ...]:
    """Those whose names match one of the patterns (`veil-*`), in the table's order. Raises ConfigError."""
    for pattern in patterns:
        if not any(fnmatchcase(condition.name, pattern) for condition in CONDITIONS):
            names = ", ".join(condition.name for condition in CONDITIONS)
            raise ConfigError(f"--conditions {pattern}: there is: {names}")
    return tuple(c for c in CONDITIONS if any(fnmatchcase(c.name, pattern) for pattern in patterns))


def frame(seed: int, condition: Condition, number: int, size: tuple[int, int] = (640, 480)) -> tuple[Image, Label]:
    """The same for the same arguments. `size`: width and height, px.

    Radii are spread evenly over the logarithm, each number another; the bay of a number is the same in all conditions.
    """
    width, height = size
    code = zlib.crc32(condition.name.encode())
    chance = np.random.default_rng([seed, code, number])
    share = (code / 2**32 + (number + 1) * GOLDEN) % 1
    least, most = (radius * width / BASE_PX for radius in condition.radii_px)
    radius = min(least * (most / least) ** share, 0.47 * min(size))
    here = bay(seed, number, width, height, condition.marker)
    place = condition.place(chance, radius, width, height)
    shot = view(here, place, radius, chance, marker=condition.marker, paint=condition.paint, cover=condition.cover)
    if condition.effect is not None:
        shot = condition.effect(shot, chance)
    image = photographed(shot.light, chance, condition.noise)
    if condition.stored is not None:
        image = condition.stored(image)
    return image, _label(condition, number, shot)


def _label(condition: Condition, number: int, shot: Shot) -> Label:
    label = Label(file=f"{condition.name}-{number:03}.png", found=False, group=condition.name)
    if not condition.marker:
        return label
    u, v, a, b = shot.rim
    place = {"found": True, "u": u, "v": v, "r": math.sqrt(a * b), "a": a, "b": b}
    return label.model_copy(update={**place, "z_cm": shot.z_mm / 10, "visible": shot.visible})
