"""Which of the candidates, if any, is the marker. No evidence, no marker: a confident wrong answer is the worst one."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from gateway.config.sections.vision import Proposals
from gateway.core.detection import Circle, Ellipse
from gateway.vision.detect.robust.clearest_rim import roundness
from gateway.vision.detect.robust.constants import FULL_REDNESS
from gateway.vision.detect.robust.evidence import Evidence
from gateway.vision.detect.robust.marker_colour import (
    PAPER_RED,
    WHITE_LIGHT,
    Cast,
    MarkerColour,
    distance,
    in_white_light,
    not_brown,
    paint_left,
)
from gateway.vision.detect.robust.rim_fine import Rim

MIN_ASPECT = 0.55  # a disc tilted by 57 degrees
MIN_CONTRAST, MIN_SHARE = 0.15, 0.4  # log units in clear air; of the redness inside: less is a red spot on red
MIN_COVERAGE, MAX_LEAK, MIN_FILL, MAX_HOLLOW = 0.6, 0.4, 0.5, 0.75
MIN_VISIBLE, MIN_SUPPORT = 0.4, 0.45
MAX_BLUR, MIN_STEP = 0.24, 0.5  # sigma of the edge, of the semi-minor axis; fall at the rim, of that from the core

FULL_ASPECT, FULL_CONTRAST = 0.85, 0.45  # from which on they have their full weight for a disc
VEILED_REDNESS = 1.0  # the same behind a full veil: how much more was there is no longer known
ODDS = 80.0  # for a disc with nothing against it
VEILED_ODDS = 0.8  # so much less behind a full veil, of which only an estimate was subtracted
POWERS = {
    "support": 5.0,
    "round": 3.0,
    "coverage": 1.5,
    "sealed": 6.0,
    "clear": 1.5,
    "fill": 2.0,
    "aspect": 3.0,
    "contrast": 2.0,
    "colour": 4.0,
}
"""How much each kind of evidence weighs: a logistic regression on half of a set of pictures, in round numbers."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a technician may set, for the picture at hand."""

    min_radius_px: float
    max_radius_px: float
    min_confidence: float
    possible_px: tuple[float, float] | None = None  # radii, where the ranger limits them; of a marker, not of a search
    proposals: Proposals = "classical"  # where a search starts
    marker: MarkerColour = PAPER_RED
    cast: Cast = WHITE_LIGHT


@dataclass(frozen=True, slots=True)
class Candidate:
    """A rim to sub-pixel and its evidence; `evidence` was measured on that rim."""

    rim: Rim
    evidence: Evidence
    veil: float = 0.0  # share of airlight over it, as far as known; the evidence may be that of the picture as it is
    off_colour: float = 0.0  # 0: of the marker's colour; above 1: of another

    @property
    def aspect(self) -> float:
        return self.rim.ellipse.semi_minor_px / self.rim.ellipse.semi_major_px


def candidate(rim: Rim, found: Evidence, limits: Limits, veil: float = 0.0) -> Candidate:
    """With the evidence as it would be in white light."""
    off = distance(found, limits.marker, limits.cast)
    return Candidate(rim, in_white_light(found, limits.cast), veil, off)


def _sharp(c: Candidate) -> bool:
    return c.rim.blur_px <= MAX_BLUR * c.rim.ellipse.semi_minor_px and c.evidence.contrast >= MIN_STEP * c.evidence.rise


def _of_possible_size(c: Candidate, limits: Limits) -> bool:
    possible = limits.possible_px
    return possible is None or possible[0] <= c.rim.ellipse.semi_major_px <= possible[1]


Gate = Callable[[Candidate, Limits], bool]

GATES: tuple[tuple[str, Gate], ...] = (
    ("radius", lambda c, limits: limits.min_radius_px <= c.rim.ellipse.semi_major_px <= limits.max_radius_px),
    ("shape", lambda c, _: c.aspect >= MIN_ASPECT),
    ("contrast", lambda c, _: c.evidence.contrast >= MIN_CONTRAST * paint_left(c.evidence)),
    ("surroundings", lambda c, _: c.evidence.contrast >= MIN_SHARE * c.evidence.redness),
    ("colour", lambda c, limits: c.off_colour <= 1 and not_brown(c.evidence, limits.marker)),
    ("coverage", lambda c, _: c.evidence.coverage >= MIN_COVERAGE),
    ("leak", lambda c, _: c.evidence.leak <= MAX_LEAK),
    ("visible", lambda c, _: c.rim.visible >= MIN_VISIBLE),
    ("fill", lambda c, _: c.evidence.fill >= MIN_FILL),
    ("hollow", lambda c, _: c.evidence.hollow <= MAX_HOLLOW),
    ("support", lambda c, _: c.rim.support >= MIN_SUPPORT),
    ("blur", lambda c, _: _sharp(c)),
    ("confidence", lambda c, limits: confidence(c) >= limits.min_confidence),
    ("size", _of_possible_size),
)
"""Code and test, in order: a candidate must pass them all. The codes are explained in `method.REJECTIONS`.

`size` is the last: what it refuses is a red disc, as good as a marker.
"""


def failed_gate(found: Candidate, limits: Limits) -> str | None:
    """The code of the first gate that the candidate does not pass."""
    return next((code for code, passes in GATES if not passes(found, limits)), None)


def priority(found: Evidence) -> float:
    """Before the rim is known: which candidates are worth its cost."""
    clear = found.contrast / (found.contrast + 2 * found.noise + 0.1)
    aspect = found.ellipse.semi_minor_px / found.ellipse.semi_major_px
    return float(found.coverage * clear * aspect * found.fill * math.sqrt(found.visible))


def confidence(found: Candidate) -> float:
    """0 to 1, the probability of a disc: the odds are a product of powers of shares, each 1 where nothing is amiss."""
    e = found.evidence
    contrast = max(e.contrast, 1e-3)
    shares = {
        "support": found.rim.support,
        "round": roundness(found.rim),
        "coverage": e.coverage,
        "sealed": 1 - e.leak,
        "clear": contrast / (contrast + e.noise + 0.03),
        "fill": e.fill,
        "aspect": min(1.0, found.aspect / FULL_ASPECT),
        "contrast": min(1.0, contrast / (FULL_CONTRAST * paint_left(e))),
        "colour": math.exp(-found.off_colour),
    }
    prior = ODDS * (1 - VEILED_ODDS * e.veil)
    odds = float(prior * math.prod(share ** POWERS[name] for name, share in shares.items()))
    return odds / (1 + odds)


def weight(found: Candidate) -> float:
    """Which of several discs is the marker: the surer and redder one, and of equals the larger, as in equation 9."""
    most = FULL_REDNESS + found.evidence.veil * (VEILED_REDNESS - FULL_REDNESS)
    redness = min(most, max(0.0, found.evidence.redness / paint_left(found.evidence)))
    return confidence(found) * redness * math.sqrt(found.rim.ellipse.semi_major_px)


def circle_of(ellipse: Ellipse) -> Circle:
    """The circle round a rim: equation 10's meaning for a disc that is seen as an ellipse."""
    return Circle(ellipse.u_px, ellipse.v_px, ellipse.semi_major_px)
