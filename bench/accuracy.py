"""How exactly a disc is found in pictures with exact truth: `python -m bench.accuracy`.

For every recipe of `bench.scene` some hundred pictures; on each the refined rim, the paper's method and the usual
alternatives, and the Cramer-Rao floor. Prints Markdown tables and draws plots (matplotlib, dependency group `bench`).
"""

import argparse
import json
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from bench.floor import floor
from bench.pose import pose_error, table_pose
from bench.scene import BEYOND, RECIPES, Truth, draw
from gateway.config import VisionConfig
from gateway.core.detection import Ellipse
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.robust.clearest_rim import clearest_rim
from gateway.vision.detect.robust.refinement import refine
from gateway.vision.detect.robust.rim_fine import Rim

SEED_OFF = 0.05  # of R: the refinement starts from a circle up to so far off, in place and in size
FLOOR_EVERY = 6
ALL = {recipe.name: recipe for recipe in RECIPES + BEYOND}

Answer = tuple[float, float, float] | None  # u, v, R


@dataclass(frozen=True)
class Shot:
    """One picture, as errors per method: (centre, radius), px, None where it found nothing."""

    recipe: str
    radius: float
    errors: dict[str, tuple[float, float] | None]
    floor: tuple[float, float] | None  # of some pictures only: it takes four more of them


def seed_of(truth: Truth, rng: np.random.Generator) -> Ellipse:
    away, heading = rng.uniform(0, SEED_OFF) * truth.major, rng.uniform(0, 2 * np.pi)
    size = truth.major * (1 + rng.uniform(-SEED_OFF, SEED_OFF))
    return Ellipse(truth.u + away * np.cos(heading), truth.v + away * np.sin(heading), size, size, 0.0)


def answer_of(rim: Rim | None) -> Answer:
    return None if rim is None else (rim.ellipse.u_px, rim.ellipse.v_px, rim.ellipse.semi_major_px)


def paper(trace: pipeline.Trace) -> Answer:
    circle = trace.detection.circle
    return None if circle is None else (circle.u_px, circle.v_px, circle.radius_px)


def taubin(trace: pipeline.Trace) -> Answer:
    """Algebraic least squares circle through the mask's contour, Taubin's normalisation."""
    if trace.chosen is None or len(trace.chosen) < 5:
        return None
    points = trace.chosen.reshape(-1, 2).astype(np.float64)
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    z = x * x + y * y
    mean = z.mean()
    z0 = (z - mean) / (2 * np.sqrt(mean))
    a = np.linalg.svd(np.stack([z0, x, y], axis=1), full_matrices=False)[2][-1]
    first = a[0] / (2 * np.sqrt(mean))
    if abs(first) < 1e-15:
        return None
    last = -mean * first
    u, v = -a[1:] / (2 * first)
    radius = np.sqrt(max(a[1] ** 2 + a[2] ** 2 - 4 * first * last, 0.0)) / (2 * abs(first))
    return float(u + middle[0]), float(v + middle[1]), float(radius)


def ams(trace: pipeline.Trace) -> Answer:
    """OpenCV's approximate mean square ellipse through the mask's contour."""
    if trace.chosen is None or len(trace.chosen) < 5:
        return None
    (u, v), axes, _ = cv2.fitEllipseAMS(trace.chosen)
    return u, v, max(axes) / 2


def hough(image: np.ndarray, truth: Truth) -> Answer:
    """On the red less green channel, told the radius to a fifth: more than it would know in the plant."""
    red = cv2.GaussianBlur(cv2.subtract(image[..., 2], image[..., 1]), (5, 5), 0)
    low, high = int(0.8 * truth.major), int(1.2 * truth.major) + 1
    found = cv2.HoughCircles(
        red, cv2.HOUGH_GRADIENT, 1, max(image.shape), param1=100, param2=20, minRadius=low, maxRadius=high
    )
    if found is None or not found.size:
        return None
    u, v, radius = (float(value) for value in found.reshape(-1, found.shape[-1])[0][:3])
    return u, v, radius


REFINED, SHIPPED = "refined rim", "by colours or red alone"
PAPER, HOUGH = "paper (enclosing circle)", "HoughCircles"
ON_MASK: dict[str, Callable[[pipeline.Trace], Answer]] = {PAPER: paper, "Taubin circle": taubin, "fitEllipseAMS": ams}
METHODS = (REFINED, SHIPPED, *ON_MASK, HOUGH)


def measure(task: tuple[str, int, bool]) -> Shot:
    """One picture of one recipe; the other methods and the floor, too, where `beside` is set."""
    cv2.setNumThreads(1)
    name, seed, beside = task
    recipe = ALL[name]
    scene = draw(recipe, seed)
    truth, image = scene.truth(), scene.shot()
    start = seed_of(truth, np.random.default_rng([seed, 1]))
    refined = refine(image, start, max(4.0, start.semi_minor_px / 6))
    shipped = clearest_rim(image, start, start.semi_minor_px / 6)  # the detector's own choice of cue
    answers = {REFINED: answer_of(refined), SHIPPED: answer_of(shipped)}
    if beside:
        trace = pipeline.trace(image, VisionConfig())
        answers |= {method: function(trace) for method, function in ON_MASK.items()}
        answers[HOUGH] = hough(image, truth)
    errors = {method: answer and _error(answer, truth) for method, answer in answers.items()}
    lowest = floor(scene, shape=recipe.tilt_deg > 0) if beside and seed % FLOOR_EVERY == 0 else None
    return Shot(name, truth.major, errors, lowest)


