"""Thick dust on pictures with exact truth: what each method finds, how exactly, and what it reports without a marker.

    .venv/bin/python -m bench.dust                      # the half of the seeds that the method may be tuned on
    .venv/bin/python -m bench.dust --half reporting     # the other half
    .venv/bin/python -m bench.dust --markdown           # for bench/reports/vision.md
    .venv/bin/python -m bench.dust --sum 4 8            # what the sum of so many frames adds, where one shows nothing

The simulator's bay (other surfaces, distances, light and red clutter for each seed) and drawn scenes (a disc beside a
decoy on each ground), rendered without noise, seen through `gateway.sim.weather.dust`: the share of airlight at the
marker is exactly that of the row; noise and rounding to 8 bits come after it. Each picture is seen through an even and
an uneven veil. Without a marker: bays with a tarpaulin over it and nothing else that is red and round, and decoys.

"Found" counts answers on the target (centre and radius within a quarter of the radius); errors are those of found ones.
"""

import argparse
import math
import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from gateway.config import VisionConfig
from gateway.core.detection import Detection
from gateway.sim.render import render
from gateway.sim.scenario import Camera, Clutter, Dust, Fault, FaultKind, Light, Marker, Pose, Scenario, Surface
from gateway.sim.weather import dust
from gateway.sim.world import World
from gateway.vision.detect.method import TimedPicture
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.robust import detect as robust
from gateway.vision.detect.robust import frame_sum
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import ON, Closeness, judge
from gateway.vision.pixels import Image
from tests import decoys

VEILS = (0.0, 0.5, 0.7, 0.8, 0.85, 0.9, 0.93, 0.96)
HALVES = {"tuning": 0, "reporting": 500}  # first seed
COUNT = 40  # bays with a marker; as many drawn scenes with one, and without
RADII_PX = (18.0, 150.0)  # in the bay's 640 x 480 px


@dataclass
class Tally:
    """Of one method behind one veil."""

    seen: int = 0  # pictures with a marker
    without: int = 0
    centres_px: list[float] = field(default_factory=list)
    radii_share: list[float] = field(default_factory=list)
    wrong: int = 0
    false: int = 0

    def add(self, label: Label, found: Detection) -> None:
        outcome = judge(label, found)
        self.seen += label.found
        self.without += not label.found
        self.wrong += outcome.verdict is Closeness.WRONG
        self.false += outcome.verdict is Closeness.FALSE
        if outcome.verdict in ON and outcome.centre_px is not None and outcome.radius_share is not None:
            self.centres_px.append(outcome.centre_px)
            self.radii_share.append(abs(outcome.radius_share))

    def cells(self) -> list[str]:
        found = len(self.centres_px)
        cells = [f"{found} of {self.seen} ({100 * found / max(self.seen, 1):.0f} %)"]
        if found:
            p50, p95 = np.percentile(self.centres_px, (50, 95))
            cells += [f"{p50:.2f}/{p95:.2f}", f"{100 * np.percentile(self.radii_share, 95):.2f}"]
        else:
            cells += ["-", "-"]
        return [*cells, str(self.wrong), f"{self.false} of {self.without}"]


Picture = tuple[Label, Image]
METHODS = {"paper": pipeline.detect, "robust": robust.detect}
PARAMS = VisionConfig()
SHOT_NS = 15_000_000  # between frames


def bays(first: int, count: int) -> Iterator[Picture]:
    """Every third one a second time, without a marker."""
    for seed in range(first, first + count):
        chance = random.Random(f"bench.dust {seed}")
        radius_px = math.exp(chance.uniform(*map(math.log, RADII_PX)))
        z_mm = 600 * 90 / radius_px
        room = [(side / 2 - 1.05 * radius_px) * z_mm / 600 for side in (640, 480)]
        scenario = Scenario(
            seed=seed,
            start=Pose(
                distance_cm=z_mm / 10,
                lateral_mm=chance.uniform(-0.8, 0.8) * min(room[0], 500),
                vertical_mm=chance.uniform(-0.8, 0.8) * min(room[1], 400),
            ),
            marker=Marker(wear=chance.uniform(0, 0.6)),
            camera=Camera(noise=0),
            light=Light(
                level=chance.uniform(0.7, 1.15),
                gradient_deg=chance.uniform(-180, 180),
                warmth=chance.uniform(-0.2, 0.3),
            ),
            dust=Dust(density=0),
            surface=Surface(stains=chance.uniform(0, 1), rust=chance.choice((0.0, 0.0, 0.5, 1.0))),
            clutter=Clutter(things=chance.choice((0, 3, 5))),
        )
        truth = World(scenario).truth(0)
        label = Label(file=f"bay-{seed}", found=True, u=truth.u_px, v=truth.v_px, r=truth.radius_px)
        yield label, render(scenario, truth, 0)
        if seed % 3 == 0:
            covered = Fault(kind=FaultKind.MARKER_HIDDEN, at_s=0, for_s=10)
            bare = scenario.model_copy(update={"faults": (covered,), "clutter": Clutter(things=0)})
            yield Label(file=f"bay-{seed}-covered", found=False), render(bare, truth, 0)


