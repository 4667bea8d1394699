"""Which of the candidates, if any, is the marker. No evidence, no marker: a confident wrong answer is the worst one."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gateway.config.sections.vision import Proposals
from gateway.core.detection import Circle, Ellipse
from gateway.vision.detect.geometry import same_place
from gateway.vision.detect.robust.clearest_rim import even, quality, roundness, search_px
from gateway.vision.detect.robust.constants import FULL_REDNESS
from gateway.vision.detect.robust.evidence import Evidence
from gateway.vision.detect.robust.marker_colour import (
    BRIGHTEST,
    PAPER_RED,
    MarkerColour,
    distance,
    not_brown,
    paint_left,
)
from gateway.vision.detect.robust.redness import BLACK, Light
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.track.distractors import SIZE, WEAKER

MIN_ASPECT = 0.55  # a disc tilted by 57 degrees
MIN_CONTRAST, MIN_SHARE = 0.15, 0.4  # log units in clear air; of the redness inside: less is a red spot on red
MIN_COVERAGE, MAX_LEAK, MIN_FILL, MAX_HOLLOW = 0.6, 0.4, 0.5, 0.75
OPEN, WHOLE = 0.1, 0.93  # as hollow as that it is a letter where red, or what covers it, ends at less of the rim,
HOLLOW, ROUND = 0.5, 0.65  # and as hollow as that where less of the rim lies on the ellipse
MIN_VISIBLE, MIN_SUPPORT = 0.4, 0.45
CRUSTED, CRUSTED_LEAK, CRUSTED_ROUND = 0.4, 0.05, 0.8  # so little coverage is enough, with so little leak, so round,
CRUSTED_WHOLE, CRUSTED_FILL = 0.88, 0.6  # where red or crust ends at so much of the rim, and so much inside is red
PARTLY = 0.9  # of the rim shows, or less: something may hide the rest
HALF, CLEAR_HALF = 0.5, 0.8  # of the rim in the picture: of less, so much must lie on the ellipse
MOST_RAGGED, RAGGED_BLURS = 0.025, 0.6  # rms of the edges about the rim: of the semi-minor axis; of their blur
MAX_BLUR, MIN_STEP = 0.24, 0.5  # sigma of the edge, of the semi-minor axis; fall at the rim, of that from the core

HOPELESS = 0.5  # of a gate's threshold: a candidate with less is not measured at full resolution

FULL_ASPECT, FULL_CONTRAST = 0.85, 0.45  # from which on they have their full weight for a disc
ODDS = 80.0  # for a disc with nothing against it
VEILED_ODDS = 0.8  # so much less behind a full veil, of which only an estimate was subtracted
VEILED_REDNESS = 1.0  # the same behind a full veil: how much more was there is no longer known
MOST_LIGHT, NEARLY_GREY, OWN_RED = 1.25, 1.04, 0.5  # of the airlight; its green by red; of what its subtraction adds
AS_SURE, AS_RED = 0.6, 0.3  # of the surest disc's confidence and of the reddest one's redness: it may be the marker
ABOUT_AS_LARGE, AS_LARGE = 1.1, 1.05  # a radius by another: more weight decides; the two are equal
CLEARLY_MORE = 1.5  # weight by another's
SHAPE = "shape"  # rejection code: not the outline of a disc
BLUR = "blur"  # rejection code: a glow, no rim
COLOUR = "colour"  # rejection code: another one than the marker's
AMBIGUOUS = "ambiguous"  # rejection code: another disc is as large, and nothing tells which is the marker
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


@dataclass(frozen=True, slots=True)
class Candidate:
    """A rim to sub-pixel and its evidence; `evidence` was measured on that rim."""

    rim: Rim
    evidence: Evidence
    veil: float = 0.0  # share of airlight over it, as far as known; the evidence may be that of the picture as it is
    off_colour: float = 0.0  # 0: of the marker's colour; above 1: of another
    airlight: Light = BLACK  # of which `evidence.veil` was subtracted

    @property
    def aspect(self) -> float:
        return self.rim.ellipse.semi_minor_px / self.rim.ellipse.semi_major_px


def candidate(rim: Rim, found: Evidence, limits: Limits, airlight: Light = BLACK, veil: float = 0.0) -> Candidate:
    return Candidate(rim, found, veil, distance(found, limits.marker), airlight)


def _behind_dust(c: Candidate) -> bool:
    """An even wall looks like dust. Before it may stand what is lighter than dust lets anything be, and what only the
    subtraction of the wall's cyan has made red: these have to be red in the picture as it is."""
    (_, green, red), share = c.evidence.colour, c.evidence.veil
    _, green_light, red_light = (share * channel for channel in c.airlight)
    if share == 0:
        return True
    if red + red_light > MOST_LIGHT * c.airlight[2]:
        return math.log((red + red_light) / (green + green_light)) >= MIN_CONTRAST
    return green_light <= NEARLY_GREY * red_light or red - green >= (1 + OWN_RED) * (green_light - red_light)


