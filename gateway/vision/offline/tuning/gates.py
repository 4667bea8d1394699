"""Size and shape gates of the paper's method from what it found with the proposed thresholds. Pure."""

import math
from collections.abc import Sequence

from gateway.vision.offline.evaluation.scoring import Outcome

AREA_SHARE = 0.3  # of the smallest marker: half hidden, it still passes
SHAPE_SHARE = 0.9  # of the least round marker that was found
HIGHEST = 0.8  # a perfect disc has a circularity of 0.90; dirt and tilt take from it
FEWEST = 3  # markers found; fewer say nothing of how round others will be


def propose(found: Sequence[Outcome]) -> dict[str, float]:
    """`min_area_px2`, and with enough markers found `min_circularity` and `min_fill`: what they leave room for."""
    radii = [o.label.major_px for o in found if o.label.major_px is not None]
    keys: dict[str, float] = {}
    if radii:
        keys["min_area_px2"] = _two_digits(AREA_SHARE * math.pi * min(radii) ** 2)
    on = [o.detection for o in found if o.on_target]
    if len(on) >= FEWEST:
        keys["min_circularity"] = _gate(min(detection.circularity for detection in on))
        keys["min_fill"] = _gate(min(detection.fill for detection in on))
    return keys


def _gate(least: float) -> float:
    return math.floor(20 * min(HIGHEST, SHAPE_SHARE * least)) / 20


def _two_digits(value: float) -> float:
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(round(value / power) * power)
