"""Labelled pictures seen through dust and in other light: down to which strength is the marker still found? Pure.

Dust is airlight in front of the scene (Koschmieder): each pixel keeps the share 1 - a of its own light, the rest is the
light of the dust. Then the camera adds its noise and rounds, as it would have done: what the veil has taken can't be
restored by a filter. The veil varies over the picture.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.clock import Clock
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.runner import MakeDetector, answer
from gateway.vision.offline.evaluation.scoring import ScoredPicture, Scores, percentile, scores
from gateway.vision.picture.measure import halved
from gateway.vision.picture.measure import veil as measured_veil
from gateway.vision.pixels import Image

READ_NOISE = 1.5  # grey levels, sigma: a camera's own
UNEVEN = 0.2  # of the dust's optical depth: so much more or less of it at places
FOUND = 0.95  # share of the markers that must be found for a strength to be relied on; none may be wrong or false
AIRLIGHT_PERCENT = 90.0  # dust is as bright as the bright parts of its picture: the same light falls on both


def dusty(image: Image, share: float, seed: int) -> Image:
    """A (H, W, 3) uint8 BGR picture behind dust; about `share`, 0 to 1, of each pixel is airlight."""
    height, width = image.shape[:2]
    random = np.random.default_rng([seed, 1])
    cells = random.uniform(1 - UNEVEN, 1 + UNEVEN, (5, 7)).astype(np.float32)
    clouds = np.asarray(cv2.resize(cells, (width, height), interpolation=cv2.INTER_LINEAR))
    passed = ((1 - share) ** clouds)[..., None]
    airlight = np.float32(np.percentile(image, AIRLIGHT_PERCENT))
    return _photographed(image * passed + airlight * (1 - passed), random)


def lit(image: Image, times: float, seed: int) -> Image:
    """The same in `times` the light: what exceeds white is lost, what is dark goes down in noise."""
    return _photographed(image * np.float32(times), np.random.default_rng([seed, 2]))


def _photographed(light: NDArray[np.float32], random: np.random.Generator) -> Image:
    noisy = light + READ_NOISE * random.standard_normal(light.shape, dtype=np.float32)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class Stress:
    """One kind of stress and its strengths, mild ones first."""

    name: str
    unit: str
    apply: Callable[[Image, float, int], Image]
    strengths: tuple[float, ...]


DUST = Stress("dust", "share of airlight", dusty, (0.5, 0.6, 0.7, 0.75, 0.8, 0.85, 0.88, 0.9, 0.92, 0.94, 0.96))
DARK = Stress("less light", "times the light", lit, (0.5, 0.25, 0.12, 0.06, 0.03))
BRIGHT = Stress("more light", "times the light", lit, (1.5, 2.0, 2.5, 3.0))
KINDS = (DUST, DARK, BRIGHT)


@dataclass(frozen=True, slots=True)
class StressLevel:
    """A method on the set at one strength. `veil`: the median of these pictures' `picture_veil`, as the registers
    report it; None: it can't be measured in any of them."""

    kind: str
    strength: float
    scores: Scores
    veil: float | None

    @property
    def reliable(self) -> bool:
        s = self.scores
        found = s.detected_share is not None and s.detected_share >= FOUND
        return found and not s.wrong and not s.false


@dataclass(frozen=True, slots=True)
class Limit:
    """Up to which strength a method can be relied on; None: not even the mildest, or the set has no marker."""

    kind: str
    strength: float | None
    veil: float | None


@dataclass(frozen=True, slots=True)
class Stressed:
    """One method under every stress."""

    method: str
    levels: tuple[StressLevel, ...]

    def limit(self, kind: str) -> Limit:
        """Of the strengths from the mildest one on that are all reliable, the last."""
        last: StressLevel | None = None
        for level in (level for level in self.levels if level.kind == kind):
            if not level.reliable:
                break
            last = level
        return Limit(kind, None, None) if last is None else Limit(kind, last.strength, last.veil)


def in_words(result: Stressed) -> list[str]:
    """Down to what this set shows the method to be reliable, a sentence each; the setting that records it last."""
    lines = []
    for kind in KINDS:
        limit = result.limit(kind.name)
        if limit.strength is None:
            lines.append(f"{result.method}, {kind.name}: at {kind.strengths[0]:g} {kind.unit} already not reliable")
        else:
            lines.append(f"{result.method}, {kind.name}: reliable to {limit.strength:g} {kind.unit}")
    veil = result.limit(DUST.name).veil
    if veil is not None:
        lines.append(
            f"{result.method}: for the configuration: camera.picture.veil_proven = {math.floor(100 * veil) / 100:g}"
        )
    return lines


def as_json(result: Stressed) -> dict[str, Any]:
    """Plain values with stable names."""
    return {
        "method": result.method,
        "levels": [asdict(level) | {"reliable": level.reliable} for level in result.levels],
        "limits": [asdict(result.limit(kind.name)) for kind in KINDS],
    }


def steps() -> int:
    """Pictures made of each picture."""
    return sum(len(kind.strengths) for kind in KINDS)


def run(
    chosen: Sequence[Label],
    picture: Callable[[Label], Image],
    methods: Mapping[str, MakeDetector],
    clock: Clock,
    *,
    mean_radius: bool = False,
    advance: Callable[[], None] = lambda: None,
) -> tuple[Stressed, ...]:
    """Each picture at each strength by each method, without tracking. `picture` reads one; `advance` is called after
    each that was made of it. The disturbances follow from a picture's place in `chosen`."""
    outcomes: dict[tuple[str, str, float], list[ScoredPicture]] = {}
    veils: dict[tuple[str, float], list[float]] = {}
    for seed, label in enumerate(chosen):
        image = picture(label)
        for kind in KINDS:
            for strength in kind.strengths:
                seen = kind.apply(image, strength, seed)
                if (veil := measured_veil(halved(seen))) is not None:
                    veils.setdefault((kind.name, strength), []).append(veil)
                for name, make in methods.items():
                    outcome = answer(make(False), seen, label, clock, mean_radius=mean_radius)
                    outcomes.setdefault((name, kind.name, strength), []).append(outcome)
                advance()
    return tuple(
        Stressed(
            name,
            tuple(
                StressLevel(
                    kind.name,
                    s,
                    scores(outcomes.get((name, kind.name, s), ())),
                    percentile(veils.get((kind.name, s), ()), 50),
                )
                for kind in KINDS
                for s in kind.strengths
            ),
        )
        for name in methods
    )
