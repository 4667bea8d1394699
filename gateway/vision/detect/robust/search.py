"""From a picture to the one candidate that is the marker, and the others with the reasons why they are not. Pure."""

import math
from collections.abc import Sequence
from itertools import zip_longest

from gateway.core.detection import Circle, Ellipse
from gateway.vision.detect.geometry import same_ellipse
from gateway.vision.detect.robust import candidates, evidence, proposer
from gateway.vision.detect.robust.candidates import Seed
from gateway.vision.detect.robust.colours import CLEARLY, clearest_rim, quality
from gateway.vision.detect.robust.decision import (
    Candidate,
    Limits,
    circle_of,
    confidence,
    failed_gate,
    priority,
    weight,
)
from gateway.vision.detect.robust.evidence import EVIDENCE_RADIUS_PX, Evidence
from gateway.vision.detect.robust.redness import PyramidLevel, pyramid
from gateway.vision.detect.robust.rim import Rim
from gateway.vision.detect.stage_timer import StageTimer
from gateway.vision.pixels import Image

Rejected = tuple[float, Circle, str]  # how near to acceptance it was, where it is, why it was not taken

SEEDS = 24  # measured
RIMS = 5  # whose rim is refined
REJECTED = 5  # reported
FINEST_PX = 10.0  # radius of the smallest disc on the finest level, px of it, at least
COARSEST_PX = 8  # side of the coarsest level
FLAT = 0.8  # semi-minor by semi-major axis below which a circle is tried, too
EXPECTED_REACH = 0.25  # how far off a prediction's rim is searched for, of its radius


def search_frame(image: Image, limits: Limits, timer: StageTimer) -> tuple[Candidate | None, int, list[Rejected]]:
    """The marker, how many candidates there were, and the best few of the others."""
    levels = levels_of(image, limits)
    timer.ended("pyramid")
    seeds = proposed(levels, limits)
    timer.ended("candidates")
    worth, nothing = _worth_a_rim(seeds, evidence.gather(levels, seeds))
    timer.ended("evidence")
    refined, no_rims = _refined(image, levels, worth)
    timer.ended("rim")
    taken, others = _decided(refined, limits)
    timer.ended("decision")
    rejected = sorted([*nothing, *no_rims, *others], key=lambda entry: -entry[0])[:REJECTED]
    return taken, len(seeds), rejected


def search_expected(image: Image, expected: Circle, limits: Limits) -> Candidate | None:
    """The marker if it is where it is expected and passes every gate; None: look everywhere."""
    radius = expected.radius_px
    if not (radius > 0 and all(map(math.isfinite, (radius, expected.u_px, expected.v_px)))):
        return None
    seed = Ellipse(expected.u_px, expected.v_px, radius, radius, 0.0)
    rim = clearest_rim(image, seed, EXPECTED_REACH * radius)
    if rim is None:
        return None
    factor = 2 ** max(0, math.floor(math.log2(rim.ellipse.semi_minor_px / EVIDENCE_RADIUS_PX)))
    if min(image.shape[:2]) < 2 * factor:
        return None
    (found,) = evidence.of_ellipses(pyramid(image, factor, max(image.shape[:2])), [rim.ellipse])
    if found is None:
        return None
    candidate = Candidate(rim, found)
    return candidate if failed_gate(candidate, limits) is None else None


