"""What the rim's refinement and fit cost: `python -m bench.rim_time`. Ratios to one remap of the rays, one core.

Where the kernel is compiled, each refinement runs by it and by NumPy and OpenCV alone.

The machine may be shared: all variants run in turns, and medians of CPU time of this thread are compared.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from bench.scene import RECIPES, draw
from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.conic import from_ellipse
from gateway.vision.detect.robust.kernel.rim_kernel import RimKernel
from gateway.vision.detect.robust.normal_profiles import profile, sample
from gateway.vision.detect.robust.refinement import load, refine_plain


def variants(radius: float, kernel: RimKernel | None = None) -> dict[str, Callable[[], object]]:
    """By name; each works on the same picture of a disc with noise of 3 levels and a lens blur of 0.5 to 0.9 px."""
    recipe = next(recipe for recipe in RECIPES if recipe.name == "tilted")
    scene = draw(recipe, 7, (radius, radius * 1.001))
    image, truth = scene.shot(), scene.truth()
    seed = Ellipse(truth.u + 0.03 * radius, truth.v, 1.03 * truth.major, 1.03 * truth.major, 0.0)
    near = Ellipse(truth.u + 0.3, truth.v - 0.2, truth.major + 0.2, truth.minor, truth.angle)
    exact = from_ellipse(Ellipse(truth.u, truth.v, truth.major, truth.minor, truth.angle))
    columns, rows = (np.random.default_rng(0).uniform(0, scene.width - 1, (11, 320)).astype(np.float32) for _ in "uv")
    offsets = profile(9, 5, 75).offsets_px
    table: dict[str, Callable[[], object]] = {
        "one remap": lambda: cv2.remap(image, columns, rows, cv2.INTER_LINEAR),
        "rays": lambda: sample(image, exact, 320, offsets, 2.0),
    }
    asked: dict[str, tuple[Ellipse, float]] = {
        "coarse and fine, 4 px": (near, 4.0),
        "coarse and fine, R / 6": (seed, max(4.0, seed.semi_minor_px / 6)),
    }
    for name, (start, search_px) in asked.items():
        table[f"{name}, NumPy"] = partial(refine_plain, image, start, search_px)
        if kernel is not None:
            table[f"{name}, kernel"] = partial(kernel.refine, image, start, search_px, False)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.rim_time", description=__doc__)
    parser.add_argument("--rounds", type=int, default=300)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    kernel = load()
    print("| R | variant | CPU time, median | least | times one remap |\n|---|---|---|---|---|")
    for radius in (45.0, 110.0, 250.0):
        chosen = variants(radius, kernel)
        times: dict[str, list[int]] = {name: [] for name in chosen}
        for _ in range(args.rounds):
            for name, function in chosen.items():
                start = time.thread_time_ns()
                function()
                times[name].append(time.thread_time_ns() - start)
        base = float(np.median(times["one remap"]))
        for name, spent in times.items():
            middle = float(np.median(spent))
            print(
                f"| {radius:.0f} | {name} | {middle / 1e6:.3f} ms | {min(spent) / 1e6:.3f} ms | {middle / base:.1f} |"
            )


if __name__ == "__main__":
    main()