def drawn(first: int, count: int) -> Iterator[Picture]:
    """A disc or a ball beside each decoy in turn, and the decoy alone."""
    width, height = 480, 360
    grounds, names = list(decoys.GROUNDS), [name for name in decoys.DECOYS if name != "text"]
    for seed in range(first, first + count):
        ground, name = grounds[seed % len(grounds)], names[seed % len(names)]
        alone = decoys.sheet(width, height, ground, seed)
        decoys.DECOYS[name](alone, width / 2, height / 2, alone.chance.uniform(0.08, 0.25) * height)
        yield Label(file=f"{ground}-{name}-{seed}", found=False), alone.finished(noise=0)
        both = decoys.sheet(width, height, ground, seed)
        place = decoys.marker_at(both, both.chance.uniform(0.06, 0.25))
        decoys.beside(both, decoys.DECOYS[name], place)
        (both.ball if seed % 2 else both.disc)(place.u_px, place.v_px, place.radius_px)
        label = Label(file=f"{ground}-{name}-{seed}-disc", found=True, u=place.u_px, v=place.v_px, r=place.radius_px)
        yield label, both.finished(noise=0)


def pictures(half: str, count: int = COUNT) -> list[Picture]:
    return [*bays(HALVES[half], count), *drawn(HALVES[half], count)]


def through(label: Label, image: Image, share: float, *, uneven: bool, seed: int, shot: int = 0) -> Image:
    """As a camera sees it, whose noise is the same in clear air."""
    middle = ((image.shape[1] - 1) / 2, (image.shape[0] - 1) / 2)
    at = (label.u, label.v) if label.u is not None and label.v is not None else middle
    return dust(image, share, at=at, uneven=uneven, seed=seed, shot=shot)


def summed(shots: list[Image]) -> Detection:
    """What a truck that stands shows in so many frames, of which the last shows nothing."""
    frames = [TimedPicture(image, SHOT_NS * (n + 1)) for n, image in enumerate(shots)]
    search = frame_sum.search(PARAMS.model_copy(update={"sum_frames": len(shots)}), lambda: 0)
    search.recent(frames)
    return search(shots[-1], frames[-1].t_ns, None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--half", choices=HALVES, default="tuning", help="of the seeds")
    parser.add_argument("--count", type=int, default=COUNT, help=f"of bays, and of drawn scenes; default {COUNT}")
    parser.add_argument("--veils", type=float, nargs="+", default=VEILS, help="shares of airlight at the marker")
    parser.add_argument("--methods", choices=METHODS, nargs="+", default=list(METHODS))
    parser.add_argument("--sum", type=int, nargs="+", default=[], help="so many frames, where one shows nothing")
    parser.add_argument("--markdown", action="store_true", help="a Markdown table")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    seen = pictures(args.half, args.count)
    head = ["veil", "", "method", "found", "centre p50/p95, px", "radius p95, %", "wrong", "false, without a marker"]
    rows = []
    cases = [(veil, uneven) for veil in args.veils for uneven in ((False, True) if veil else (False,))]
    for veil, uneven in track(cases, console=Console(stderr=True)):
        tallies = {method: Tally() for method in args.methods}
        sums = {n: Tally() for n in args.sum}
        for number, (label, image) in enumerate(seen):
            frame = through(label, image, veil, uneven=uneven, seed=HALVES[args.half] + number)
            for method, tally in tallies.items():
                found = METHODS[method](frame, PARAMS)
                tally.add(label, found)
                if method != "robust":
                    continue
                for n, of_sums in sums.items():
                    if found.circle is None:
                        shot = partial(through, label, image, veil, uneven=uneven, seed=HALVES[args.half] + number)
                        of_sums.add(label, summed([*(shot(shot=k) for k in range(1, n)), frame]))
                    else:
                        of_sums.add(label, found)
        for method, tally in [*tallies.items(), *((f"robust, {n} frames", tally) for n, tally in sums.items())]:
            rows.append([f"{veil:g}", "uneven" if uneven else "even" if veil else "none", method, *tally.cells()])
    if args.markdown:
        print("\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)))
        return
    table = Table(title=f"{args.half} half")
    for title in head:
        table.add_column(title, justify="left" if title in ("", "method") else "right")
    for row in rows:
        table.add_row(*row)
    Console(width=130).print(table)


if __name__ == "__main__":
    main()
