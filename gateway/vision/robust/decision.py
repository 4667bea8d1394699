"""Which of the candidates, if any, is the marker. No evidence, no marker: a confident wrong answer is the worst one."""

from collections.abc import Callable

from gateway.model import Circle
from gateway.vision.robust.candidates import Seed
from gateway.vision.robust.evidence import Evidence

Limits = tuple[float, float]  # smallest and largest radius, px

MIN_ASPECT = 0.5  # a disc tilted by 60 degrees
MIN_CONTRAST, MIN_SIGNAL = 0.12, 2.0  # log units; times the scatter outside
MIN_COVERAGE, MIN_VISIBLE, MIN_FILL = 0.7, 0.4, 0.55

GATES: tuple[tuple[str, Callable[[Evidence, Limits], bool]], ...] = (
    ("radius", lambda e, limits: limits[0] <= e.ellipse.semi_major_px <= limits[1]),
    ("shape", lambda e, _: e.ellipse.semi_minor_px >= MIN_ASPECT * e.ellipse.semi_major_px),
    ("contrast", lambda e, _: e.contrast >= max(MIN_CONTRAST, MIN_SIGNAL * e.noise)),
    ("colour", lambda e, _: e.colour[2] > max(e.colour[0], e.colour[1])),
    ("coverage", lambda e, _: e.coverage >= MIN_COVERAGE),
    ("visible", lambda e, _: e.visible >= MIN_VISIBLE),
    ("fill", lambda e, _: e.fill >= MIN_FILL),
)
"""Code and test, in order: a candidate must pass them all. The codes are explained in `rejections`."""


def veto(found: Evidence, limits: Limits) -> str | None:
    """The code of the first gate that the evidence does not pass."""
    return next((code for code, passes in GATES if not passes(found, limits)), None)


def confidence(found: Evidence) -> float:
    """0 to 1: edge coverage, contrast against noise, and fill."""
    clear = found.contrast / (found.contrast + found.noise + 0.1)
    return max(0.0, min(1.0, found.coverage * clear * min(1.0, 0.4 + 0.6 * found.fill)))


def decide(
    looked: list[tuple[Seed, Evidence | None]], limits: Limits
) -> tuple[Evidence | None, list[tuple[Circle, str]]]:
    """The marker, and the candidates not taken with the reason, the best first."""
    passed: list[Evidence] = []
    rejected: list[tuple[float, Circle, str]] = []
    for seed, found in looked:
        if found is None:
            rejected.append((0.0, Circle(seed.u_px, seed.v_px, seed.radius_px), "rim"))
        elif why := veto(found, limits):
            rejected.append((confidence(found), _circle(found), why))
        else:
            passed.append(found)
    best = max(passed, key=lambda found: confidence(found) * found.ellipse.semi_major_px**0.3, default=None)
    rejected += [(1 + confidence(found), _circle(found), "weaker") for found in passed if found is not best]
    rejected.sort(key=lambda entry: -entry[0])
    return best, [(circle, why) for _, circle, why in rejected]


def _circle(found: Evidence) -> Circle:
    return Circle(found.ellipse.u_px, found.ellipse.v_px, found.ellipse.semi_major_px)
