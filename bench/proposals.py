"""Who proposes the marker: votes and blobs (classical), the net (learned), or both. Judged by the same evidence.

    .venv/bin/python -m bench.proposals                   # rendered bays and drawn decoys that nothing was built on
    .venv/bin/python -m bench.proposals --photos DIR ...  # and folders of pictures with a labels.jsonl

Prints a Markdown table. The pictures are those of `bench.dust`, by default of the reporting half; the net was trained
on other seeds.

"Proposed" counts pictures of a marker with a seed near enough for the evidence (centre within 0.35 of the radius, its
radius within a third), "found" those whose circle lies on it (centre and radius within a quarter), "wrong" circles
elsewhere; "false" circles in pictures without one. Time is CPU time of one thread.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from bench import dust
from bench.dust import Picture
from gateway.config import VisionConfig
from gateway.config.sections.vision import Proposals
from gateway.sim import weather
from gateway.vision.detect.robust import proposer, search
from gateway.vision.detect.robust.detect import detect, limits_of
from gateway.vision.offline.evaluation import labels, runner
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import ON, Closeness, judge
from gateway.vision.pixels import Image

MODES: tuple[Proposals, ...] = ("classical", "learned", "both")
Effect = Callable[[weather.Light, weather.Chance], weather.Light]
Apply = Callable[[Label, Image, int], Image]


def photos(folder: Path) -> Iterator[Picture]:
    found = labels.load(folder)
    return ((label, runner.picture(found, label)) for label in found.labels)


def veil(share: float, uneven: bool, label: Label, image: Image, seed: int) -> Image:
    return dust.through(label, image, share, uneven=uneven, seed=seed)


def in_weather(
    effect: Callable[[weather.Light, weather.Chance], weather.Light], label: Label, image: Image, seed: int
) -> Image:
    chance = np.random.default_rng([seed, 21])
    return weather.photographed(effect(image.astype(np.float32), chance), chance)


def dark(light: weather.Light, chance: weather.Chance) -> weather.Light:
    """A twentieth of the light."""
    return light * np.float32(0.05)


CONDITIONS: dict[str, Apply] = {
    "clear": partial(veil, 0.0, False),
    "veil 0.85": partial(veil, 0.85, False),
    "veil 0.9": partial(veil, 0.9, False),
    "veil 0.93": partial(veil, 0.93, False),
    "veil 0.85, uneven": partial(veil, 0.85, True),
    "veil 0.9, uneven": partial(veil, 0.9, True),
    "a twentieth of the light": partial(in_weather, dark),
    "dirt over 22 %": partial(in_weather, weather.dirt),
    "rain": partial(in_weather, weather.rain),
    "snow": partial(in_weather, weather.snow),
}


@dataclass(slots=True)
class Score:
    """Of one mode in one condition."""

    proposed: int = 0
    found: int = 0
    wrong: int = 0
    false: int = 0
    ms: list[float] = field(default_factory=list)  # of the proposals alone


def scored(mode: Proposals, pictures: Sequence[Picture]) -> Score:
    score, params = Score(), VisionConfig(proposals=mode)
    for label, image in pictures:
        limits = limits_of(image, params, None)
        levels = search.levels_of(image, limits)
        begun = time.thread_time_ns()
        seeds = search.proposed(levels, limits)
        score.ms.append((time.thread_time_ns() - begun) / 1e6)
        if label.found:
            score.proposed += any(_near(label, seed.u_px, seed.v_px, seed.radius_px) for seed in seeds)
        verdict = judge(label, detect(image, params)).verdict
        score.found += verdict in ON
        score.wrong += verdict is Closeness.WRONG
        score.false += verdict is Closeness.FALSE
    return score


def _near(label: Label, u: float, v: float, radius: float) -> bool:
    assert label.u is not None
    assert label.v is not None
    assert label.r is not None
    return math.hypot(u - label.u, v - label.v) <= 0.35 * label.r and 2 / 3 < radius / label.r < 1.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, nargs="+", metavar="DIR", help="folders with a labels.jsonl")
    parser.add_argument("--half", choices=dust.HALVES, default="reporting", help="of the seeds")
    parser.add_argument("--count", type=int, default=24, help="of bays, and of drawn scenes; default 24; 0: none")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    proposer.shipped()
    first = dust.HALVES[args.half]
    known = dust.pictures(args.half, args.count)
    sets = {
        name: [(label, apply(label, image, first + n)) for n, (label, image) in enumerate(known)]
        for name, apply in CONDITIONS.items()
    }
    sets |= {folder.name: list(photos(folder)) for folder in args.photos or ()}
    print("\n".join(f"| {' | '.join(cells)} |" for cells in (HEADINGS, ["---"] * len(HEADINGS))), flush=True)
    for name, pictures in sets.items():
        if pictures:
            print(f"| {' | '.join(_cells(name, pictures))} |", flush=True)


HEADINGS = [
    "condition", "with, without marker", *(f"{mode}: proposed, found, wrong, false" for mode in MODES),
    "ms of the proposals, each",
]  # fmt: skip


def _cells(name: str, pictures: Sequence[Picture]) -> list[str]:
    scores = [scored(mode, pictures) for mode in MODES]
    markers = sum(label.found for label, _ in pictures)
    return [
        name,
        f"{markers}, {len(pictures) - markers}",
        *(f"{score.proposed}, **{score.found}**, {score.wrong}, {score.false}" for score in scores),
        " / ".join(f"{np.median(score.ms):.1f}" for score in scores),
    ]


if __name__ == "__main__":
    main()
