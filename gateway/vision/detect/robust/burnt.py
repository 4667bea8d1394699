"""Where a picture is over-exposed a rim can't be seen: white inside and outside. As beyond the frame's edge. Pure."""

from dataclasses import replace

import numpy as np

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.constants import WHITE
from gateway.vision.detect.robust.evidence import Evidence
from gateway.vision.detect.robust.marker_colour import BRIGHTEST
from gateway.vision.detect.robust.own_colour import scaled
from gateway.vision.detect.robust.redness import Light
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.pixels import Colours

INSIDE, OUTSIDE = 0.92, 1.08  # of the radius
LEAST = 0.6  # of the rim in the picture: of less it may be half a disc, before a white wall


def of_the_legible(image: Colours, rim: Rim, found: Evidence, airlight: Light) -> tuple[Rim, Evidence]:
    """The same, its shares being of the part of the rim that is not burnt out, if the disc's own red is clipped."""
    if found.colour[2] + found.veil * airlight[2] < BRIGHTEST:
        return rim, found
    share = _legible(image, rim.ellipse)
    if share < LEAST:
        return rim, found
    coverage, leak, support = (min(1.0, part / share) for part in (found.coverage, found.leak, rim.support))
    covered = min(1 - coverage, found.covered / share)
    return replace(rim, support=support), replace(found, coverage=coverage, leak=leak, covered=covered)


def _legible(image: Colours, rim: Ellipse) -> float:
    """Of the rim in the picture."""
    height, width = image.shape[:2]
    inner, outer = (np.stack(scaled(rim, share)) for share in (INSIDE, OUTSIDE))
    beyond = np.array([[width - 1], [height - 1]])
    seen = ((outer >= 0) & (outer <= beyond)).all(axis=0)
    white = np.ones(seen.size, np.bool_)
    for u, v in (np.clip(np.rint(at), 0, beyond).astype(np.intp) for at in (inner, outer)):
        white &= image[v, u].min(axis=1) >= WHITE
    return 1.0 - np.count_nonzero(white & seen) / max(1, int(np.count_nonzero(seen)))
