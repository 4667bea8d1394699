"""Which of the candidates, if any, is the marker. No evidence, no marker: a confident wrong answer is the worst one."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from gateway.model import Circle, Ellipse
from gateway.vision.robust.evidence import Evidence
from gateway.vision.robust.rim import Rim

Limits = tuple[float, float]  # smallest and largest radius, px

MIN_ASPECT = 0.55  # a disc tilted by 57 degrees
MIN_CONTRAST = 0.12  # log units
MIN_REDNESS, MAX_BLUE = 0.12, 0.92  # log units above grey; blue as a share of red: more is magenta
MIN_COVERAGE, MAX_LEAK, MIN_FILL = 0.5, 0.4, 0.55
MIN_VISIBLE, MIN_SUPPORT = 0.4, 0.5
MIN_CONFIDENCE = 0.22


@dataclass(frozen=True, slots=True)
class Candidate:
    """A rim to sub-pixel and what speaks for it; `evidence` was measured on that rim."""

    rim: Rim
    evidence: Evidence

    @property
    def rough(self) -> float:
        """Scatter of the edges about the rim, in what a real one has at most: half a pixel and 1 % of the radius."""
        return self.rim.rms_px / (0.5 + 0.01 * self.rim.ellipse.semi_minor_px)

    @property
    def aspect(self) -> float:
        return self.rim.ellipse.semi_minor_px / self.rim.ellipse.semi_major_px


Gate = Callable[[Candidate, Limits], bool]

GATES: tuple[tuple[str, Gate], ...] = (
    ("radius", lambda c, limits: limits[0] <= c.rim.ellipse.semi_major_px <= limits[1]),
    ("shape", lambda c, _: c.aspect >= MIN_ASPECT),
    ("contrast", lambda c, _: c.evidence.contrast >= MIN_CONTRAST),
    (
        "colour",
        lambda c, _: c.evidence.redness >= MIN_REDNESS and c.evidence.colour[0] < MAX_BLUE * c.evidence.colour[2],
    ),
    ("coverage", lambda c, _: c.evidence.coverage >= MIN_COVERAGE),
    ("leak", lambda c, _: c.evidence.leak <= MAX_LEAK),
    ("visible", lambda c, _: c.rim.visible >= MIN_VISIBLE),
    ("fill", lambda c, _: c.evidence.fill >= MIN_FILL),
    ("support", lambda c, _: c.rim.support >= MIN_SUPPORT),
    ("confidence", lambda c, _: confidence(c) >= MIN_CONFIDENCE),
)
"""Code and test, in order: a candidate must pass them all. The codes are explained in `rejections`."""


def veto(found: Candidate, limits: Limits) -> str | None:
    """The code of the first gate that the candidate does not pass."""
    return next((code for code, passes in GATES if not passes(found, limits)), None)


def promise(found: Evidence) -> float:
    """Before the rim is known: which candidates are worth its cost."""
    clear = found.contrast / (found.contrast + 2 * found.noise + 0.1)
    aspect = found.ellipse.semi_minor_px / found.ellipse.semi_major_px
    return float(found.coverage * clear * aspect * found.fill * math.sqrt(found.visible))


def confidence(found: Candidate) -> float:
    """0 to 1: how much of the rim is an edge, how round it is, how red inside, and how little outside; a product."""
    e = found.evidence
    edge = found.rim.support / (1 + found.rough**2)
    clear = e.contrast / (e.contrast + e.noise + 0.1)
    return float(max(0.0, min(1.0, edge * e.coverage * max(0.0, clear) ** 0.5 * e.fill**0.5)))


def circle_of(ellipse: Ellipse) -> Circle:
    """The circle round a rim: equation 10's meaning for a disc that is seen as an ellipse."""
    return Circle(ellipse.u_px, ellipse.v_px, ellipse.semi_major_px)


def alike(one: Ellipse, other: Ellipse) -> bool:
    """Whether two rims are the same one, fitted twice."""
    reach = 0.15 * min(one.semi_minor_px, other.semi_minor_px) + 1
    near = abs(one.u_px - other.u_px) < reach and abs(one.v_px - other.v_px) < reach
    return (
        near
        and abs(one.semi_major_px - other.semi_major_px) < reach
        and abs(one.semi_minor_px - other.semi_minor_px) < reach
    )