def levels_of(image: Image, limits: Limits) -> list[PyramidLevel]:
    """The pyramid that a search in the picture starts from."""
    return pyramid(image, max(1, int(limits.min_radius_px // FINEST_PX)), COARSEST_PX)


def proposed(levels: Sequence[PyramidLevel], limits: Limits) -> list[Seed]:
    """The places worth measuring: the net's first, where it is asked; then at most SEEDS others."""
    learned = [] if limits.proposals == "classical" else proposer.shipped()(levels)
    return candidates.distinct(
        learned if limits.proposals == "learned" else [*learned, *_seeds(levels, limits)], SEEDS + len(learned)
    )


def _seeds(levels: Sequence[PyramidLevel], limits: Limits) -> list[Seed]:
    """Votes and blobs in turn, the strongest first."""
    smallest, largest = limits.min_radius_px, limits.max_radius_px
    # Levels finer than the smallest disc needs serve close measurement only: most of the time would be spent there.
    finer = sum(level.factor * candidates.RADII[0] <= smallest for level in levels) - 1
    voting = levels[max(0, finer) :]
    voted = [seed for level in voting for seed in candidates.votes(level)]
    voted = [seed for seed in voted if 0.75 * smallest <= seed.radius_px <= 1.3 * largest]
    blobs = candidates.blobs(voting[0], (smallest, largest)) if voting else []
    voted.sort(key=lambda seed: -seed.weight)
    blobs.sort(key=lambda seed: -seed.radius_px)
    return [seed for pair in zip_longest(voted, blobs) for seed in pair if seed is not None]


def _worth_a_rim(seeds: Sequence[Seed], measured: Sequence[Evidence | None]) -> tuple[list[Evidence], list[Rejected]]:
    """The most promising, each rim once; and those that are nothing for sure."""
    rejected: list[Rejected] = []
    with_rim: list[Evidence] = []
    for seed, found in zip(seeds, measured, strict=True):
        if found is None:
            rejected.append((0.0, Circle(seed.u_px, seed.v_px, seed.radius_px), "rim"))
        else:
            with_rim.append(found)
    kept: list[Evidence] = []
    for found in sorted(with_rim, key=lambda found: -priority(found)):
        if len(kept) < RIMS and not any(same_ellipse(found.ellipse, other.ellipse) for other in kept):
            kept.append(found)
    return kept, rejected


def _refined(
    image: Image, levels: Sequence[PyramidLevel], worth: Sequence[Evidence]
) -> tuple[list[Candidate], list[Rejected]]:
    """Their rims at full resolution, and the evidence on these."""
    rims: list[Rim] = []
    rejected: list[Rejected] = []
    for found in worth:
        rim = _rim_near(image, found.ellipse)
        if rim is None:
            rejected.append((priority(found), circle_of(found.ellipse), "rim"))
        elif not any(same_ellipse(rim.ellipse, other.ellipse) for other in rims):
            rims.append(rim)
    measured = evidence.of_ellipses(levels, [rim.ellipse for rim in rims])
    return [Candidate(rim, found) for rim, found in zip(rims, measured, strict=True) if found], rejected


def _rim_near(image: Image, seen: Ellipse) -> Rim | None:
    """The rim at full resolution near the one seen in redness; from a circle, too, where that one is flat.

    A disc before a red band has no edge of redness where it hides the band: the ellipse through the others is drawn out
    along it. Brightness shows the rim there, if it is searched for where a round disc has it.
    """
    rim = clearest_rim(image, seen)
    if seen.semi_minor_px >= FLAT * seen.semi_major_px:
        return rim
    mean_px = math.sqrt(seen.semi_major_px * seen.semi_minor_px)
    other = clearest_rim(image, Ellipse(seen.u_px, seen.v_px, mean_px, mean_px, 0.0))
    if other is None or rim is None:
        return rim
    return other if quality(other) > quality(rim) + CLEARLY else rim


def _decided(refined: Sequence[Candidate], limits: Limits) -> tuple[Candidate | None, list[Rejected]]:
    """The marker, and the others with the reason."""
    rejected: list[Rejected] = []
    passed: list[Candidate] = []
    for candidate in refined:
        if why := failed_gate(candidate, limits):
            rejected.append((1 + confidence(candidate), circle_of(candidate.rim.ellipse), why))
        else:
            passed.append(candidate)
    best = max(passed, key=weight, default=None)
    rejected += [(2 + confidence(c), circle_of(c.rim.ellipse), "weaker") for c in passed if c is not best]
    return best, rejected
