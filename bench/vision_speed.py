"""How long each method looks at a frame: interleaved, one thread, against the plain OpenCV pipeline of the same run.

    python -m bench.vision_speed                      a table on the terminal
    python -m bench.vision_speed --markdown           the same for bench/reports/performance.md
    python -m bench.vision_speed --json out.json      every figure, for a machine
    python -m bench.vision_speed --run 1              frame by frame in turn: with caches full of the other's data
    python -m bench.vision_speed --rhythm             at 30 frames a second, between which the caches lose everything

Every method sees the same frames in the same order, `--run` of them in a row, in turn with the plain pipeline, so that
what else the machine does falls on both. The plain pipeline leaves 25 MB of its own in the caches: what comes after it
is slower for a frame. CPU time of the one thread, so that a pause for another program does not count. Medians; the
ratio is that of the medians. Memory is kept as the gateway's vision processes keep it (`start.ENVIRONMENT`).
"""

import argparse
import gc
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
from rich.progress import Progress

from bench.speed_scenes import SCENES, SIZES, back_and_forth
from gateway.config import VisionConfig
from gateway.processes.start import ENVIRONMENT
from gateway.vision.detect import registry
from gateway.vision.detect.method import Detector
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.paper.exact import kernel
from gateway.vision.detect.paper.exact.search import ExactSearch
from gateway.vision.detect.paper.exact.tracker import ExactTracker
from gateway.vision.detect.robust import candidates, measurement, redness, refinement, veil
from gateway.vision.pixels import Image

FRAME_NS = 33_333_333
NS_PER_MS = 1e6
OTHER_BYTES = 48 << 20  # more than the caches hold
Method = Callable[[Image, int], object]

PAPER = VisionConfig(method="paper", tracking=False)


@dataclass(frozen=True, slots=True)
class Figure:
    """One method on one scene at one size."""

    scene: str
    size: str
    method: str
    median_ms: float
    p99_ms: float
    plain_ms: float  # the plain pipeline beside it

    @property
    def times(self) -> float:
        return self.plain_ms / self.median_ms


def contenders() -> dict[str, Callable[[], Method]]:
    """By name: what builds the method afresh for a scene. The first is the baseline."""
    compiled = kernel.load(PAPER)
    table: dict[str, Callable[[], Method]] = {
        "plain": lambda: lambda image, t_ns: pipeline.detect(image, PAPER),
        "read once": lambda: lambda image, t_ns: cv2.sumElems(image),
    }
    if compiled is not None:
        table["exact, kernel"] = lambda: _detector(ExactSearch(PAPER, kernel=compiled))
        table["exact tracked, kernel"] = lambda: _detector(ExactTracker(PAPER, kernel=compiled))
    table["paper, as configured, tracked"] = lambda: _configured("paper", True)
    table["robust"] = lambda: _configured("robust", False)
    table["robust tracked"] = lambda: _configured("robust", True)
    table["robust, OpenCV only"] = lambda: _without_kernel(_configured("robust", False))
    table["robust tracked, OpenCV only"] = lambda: _without_kernel(_configured("robust", True))
    table["HoughCircles"] = lambda: lambda image, t_ns: hough(image)
    table["SimpleBlobDetector"] = _blobs
    return table


def hough(image: Image) -> object:
    """On the grey picture, as its own documentation has it."""
    grey = cv2.medianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), 5)
    height = image.shape[0]
    return cv2.HoughCircles(
        grey, cv2.HOUGH_GRADIENT, 1.5, height / 4, param1=150, param2=60, minRadius=height // 40, maxRadius=height // 2
    )


