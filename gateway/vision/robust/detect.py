"""The robust method: candidates, evidence for each, rim to sub-pixel, decision. Pure: the clock is handed in."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise, zip_longest

import numpy as np

from gateway.config import VisionConfig
from gateway.model import Circle, Detection, Ellipse, Rejection
from gateway.vision.intrinsics import normalise
from gateway.vision.pixels import Image
from gateway.vision.robust import candidates, evidence
from gateway.vision.robust.candidates import Seed
from gateway.vision.robust.decision import Candidate, Limits, alike, circle_of, confidence, promise, veto
from gateway.vision.robust.evidence import Evidence
from gateway.vision.robust.redness import Level, pyramid
from gateway.vision.robust.rim import Rim, refine

NowNs = Callable[[], int]
Window = tuple[int, int, int, int]  # x0, y0, x1, y1 px of the whole picture, the last two beyond it
Told = tuple[float, Circle, str]  # how near a rejected candidate came, where it is, why it was not taken

MIN_RADIUS, MAX_RADIUS = 0.01, 0.5  # shares of the picture's diagonal
SMALLEST_PX = 4.0
SEEDS = 24  # looked at
RIMS = 5  # whose rim is refined
REJECTED = 5  # in a Detection


def detect(
    image: Image,
    params: VisionConfig,
    now_ns: NowNs = lambda: 0,
    *,
    window: Window | None = None,
    expected: Circle | None = None,
) -> Detection:
    """The red disc in one (H, W, 3) uint8 BGR picture. `now_ns` gives the times of `stage_ns`; without it, 0.

    `window` restricts the search to a part of the picture; `expected` is looked at before anything else, and if it is
    the marker nothing else is looked at. Coordinates are always the whole picture's. Raises ValueError for anything but
    such a picture with at least one pixel.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ValueError(f"not a (H, W, 3) uint8 picture: {image.shape} {image.dtype}")
    stamps = [("", now_ns())]

    def done(stage: str) -> None:
        stamps.append((stage, now_ns()))

    diagonal = math.hypot(*image.shape[:2])
    limits = (max(SMALLEST_PX, MIN_RADIUS * diagonal), MAX_RADIUS * diagonal)
    x0, y0, part = _part(image, window)
    first = max(1, int(limits[0] // 10))
    levels = pyramid(part, first, 8)
    done("pyramid")
    seeds = candidates.distinct(_seeds(levels, limits), SEEDS)
    if expected is not None:
        seeds.insert(0, Seed(expected.u_px - x0, expected.v_px - y0, expected.radius_px, 2.0))
    done("candidates")
    worth, rejected = _worth_a_rim(seeds, evidence.gather(levels, seeds), limits)
    done("evidence")
    refined, no_rims = _refined(part, levels, worth)
    done("rim")
    taken, others = _decided(refined, limits)
    rejected = sorted([*rejected, *no_rims, *others], key=lambda told: -told[0])[:REJECTED]
    done("decision")
    point = None
    if taken is not None and params.intrinsics:
        point = normalise(taken.rim.ellipse.u_px + x0, taken.rim.ellipse.v_px + y0, params.intrinsics)
    done("normalise")
    found = Detection(
        circle=None,
        candidates=len(seeds),
        stage_ns=tuple((stage, end_ns - start_ns) for (_, start_ns), (stage, end_ns) in pairwise(stamps)),
        rejected=tuple(Rejection(Circle(c.u_px + x0, c.v_px + y0, c.radius_px), why) for _, c, why in rejected),
    )
    if taken is None:
        return found
    e = taken.rim.ellipse
    ellipse = replace(e, u_px=e.u_px + x0, v_px=e.v_px + y0)
    x_n, y_n = point or (None, None)
    return replace(
        found,
        circle=circle_of(ellipse),
        ellipse=ellipse,
        area_px2=math.pi * e.semi_major_px * e.semi_minor_px,
        circularity=_circularity(e),
        fill=e.semi_minor_px / e.semi_major_px,
        x_n=x_n,
        y_n=y_n,
        confidence=confidence(taken),
        visible=taken.rim.visible,
    )


def _part(image: Image, window: Window | None) -> tuple[int, int, Image]:
    """The window as far as it lies in the picture, at least one pixel of it, and its corner."""
    if window is None:
        return 0, 0, image
    height, width = image.shape[:2]
    x0, y0 = min(max(0, window[0]), width - 1), min(max(0, window[1]), height - 1)
    return x0, y0, image[y0 : max(y0 + 1, window[3]), x0 : max(x0 + 1, window[2])]


def _seeds(levels: Sequence[Level], limits: Limits) -> list[Seed]:
    """Votes and blobs in turn, the strongest first."""
    voting = levels if levels[0].factor == 1 else levels[1:]  # otherwise the finest is for looking closely
    voted = [seed for level in voting for seed in candidates.votes(level)]
    voted = [seed for seed in voted if 0.75 * limits[0] <= seed.radius_px <= 1.3 * limits[1]]
    blobs = candidates.blobs(voting[0], limits) if voting else []
    voted.sort(key=lambda seed: -seed.weight)
    blobs.sort(key=lambda seed: -seed.radius_px)
    return [seed for pair in zip_longest(voted, blobs) for seed in pair if seed is not None]


def _worth_a_rim(
    seeds: Sequence[Seed], looked: Sequence[Evidence | None], limits: Limits
) -> tuple[list[Evidence], list[Told]]:
    """The most promising, each rim once; and those that are nothing for sure."""
    told: list[Told] = []
    hopeful: list[Evidence] = []
    for seed, found in zip(seeds, looked, strict=True):
        if found is None:
            told.append((0.0, Circle(seed.u_px, seed.v_px, seed.radius_px), "rim"))
        else:
            hopeful.append(found)
    kept: list[Evidence] = []
    for found in sorted(hopeful, key=lambda found: -promise(found)):
        if len(kept) < RIMS and not any(alike(found.ellipse, other.ellipse) for other in kept):
            kept.append(found)
    return kept, told


def _refined(part: Image, levels: Sequence[Level], worth: Sequence[Evidence]) -> tuple[list[Candidate], list[Told]]:
    """Their rims at full resolution, and the evidence on these."""
    rims: list[Rim] = []
    told: list[Told] = []
    for found in worth:
        e = found.ellipse
        rim = refine(part, e, search_px=max(3.0, 0.1 * e.semi_minor_px))
        if rim is None:
            told.append((promise(found), circle_of(e), "rim"))
        elif not any(alike(rim.ellipse, other.ellipse) for other in rims):
            rims.append(rim)
    measured = evidence.of_ellipses(levels, [rim.ellipse for rim in rims])
    return [Candidate(rim, found) for rim, found in zip(rims, measured, strict=True) if found], told


def _decided(refined: Sequence[Candidate], limits: Limits) -> tuple[Candidate | None, list[Told]]:
    """The marker, and the others with the reason."""
    told: list[Told] = []
    passed: list[Candidate] = []
    for candidate in refined:
        if why := veto(candidate, limits):
            told.append((1 + confidence(candidate), circle_of(candidate.rim.ellipse), why))
        else:
            passed.append(candidate)
    best = max(passed, key=lambda c: confidence(c) * c.rim.ellipse.semi_major_px**0.3, default=None)
    told += [(2 + confidence(c), circle_of(c.rim.ellipse), "weaker") for c in passed if c is not best]
    return best, told


def _circularity(e: Ellipse) -> float:
    """4 pi area / perimeter^2 of the ellipse (Ramanujan's perimeter, good to 1e-5 here)."""
    a, b = e.semi_major_px, e.semi_minor_px
    h = ((a - b) / (a + b)) ** 2
    perimeter = math.pi * (a + b) * (1 + 3 * h / (10 + math.sqrt(4 - 3 * h)))
    return 4 * math.pi * math.pi * a * b / perimeter**2
