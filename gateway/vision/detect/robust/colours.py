"""The rim of a candidate, measured in the colours in which it is clearest. Pure."""

import math

from gateway.core.detection import Ellipse
from gateway.vision.compiled.sizes import SECTORS
from gateway.vision.detect.robust.refinement import fall, refine
from gateway.vision.detect.robust.rim import Rim
from gateway.vision.pixels import Colours

GOOD, EVEN_PX = 0.95, 0.05  # quality from which on, and `wave_px` up to which nothing better is searched for
BY_CHANCE = 1.3  # of the rms over a sector's edges: so much wave has a rim that is merely noisy
MOST, WELL = 0.6, 0.25  # of the total fall, so much is at the rim and not in creases; of the semi-minor axis
CLEARLY = 0.05  # more quality is required of red against green where all colours lie evenly on their ellipse
SEARCH_PX, SEARCH = (
    3.0,
    0.08,
)  # how far the rim may be from where the evidence saw it; the latter of its semi-minor axis


def roundness(rim: Rim) -> float:
    """1 where all edges lie on the ellipse; a half where they scatter by 1 % of it and half a pixel (small: 3 %)."""
    size_px = rim.ellipse.semi_minor_px
    return 1 / (1 + (rim.rms_px / (min(0.5, 0.03 * size_px) + 0.01 * size_px)) ** 2)


def quality(rim: Rim) -> float:
    """0 to 1: how much of the rim in the picture is an edge, and how well these edges lie on one ellipse."""
    return rim.support * roundness(rim)


def even(rim: Rim) -> bool:
    """Do the edges lie on the ellipse but for their noise, rather than off it for complete sectors?"""
    return rim.wave_px <= max(EVEN_PX, BY_CHANCE * rim.rms_px * math.sqrt(SECTORS / rim.inliers))


def clearest_rim(image: Colours, seed: Ellipse, reach_px: float = 0.0) -> Rim | None:
    """The rim near `seed` by all colours or, where these are at odds, by red against green only, whichever is better.

    All colours together measure best where the disc is of one colour and evenly lit. But a thin white line round the
    disc, as on a road sign, is a second edge a few pixels farther out, and so is a highlight, a bright edge behind, a
    shadow below: these are lighter or darker, but no redder, and vanish in Lab's a*. `reach_px`: how far off the seed's
    rim may be, if that is more than usual.
    """
    search_px = max(reach_px, SEARCH_PX, SEARCH * seed.semi_minor_px)
    rim = refine(image, seed, search_px=search_px)
    if rim is not None and quality(rim) >= GOOD and even(rim):
        return rim
    other = refine(image, seed, search_px=search_px, opponent=True)
    if other is None or other.contrast < MOST * fall(image, other.ellipse, WELL):
        return rim
    if rim is None:
        return other
    # Half hidden, but even: both see the same. Colours mixed by a lens weigh a little more in a* than in truth.
    better_by = CLEARLY if even(rim) else 0.0
    return other if quality(other) > quality(rim) + better_by else rim
