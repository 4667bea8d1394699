"""Which of the candidates, if any, is the marker. No evidence, no marker: a confident wrong answer is the worst one."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from gateway.model import Circle, Ellipse
from gateway.vision.robust.colours import quality
from gateway.vision.robust.evidence import Evidence
from gateway.vision.robust.rim import Rim

MIN_ASPECT = 0.55  # a disc tilted by 57 degrees
FULL_ASPECT = 0.85  # of a disc tilted by 32 degrees: flatter ones are believed less
MIN_CONTRAST = 0.12  # log units
MIN_REDNESS, MAX_BLUE = 0.12, 0.92  # log units above grey; blue as a share of red: more is magenta
MIN_COVERAGE, MAX_LEAK, MIN_FILL = 0.5, 0.4, 0.55
MIN_VISIBLE, MIN_SUPPORT = 0.4, 0.5


@dataclass(frozen=True, slots=True)
class Limits:
    """What a technician may set, for the picture at hand."""

    min_radius_px: float
    max_radius_px: float
    min_confidence: float


@dataclass(frozen=True, slots=True)
class Candidate:
    """A rim to sub-pixel and what speaks for it; `evidence` was measured on that rim."""

    rim: Rim
    evidence: Evidence

    @property
    def aspect(self) -> float:
        return self.rim.ellipse.semi_minor_px / self.rim.ellipse.semi_major_px


Gate = Callable[[Candidate, Limits], bool]

GATES: tuple[tuple[str, Gate], ...] = (
    ("radius", lambda c, limits: limits.min_radius_px <= c.rim.ellipse.semi_major_px <= limits.max_radius_px),
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
    ("confidence", lambda c, limits: confidence(c) >= limits.min_confidence),
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
    clear = e.contrast / (e.contrast + e.noise + 0.1)
    shape = min(1.0, found.aspect / FULL_ASPECT) ** 2
    return float(
        max(
            0.0,
            min(
                1.0,
                (quality(found.rim) * shape * e.coverage * (1 - e.leak) ** 2 * max(0.0, clear) ** 0.5 * e.fill**0.5)
                ** 0.46,
            ),
        )
    )


def weight(found: Candidate) -> float:
    """Which of several discs is the marker: the surer one, and of equals the larger, as in equation 9."""
    return float(confidence(found) * found.rim.ellipse.semi_major_px**0.3)


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