def _sharp(c: Candidate) -> bool:
    return c.rim.blur_px <= MAX_BLUR * c.rim.ellipse.semi_minor_px and c.evidence.contrast >= MIN_STEP * c.evidence.rise


def _crusted(c: Candidate) -> bool:
    """A crust lies over the rim in patches: what is left is that of a disc, and the crust ends where the disc does."""
    e = c.evidence
    left = e.coverage >= CRUSTED and e.leak <= CRUSTED_LEAK and e.fill >= CRUSTED_FILL
    return left and e.coverage + e.covered >= CRUSTED_WHOLE and roundness(c.rim) >= CRUSTED_ROUND


def _letter(c: Candidate) -> bool:
    """What opens the rim of an S or an 8 reaches to the middle, and an O is not quite round. A disc whose own red is
    clipped may be white there."""
    e = c.evidence
    if e.colour[2] + e.veil * c.airlight[2] >= BRIGHTEST:
        return False
    return (e.hollow > OPEN and e.coverage + e.covered < WHOLE) or (e.hollow > HOLLOW and quality(c.rim) < ROUND)


def ragged(rim: Rim) -> bool:
    """A spot or a hole: its edges are sharper than they are off the ellipse, all along it and not by their noise."""
    off_px = max(MOST_RAGGED * rim.ellipse.semi_minor_px, RAGGED_BLURS * rim.blur_px)
    return rim.rms_px > off_px and not even(rim)


def _of_possible_size(c: Candidate, limits: Limits) -> bool:
    possible = limits.possible_px
    return possible is None or possible[0] <= c.rim.ellipse.semi_major_px <= possible[1]


Gate = Callable[[Candidate, Limits], bool]

GATES: tuple[tuple[str, Gate], ...] = (
    ("radius", lambda c, limits: limits.min_radius_px <= c.rim.ellipse.semi_major_px <= limits.max_radius_px),
    (SHAPE, lambda c, _: c.aspect >= MIN_ASPECT),
    ("contrast", lambda c, _: c.evidence.contrast >= MIN_CONTRAST * paint_left(c.evidence)),
    ("surroundings", lambda c, _: c.evidence.contrast >= MIN_SHARE * c.evidence.redness),
    (COLOUR, lambda c, limits: c.off_colour <= 1 and not_brown(c.evidence, limits.marker)),
    ("coverage", lambda c, _: c.evidence.coverage >= MIN_COVERAGE or _crusted(c)),
    ("leak", lambda c, _: c.evidence.leak <= MAX_LEAK),
    ("visible", lambda c, _: c.rim.visible >= MIN_VISIBLE),
    ("visible", lambda c, _: c.rim.visible >= HALF * c.rim.support or quality(c.rim) >= CLEAR_HALF),
    ("fill", lambda c, _: c.evidence.fill >= MIN_FILL),
    ("hollow", lambda c, _: c.evidence.hollow <= MAX_HOLLOW and not _letter(c)),
    (COLOUR, lambda c, _: _behind_dust(c)),
    ("support", lambda c, _: c.rim.support >= MIN_SUPPORT),
    (BLUR, lambda c, _: _sharp(c)),
    (SHAPE, lambda c, _: not ragged(c.rim)),
    ("confidence", lambda c, limits: confidence(c) >= limits.min_confidence),
    (SIZE, _of_possible_size),
)
"""Code and test, in order: a candidate must pass them all. The codes are explained in `method.REJECTIONS`.

`size` is the last: what it refuses is a red disc, as good as a marker.
"""


def failed_gate(found: Candidate, limits: Limits) -> str | None:
    """The code of the first gate that the candidate does not pass."""
    return next((code for code, passes in GATES if not passes(found, limits)), None)


