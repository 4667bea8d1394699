"""What is known of the rim of a disc once it has been refined, and which ellipses can be one. Pure."""

from dataclasses import dataclass

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust import constants
from gateway.vision.detect.robust.conic import SupportEllipse
from gateway.vision.pixels import Colours


@dataclass(frozen=True, slots=True)
class Rim:
    """A fitted rim and its evidence."""

    ellipse: Ellipse
    rms_px: float  # of the inlying edges about the ellipse
    support: float  # share of the rays inside the frame that have an inlying edge
    visible: float  # share of the entire rim that is inside the frame and has an inlying edge
    contrast: float  # median colour difference across the rim, grey levels (Euclidean over the channels)
    inliers: int  # rays with an inlying edge
    blur_px: float  # sigma of the edge, sampling included
    wave_px: float  # rms over SECTORS of the rim of their edges' mean distance: what no averaging over rays takes away


def sane(outline: SupportEllipse, image: Colours) -> bool:
    """Large enough, not absurdly so, and in touch with the frame."""
    if (
        not outline.real
        or outline.minor_px < constants.SMALLEST_AXIS_PX
        or outline.major_px > constants.LARGEST_AXIS_PX
    ):
        return False
    height, width = image.shape[:2]
    reach = outline.major_px
    return bool(-reach < outline.u < width + reach and -reach < outline.v < height + reach)
