"""Dust, darkness, glare, motion, colour casts, JPEG and noise: how often the marker is still found, method by method.

    .venv/bin/python -m bench.stress                      # rendered bays and drawn scenes, some without a marker
    .venv/bin/python -m bench.stress --photos DIR ...     # and folders of pictures with a labels.jsonl
    .venv/bin/python -m bench.stress --half reporting     # of the folders, only the half that nobody tuned on

Every picture goes through every disturbance at three strengths (`tests.disturb`). "on" counts answers
on the target (centre and radius within a quarter of the radius) among pictures with a marker, "wrong" those elsewhere,
"false" answers in pictures without one.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
from rich.console import Console
from rich.progress import track
from rich.table import Table

from gateway.config import VisionConfig
from gateway.sim.render import render
from gateway.sim.scenario import Fault, FaultKind, load
from gateway.sim.world import World
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.robust import detect as robust
from gateway.vision.offline.evaluation import labels
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import ON, Closeness, judge
from gateway.vision.pixels import Image, bgr8
from tests import decoys
from tests.disturb import DISTURBANCES

SCENARIOS = Path(__file__).resolve().parent.parent / "config" / "scenarios"
METHODS = {"paper": pipeline.detect, "robust": robust.detect}
Picture = tuple[Label, Image]


def photos(folder: Path, half: str) -> Iterator[Picture]:
    found = labels.load(folder)
    for label in found.labels:
        if half == "both" or label.tuning_half == (half == "tuning"):
            image = cv2.imread(str(found.path(label)), cv2.IMREAD_COLOR)
            if image is None:
                sys.exit(f"{found.path(label)}: no picture")
            yield label, bgr8(image)


def bays(every_s: float) -> Iterator[Picture]:
    """Frames of the shipped scenarios: near and far, bright and dim, rusty and dusty; also with the marker covered."""
    for path in sorted(SCENARIOS.glob("*.toml")):
        if path.stem == "faults":
            continue
        scenario = load(path)
        world = World(scenario)
        for n in range(int(min(scenario.duration_s or 20.0, 20.0) / every_s)):
            truth = world.truth(n * every_s)
            name = f"{path.stem}-{n}"
            if n % 4 == 3:
                hidden = scenario.model_copy(update={"faults": (_cover(n * every_s),)})
                yield Label(file=name, found=False), render(hidden, truth, n)
            else:
                label = Label(file=name, found=True, u=truth.u_px, v=truth.v_px, r=truth.radius_px)
                yield label, render(scenario, truth, n)


def _cover(at_s: float) -> Fault:
    return Fault(kind=FaultKind.MARKER_HIDDEN, at_s=max(0.0, at_s - 1), for_s=10)


def drawn(seeds: int) -> Iterator[Picture]:
    """Every decoy on every ground, once alone and once beside a disc."""
    width, height = 480, 360
    for ground in decoys.GROUNDS:
        for name, paint in decoys.DECOYS.items():
            for seed in range(seeds):
                alone = decoys.sheet(width, height, ground, 1000 + seed)
                paint(alone, width / 2, height / 2, alone.chance.uniform(0.08, 0.25) * height)
                yield Label(file=f"{ground}-{name}-{seed}", found=False), alone.finished()
                beside = decoys.sheet(width, height, ground, 2000 + seed)
                place = decoys.marker_at(beside, beside.chance.uniform(0.07, 0.22))
                decoys.beside(beside, paint, place)
                beside.ball(place.u_px, place.v_px, place.radius_px)
                label = Label(
                    file=f"{ground}-{name}-{seed}-disc", found=True, u=place.u_px, v=place.v_px, r=place.radius_px
                )
                yield label, beside.finished()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, nargs="+", metavar="DIR", help="folders with a labels.jsonl")
    parser.add_argument("--half", choices=("tuning", "reporting", "both"), default="both", help="of the folders")
    parser.add_argument("--every-s", type=float, default=1.0, help="of a scenario's time, one frame; default 1")
    parser.add_argument("--seeds", type=int, default=1, help="drawn scenes of each kind; default 1; 0: none")
    parser.add_argument("--no-scenes", action="store_true", help="only the folders")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    sets: dict[str, list[Picture]] = {str(folder.name): list(photos(folder, args.half)) for folder in args.photos or ()}
    if not args.no_scenes:
        sets["rendered bays"] = list(bays(args.every_s))
        sets["drawn scenes"] = list(drawn(args.seeds))
    console = Console(width=110)
    for name, pictures in sets.items():
        console.print(_table(name, pictures))


def _table(name: str, pictures: list[Picture]) -> Table:
    params = VisionConfig()
    with_marker = sum(label.found for label, _ in pictures)
    table = Table(title=f"{name}: {with_marker} with a marker, {len(pictures) - with_marker} without")
    table.add_column("disturbance")
    table.add_column("strength", justify="right")
    for method in METHODS:
        for column in ("on", "wrong", "false"):
            table.add_column(f"{method} {column}", justify="right")
    cases = [("none", 0.0, None), *((d.name, strength, d) for d in DISTURBANCES for strength in d.strengths)]
    for title, strength, disturbance in track(cases, description=name, console=Console(stderr=True)):
        verdicts: dict[str, list[Closeness]] = {method: [] for method in METHODS}
        for number, (label, image) in enumerate(pictures):
            seen = image if disturbance is None else disturbance.apply(image, strength, number)
            for method, detect in METHODS.items():
                verdicts[method].append(judge(label, detect(seen, params)).verdict)
        cells = []
        for got in verdicts.values():
            on = sum(verdict in ON for verdict in got)
            cells += [f"{100 * on / max(with_marker, 1):.0f} %", str(got.count(Closeness.WRONG))]
            cells.append(str(got.count(Closeness.FALSE)))
        table.add_row(title, f"{strength:g}", *cells)
    return table


if __name__ == "__main__":
    main()