def hopeless(found: Evidence, limits: Limits) -> str | None:
    """The code of a gate that it misses by so much, before the rim is known, that none near it will pass.

    The rim is the dearest part of a search, and half of those of what is no disc are spared.
    """
    size_px, near_px = found.ellipse.semi_major_px, search_px(found.ellipse)
    missed = {
        "radius": not limits.min_radius_px - near_px <= size_px <= limits.max_radius_px + near_px,
        "contrast": found.contrast < HOPELESS * MIN_CONTRAST * paint_left(found),
        "surroundings": found.contrast < HOPELESS * MIN_SHARE * found.redness,
        "colour": HOPELESS * distance(found, limits.marker) > 1,
    }
    return next((code for code, is_missed in missed.items() if is_missed), None)


def priority(found: Evidence) -> float:
    """Before the rim is known: which candidates are worth its cost."""
    clear = found.contrast / (found.contrast + 2 * found.noise + 0.1)
    aspect = found.ellipse.semi_minor_px / found.ellipse.semi_major_px
    covered = found.covered if partly_hidden(found) else 0.0
    return float((found.coverage + covered) * clear * aspect * found.fill * math.sqrt(found.visible + covered))


def partly_hidden(found: Evidence) -> bool:
    """Before the rim is known: it may be a disc under a crust, whose edge draws the ellipse of redness in."""
    shows = found.coverage + found.leak <= PARTLY and found.leak <= CRUSTED_LEAK
    return shows and found.fill >= MIN_FILL and found.contrast >= MIN_CONTRAST * paint_left(found)


def confidence(found: Candidate) -> float:
    """0 to 1, the probability of a disc: the odds are a product of powers of shares, each 1 where nothing is amiss."""
    e = found.evidence
    contrast = max(e.contrast, 1e-3)
    covered = e.covered if _crusted(found) else 0.0
    shares = {
        "support": min(1.0, found.rim.support / (1 - covered)),
        "round": roundness(found.rim),
        "coverage": e.coverage + covered,
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


def clear_contrast(found: Evidence) -> float:
    """Fall of redness across the rim, log units, as it would be in clear air."""
    return found.contrast / paint_left(found)


def weight(found: Candidate) -> float:
    """How much speaks for it, whatever its size: how sure and how red it is."""
    return confidence(found) * _redness(found)


def _redness(found: Candidate) -> float:
    most = FULL_REDNESS + found.evidence.veil * (VEILED_REDNESS - FULL_REDNESS)
    return min(most, max(0.0, found.evidence.redness / paint_left(found.evidence)))


def chosen(discs: Sequence[Candidate]) -> tuple[Candidate | None, list[tuple[Candidate, str]]]:
    """Which of several discs is the marker, and the code for each of the others.

    The largest, as in equation 9, of those that are about as sure and as red as the best; of some of about its size,
    one for which clearly more speaks: not its reflection on the floor. Where another one elsewhere is as large as that,
    or a larger one is only less sure, as a marker of which a part is lost, nothing tells which is the marker: none is.
    """
    if not discs:
        return None, []
    surest, reddest = max(map(confidence, discs)), max(map(_redness, discs))
    red = [d for d in discs if _redness(d) >= AS_RED * reddest] or list(discs)
    fit = [d for d in red if confidence(d) >= AS_SURE * surest] or red
    large = [disc for disc in fit if ABOUT_AS_LARGE * _size(disc) >= max(map(_size, fit))]
    rivals = [disc for disc in large if CLEARLY_MORE * weight(disc) >= max(map(weight, large))]
    largest = max(rivals, key=_size)
    place = circle_of(largest.rim.ellipse)
    equal = [
        disc
        for disc in rivals
        if AS_LARGE * _size(disc) >= _size(largest) and not same_place(circle_of(disc.rim.ellipse), place)
    ]
    unsure = [d for d in red if d not in fit and _size(d) > ABOUT_AS_LARGE * _size(largest)]
    doubtful = [largest, *equal, *unsure] if equal or unsure else []
    taken = None if doubtful else largest
    others = [disc for disc in discs if disc is not taken]
    return taken, [(disc, AMBIGUOUS if any(disc is one for one in doubtful) else WEAKER) for disc in others]


def _size(disc: Candidate) -> float:
    return disc.rim.ellipse.semi_major_px


def circle_of(ellipse: Ellipse) -> Circle:
    """The circle round a rim: equation 10's meaning for a disc that is seen as an ellipse."""
    return Circle(ellipse.u_px, ellipse.v_px, ellipse.semi_major_px)
