"""Who proposes the marker: votes and blobs (classical), the net (learned), or both. Judged by the same evidence.

    .venv/bin/python -m bench.proposals                   # rendered bays and drawn decoys that nothing was built on
    .venv/bin/python -m bench.proposals --benchmark       # the conditions of `gateway benchmark` instead
    .venv/bin/python -m bench.proposals --photos DIR ...  # folders of pictures with a labels.jsonl, too

Prints a Markdown table. The pictures are those of `bench.dust`, by default of the reporting half, or those of `gateway
benchmark`; the net was trained on other seeds.

"Proposed" counts pictures of a marker with a seed near enough for the evidence (centre within 0.35 of the radius, its
radius within a third), "found" those whose circle lies on it (centre and radius within a quarter), "wrong" circles
elsewhere; "false" circles in pictures without one. Times are medians of CPU time of one thread, of the proposals alone
and of the complete search.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NamedTuple, TypeVar

import cv2
import numpy as np

from bench import dust
from bench.dust import Picture
from gateway.config import VisionConfig
from gateway.config.sections.vision import Proposals
from gateway.sim import weather
from gateway.sim.benchmark import conditions
from gateway.vision.detect.robust import proposer, search
from gateway.vision.detect.robust.detect import detect, limits_of
from gateway.vision.offline.evaluation import labels, runner
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import ON, Closeness, judge
from gateway.vision.pixels import Image

MODES: tuple[Proposals, ...] = ("classical", "learned", "both")
Effect = Callable[[weather.Light, weather.Chance], weather.Light]
Apply = Callable[[Label, Image, int], Image]
T = TypeVar("T")


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


class Answer(NamedTuple):
    """Of one mode to one picture; times in ms: of the proposals alone, of the complete search."""

    marker: bool
    proposed: bool
    verdict: Closeness
    proposals_ms: float
    search_ms: float


def answer(mode: Proposals, label: Label, image: Image) -> Answer:
    params = VisionConfig(proposals=mode)
    limits = limits_of(image, params, None)
    levels = search.levels_of(image, limits)
    seeds, proposals_ms = _timed(lambda: search.proposed(levels, limits))
    near = label.found and any(_near(label, seed.u_px, seed.v_px, seed.radius_px) for seed in seeds)
    found, search_ms = _timed(lambda: detect(image, params))
    return Answer(label.found, near, judge(label, found).verdict, proposals_ms, search_ms)


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    begun = time.thread_time_ns()
    return work(), (time.thread_time_ns() - begun) / 1e6


def _near(label: Label, u: float, v: float, radius: float) -> bool:
    assert label.u is not None
    assert label.v is not None
    assert label.r is not None
    return math.hypot(u - label.u, v - label.v) <= 0.35 * label.r and 2 / 3 < radius / label.r < 1.5


def disturbed(half: str, count: int) -> Iterator[tuple[str, Label, Image]]:
    """The pictures of `bench.dust` in each of CONDITIONS."""
    known, first = dust.pictures(half, count), dust.HALVES[half]
    for name, apply in CONDITIONS.items():
        for number, (label, image) in enumerate(known):
            yield name, label, apply(label, image, first + number)


def benchmark(seed: int, count: int, size: tuple[int, int]) -> Iterator[tuple[str, Label, Image]]:
    """Number by number: a bay takes longest to paint."""
    for number in range(count):
        for condition in conditions.CONDITIONS:
            image, label = conditions.frame(seed, condition, number, size)
            yield condition.name, label, image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, nargs="+", metavar="DIR", help="folders with a labels.jsonl")
    parser.add_argument("--half", choices=dust.HALVES, default="reporting", help="of the seeds")
    parser.add_argument("--count", type=int, default=24, help="of bays, and of drawn scenes; default 24; 0: none")
    parser.add_argument("--benchmark", action="store_true", help="`count` frames of each of its conditions instead")
    parser.add_argument("--seed", type=int, default=3011, help="of the benchmark's frames; default 3011")
    parser.add_argument("--width", type=int, default=640, help="of the benchmark's frames, 4:3, px; default 640")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    proposer.shipped()
    size = args.width, args.width * 3 // 4
    seen = benchmark(args.seed, args.count, size) if args.benchmark else disturbed(args.half, args.count)
    pictures = chain(seen, ((folder.name, *picture) for folder in args.photos or () for picture in photos(folder)))
    rows: dict[str, list[list[Answer]]] = {"**all**": []}
    for name, label, image in pictures:
        answers = [answer(mode, label, image) for mode in MODES]
        rows.setdefault(name, []).append(answers)
        rows["**all**"].append(answers)
    cells = [HEADINGS, ["---"] * len(HEADINGS), *(_cells(name, row) for name, row in rows.items())]
    print("\n".join(f"| {' | '.join(row)} |" for row in cells))


def _cells(name: str, answers: Sequence[Sequence[Answer]]) -> list[str]:
    """`answers`: of all modes to each picture."""
    markers = sum(each[0].marker for each in answers)
    cells = [name, f"{markers}, {len(answers) - markers}"]
    modes = list(zip(*answers, strict=True))
    for mode in modes:
        verdicts = [answer.verdict for answer in mode]
        found, wrong, false = (
            sum(v in which for v in verdicts) for which in (ON, (Closeness.WRONG,), (Closeness.FALSE,))
        )
        cells.append(f"{sum(answer.proposed for answer in mode)}, **{found}**, {wrong}, {false}")
    for at in (3, 4):
        cells.append(" / ".join(f"{np.median([answer[at] for answer in mode]):.1f}" for mode in modes))
    return cells


HEADINGS = [
    "condition", "with, without marker", *(f"{mode}: proposed, found, wrong, false" for mode in MODES),
    "ms of the proposals, each", "ms of the search, each",
]  # fmt: skip


if __name__ == "__main__":
    main()
