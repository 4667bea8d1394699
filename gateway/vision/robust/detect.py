"""The robust method: candidates, evidence for each, decision, rim to sub-pixel. Pure: the clock is handed in."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from gateway.config import VisionConfig
from gateway.model import Circle, Detection, Ellipse, Rejection
from gateway.vision.intrinsics import normalise
from gateway.vision.pixels import Image
from gateway.vision.robust import candidates, evidence
from gateway.vision.robust.candidates import Seed
from gateway.vision.robust.decision import confidence, decide
from gateway.vision.robust.evidence import Evidence
from gateway.vision.robust.redness import Level, pyramid

NowNs = Callable[[], int]
Window = tuple[int, int, int, int]  # x0, y0, x1, y1 px of the whole picture, the last two beyond it

MIN_RADIUS, MAX_RADIUS = 0.01, 0.5  # shares of the picture's diagonal
SEEDS = 24  # looked at closely
TOLD = 5  # rejected candidates in a Detection
LOOK_PX = 14.0  # radius at which a candidate is looked at closely


def detect(
    image: Image,
    params: VisionConfig,
    now_ns: NowNs = lambda: 0,
    *,
    window: Window | None = None,
    expected: Circle | None = None,
) -> Detection:
    """The red disc in one (H, W, 3) uint8 BGR picture. `now_ns` gives the times of `stage_ns`; without it, 0.

    `window` restricts the search to a part of the picture, `expected` is looked at first; coordinates are always the
    whole picture's. Raises ValueError for anything but such a picture with at least one pixel.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ValueError(f"not a (H, W, 3) uint8 picture: {image.shape} {image.dtype}")
    stamps = [("", now_ns())]

    def done(stage: str) -> None:
        stamps.append((stage, now_ns()))

    diagonal = math.hypot(*image.shape[:2])
    limits = (max(4.0, MIN_RADIUS * diagonal), MAX_RADIUS * diagonal)
    x0, y0, part = _part(image, window)
    first = max(1, int(limits[0] // 10))
    levels = pyramid(part, first, 8)
    done("pyramid")
    seeds = _seeds(levels, first, limits)
    if expected is not None:
        seeds.insert(0, Seed(expected.u_px - x0, expected.v_px - y0, expected.radius_px, 2.0))
    seeds = candidates.distinct(seeds, SEEDS)
    done("candidates")
    looked = _look(levels, seeds)
    done("evidence")
    taken, rejected = decide(looked, limits)
    done("decision")
    stage_ns = tuple((stage, end - start) for (_, start), (stage, end) in pairwise(stamps))
    told = tuple(Rejection(_moved(circle, x0, y0), why) for circle, why in rejected[:TOLD])
    if taken is None:
        return Detection(None, candidates=len(seeds), stage_ns=stage_ns, rejected=told)
    e = taken.ellipse
    ellipse = Ellipse(e.u_px + x0, e.v_px + y0, e.semi_major_px, e.semi_minor_px, e.angle_rad)
    point = normalise(ellipse.u_px, ellipse.v_px, params.intrinsics) if params.intrinsics else None
    x_n, y_n = point or (None, None)
    a, b = ellipse.semi_major_px, ellipse.semi_minor_px
    return Detection(
        circle=Circle(ellipse.u_px, ellipse.v_px, a),
        area_px2=math.pi * a * b,
        circularity=4 * a * b / (a + b) ** 2,
        fill=b / a,
        candidates=len(seeds),
        x_n=x_n,
        y_n=y_n,
        stage_ns=stage_ns,
        ellipse=ellipse,
        confidence=confidence(taken),
        visible=taken.visible,
        rejected=told,
    )


def _part(image: Image, window: Window | None) -> tuple[int, int, Image]:
    if window is None:
        return 0, 0, image
    height, width = image.shape[:2]
    x0, y0 = min(max(0, window[0]), width - 1), min(max(0, window[1]), height - 1)
    return x0, y0, image[y0 : max(y0 + 1, window[3]), x0 : max(x0 + 1, window[2])]


def _seeds(levels: list[Level], first: int, limits: tuple[float, float]) -> list[Seed]:
    # The finest level is only for looking closely, unless it is the picture itself.
    voting = levels if first == 1 else levels[1:]
    voted = [seed for level in voting for seed in candidates.votes(level)]
    blobs = candidates.blobs(voting[0], limits) if voting else []
    voted = [seed for seed in voted if 0.75 * limits[0] <= seed.radius_px <= 1.3 * limits[1]]
    voted.sort(key=lambda seed: -seed.weight)
    blobs.sort(key=lambda seed: -seed.radius_px)
    return [seed for pair in _alternating(voted, blobs) for seed in pair]


def _alternating(one: list[Seed], other: list[Seed]) -> list[list[Seed]]:
    return [[*one[i : i + 1], *other[i : i + 1]] for i in range(max(len(one), len(other)))]


def _look(levels: list[Level], seeds: list[Seed]) -> list[tuple[Seed, Evidence | None]]:
    by_level: dict[int, list[int]] = {}
    for n, seed in enumerate(seeds):
        k = int(
            np.clip(math.floor(math.log2(max(1e-9, seed.radius_px / LOOK_PX / levels[0].factor))), 0, len(levels) - 1)
        )
        by_level.setdefault(k, []).append(n)
    looked: list[tuple[Seed, Evidence | None]] = [(seed, None) for seed in seeds]
    for k, which in by_level.items():
        for n, found in zip(which, evidence.gather(levels[k], [seeds[n] for n in which]), strict=True):
            looked[n] = (seeds[n], found)
    return looked


def _moved(circle: Circle, x0: int, y0: int) -> Circle:
    return Circle(circle.u_px + x0, circle.v_px + y0, circle.radius_px)