def _error(answer: tuple[float, float, float], truth: Truth) -> tuple[float, float]:
    return float(np.hypot(answer[0] - truth.u, answer[1] - truth.v)), float(answer[2] - truth.major)


def percentile(shots: list[Shot], method: str, which: int, share: float) -> float:
    """Of the absolute errors; a picture without an answer counts as infinitely wrong."""
    answers = [shot.errors[method] for shot in shots]
    errors = [abs(answer[which]) if answer else np.inf for answer in answers]
    return float(np.sort(errors)[min(int(np.ceil(share * len(errors))) - 1, len(errors) - 1)])


def _px(value: float) -> str:
    if not np.isfinite(value):
        return "none"
    return f"{value:.3f}" if value < 1 else f"{value:.2f}" if value < 10 else f"{value:.0f}"


def table_refined(groups: dict[str, list[Shot]]) -> str:
    """The refined rim against its target and against the floor."""
    rows = [
        "| condition | pictures | centre p50 | centre p95 | radius p50 | radius p95 | radius bias | limit p95 | met "
        "| floor centre, radius | times the floor |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, shots in groups.items():
        found = [shot for shot in shots if shot.errors[REFINED]]
        values = [percentile(shots, REFINED, which, share) for which in (0, 1) for share in (0.5, 0.95)]
        errors = np.array([shot.errors[REFINED] for shot in found])
        some = [shot for shot in found if shot.floor]
        floors = np.array([shot.floor for shot in some])
        lowest, times = "–", "–"
        if some:
            rms = np.sqrt(np.mean(np.square(floors), axis=0))
            # Medians of error over floor, in units of what Gaussian errors at the floor would give.
            ratios = np.abs(np.array([shot.errors[REFINED] for shot in some])) / floors
            usual = np.median(ratios, axis=0) / (0.8326, 0.6745)
            lowest, times = f"{rms[0]:.4f}, {rms[1]:.4f}", f"{usual[0]:.1f}, {usual[1]:.1f}"
        limit = ALL[name].limit
        met = "yes" if max(values[1], values[3]) <= limit else "**no**"
        rows.append(
            f"| {name} | {len(shots)} | {' | '.join(map(_px, values))} "
            f"| {np.median(errors[:, 1]):+.3f} | {limit} | {met} "
            f"| {lowest} | {times} |"
        )
    return "\n".join(rows) + "\n"


def table_methods(groups: dict[str, list[Shot]]) -> str:
    """Every method: centre p50 / p95, radius p50 / p95, share without an answer."""
    rows = ["| condition | " + " | ".join(METHODS) + " |", "|---|" + "---|" * len(METHODS)]
    for name, every in groups.items():
        cells = []
        shots = [shot for shot in every if PAPER in shot.errors]
        if not shots:
            continue
        for method in METHODS:
            centre = "/".join(_px(percentile(shots, method, 0, share)) for share in (0.5, 0.95))
            radius = "/".join(_px(percentile(shots, method, 1, share)) for share in (0.5, 0.95))
            missing = sum(shot.errors[method] is None for shot in shots) / len(shots)
            cells.append(f"{centre} · {radius}" + (f" ({missing:.0%} none)" if missing else ""))
        rows.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"


def read(path: Path) -> dict[str, list[Shot]]:
    """What `--raw` kept, grouped by recipe."""
    groups: dict[str, list[Shot]] = {}
    for line in path.read_text().splitlines():
        shot = Shot(**json.loads(line))
        groups.setdefault(shot.recipe, []).append(shot)
    return groups


def run(names: list[str], pictures: int, beside: int, jobs: int, raw: Path) -> None:
    """Measure, and append every picture's errors to `raw` as they come: an interrupted run has its use, too."""
    tasks = [(name, seed, seed < beside) for seed in range(pictures) for name in names]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool, raw.open("w") as file:
        for done, shot in enumerate(pool.map(measure, tasks, chunksize=4), 1):
            file.write(json.dumps(asdict(shot)) + "\n")
            file.flush()
            print(f"\r{done} of {len(tasks)} pictures", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.accuracy", description=__doc__)
    parser.add_argument("--pictures", type=int, default=300, help="of every recipe (default 300)")
    parser.add_argument("--beside", type=int, default=300, help="the other methods and the floor on so many of them")
    parser.add_argument("--only", nargs="*", choices=list(ALL), metavar="RECIPE", help=f"of: {', '.join(ALL)}")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--raw", type=Path, default=Path("accuracy.jsonl"), help="every single error, as JSON lines")
    parser.add_argument("--tables-only", action="store_true", help="of what is in RAW; measure nothing")
    parser.add_argument("--poses", type=int, default=0, metavar="N", help="the tilted disc's own centre, in N pictures")
    parser.add_argument("--plots", type=Path, metavar="DIR", help="draw the plots there; needs matplotlib")
    args = parser.parse_args()
    if not args.tables_only:
        run(args.only or list(ALL), args.pictures, args.beside, args.jobs, args.raw)
    groups = read(args.raw)
    print(table_refined(groups))
    print(table_methods(groups))
    if args.poses:
        print(table_pose([pose_error(seed) for seed in range(args.poses)]))
    if args.plots:
        from bench.accuracy_plots import plot_all  # noqa: PLC0415  (matplotlib only where it is asked for)

        plot_all(groups, args.plots)


if __name__ == "__main__":
    main()