def _blobs() -> Method:
    settings = cv2.SimpleBlobDetector.Params()
    settings.filterByCircularity, settings.minCircularity = True, 0.7
    settings.filterByArea, settings.minArea, settings.maxArea = True, 100.0, 1e7
    detector = cv2.SimpleBlobDetector.create(settings)
    return lambda image, t_ns: detector.detect(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def _detector(detect: Detector) -> Method:
    return detect


def _configured(method: str, tracking: bool) -> Method:
    return registry.detector(VisionConfig.model_validate({"method": method, "tracking": tracking}))


def _no_kernel() -> None:
    return None


def _without_kernel(method: Method) -> Method:
    def call(image: Image, t_ns: int) -> object:
        with ExitStack() as stack:
            for module in (candidates, measurement, redness, refinement, veil):
                stack.enter_context(patch.object(module, "compiled_kernel", _no_kernel))
            return method(image, t_ns)

    return call


class Rhythm:
    """Waits for the next frame of a camera, while another program's data goes through the caches."""

    def __init__(self) -> None:
        self._other = np.zeros(OTHER_BYTES, np.uint8)
        self._due_s = time.perf_counter()

    def __call__(self) -> None:
        self._other += 1
        self._due_s = max(self._due_s + FRAME_NS / 1e9, time.perf_counter())
        time.sleep(max(0.0, self._due_s - time.perf_counter()))


def measure(
    scene: str,
    size: str,
    frames: Sequence[Image],
    names: Sequence[str],
    rounds: int,
    run: int,
    patience_s: float,
    wait: Callable[[], None],
) -> list[Figure]:
    """Rounds over the frames, each method in turn with the plain pipeline; the first round only warms up."""
    table = contenders()
    plain = table["plain"]()
    figures = []
    for name in names:
        detect = table[name]()
        mine: list[float] = []
        beside: list[float] = []
        started = time.perf_counter()
        for first in range(0, (rounds + 1) * len(frames), run):
            for call, times in ((plain, beside), (detect, mine)):
                for k in range(first, first + run):
                    wait()
                    began_ns = time.thread_time_ns()
                    call(frames[k % len(frames)], k * FRAME_NS)
                    times.append((time.thread_time_ns() - began_ns) / NS_PER_MS)
            if time.perf_counter() - started > patience_s:
                break
        warm_up = min(len(frames), len(mine) // 2)
        del mine[:warm_up], beside[:warm_up]
        p99 = float(np.percentile(mine, 99))
        figures.append(Figure(scene, size, name, statistics.median(mine), p99, statistics.median(beside)))
    return figures


def machine() -> str:
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        pass
    return (
        f"{model}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}, "
        f"Python {platform.python_version()}, OpenCV {cv2.__version__} (one thread), NumPy {np.__version__}"
    )


def table_of(figures: Sequence[Figure], markdown: bool) -> str:
    head = ("scene", "size", "method", "median ms", "p99 ms", "plain beside it, ms", "times as fast")
    rows = [
        (f.scene, f.size, f.method, f"{f.median_ms:.3f}", f"{f.p99_ms:.3f}", f"{f.plain_ms:.2f}", f"{f.times:.1f}")
        for f in figures
    ]
    if markdown:
        lines = ["| " + " | ".join(head) + " |", "|---|---|---|---:|---:|---:|---:|"]
        return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])
    widths = [max(len(row[n]) for row in (head, *rows)) for n in range(len(head))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in (head, *rows)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", choices=SIZES, default=list(SIZES), help="frame sizes")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["approach"], help="what is in the frames")
    parser.add_argument("--methods", nargs="+", choices=contenders(), help="default: all but the baseline")
    parser.add_argument("--frames", type=int, default=12, help="neighbouring frames of each scene (default 12)")
    parser.add_argument("--rounds", type=int, default=4, help="times to and fro over them (default 4)")
    parser.add_argument("--run", type=int, default=6, help="frames in a row, before it is the other's turn (default 6)")
    parser.add_argument("--rhythm", action="store_true", help="30 frames a second, with cold caches")
    parser.add_argument("--patience", type=float, default=10.0, help="seconds at most for one figure (default 10)")
    parser.add_argument("--markdown", action="store_true", help="a Markdown table")
    parser.add_argument("--json", type=Path, help="write every figure to this file")
    args = parser.parse_args()
    if not ENVIRONMENT.items() <= os.environ.items():  # read when a process starts
        os.execve(sys.executable, [sys.executable, "-m", "bench.vision_speed", *sys.argv[1:]], os.environ | ENVIRONMENT)
    cv2.setNumThreads(1)
    gc.collect()
    gc.freeze()  # as the vision process does
    names = args.methods or [name for name in contenders() if name != "plain"]
    wait: Callable[[], None] = Rhythm() if args.rhythm else lambda: None
    figures: list[Figure] = []
    with Progress(disable=not sys.stderr.isatty()) as progress:
        work = progress.add_task("measuring", total=len(args.sizes) * len(args.scenes))
        for scene in args.scenes:
            for size in args.sizes:
                frames = back_and_forth(SCENES[scene](*SIZES[size], args.frames))
                figures += measure(scene, size, frames, names, args.rounds, args.run, args.patience, wait)
                progress.advance(work)
    print(machine())
    print()
    print(table_of(figures, args.markdown))
    if args.json:
        args.json.write_text(json.dumps({"machine": machine(), "figures": [asdict(f) for f in figures]}, indent=1))


if __name__ == "__main__":
    main()
