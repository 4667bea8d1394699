"""What a detector finds in one picture. Plain frozen records, units in the names.

Pixel centres lie at integers: the centre of the top left pixel is (0, 0).
"""

import math
from dataclasses import dataclass

from gateway.explained import ExplainedInt


class Tracking(ExplainedInt):
    """How the position of this frame was obtained. The numbers are on the wire: never renumber, only add."""

    OFF = 0, "every frame is searched completely, by itself"
    MEASURED = 1, "the marker was found in this frame and fits its track, or begins one"
    COASTED = 2, "the marker was not found in this frame; its place is predicted from its motion"
    LOST = 3, "no marker is followed: none was found yet, or not for so long that its track was given up"


@dataclass(frozen=True, slots=True)
class Circle:
    """Minimum enclosing circle of the marker (equation 10): centre (u_c, v_c) and radius R, px.

    Of a tilted disc, seen as an ellipse, R is the semi-major axis: what a circle round it has.
    """

    u_px: float
    v_px: float
    radius_px: float


@dataclass(frozen=True, slots=True)
class Ellipse:
    """The rim of a disc as the camera sees it. `angle_rad`: from +u towards +v to the major axis, in [0, pi)."""

    u_px: float
    v_px: float
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float

    @property
    def tilt_deg(self) -> float:
        """Between the disc's normal and the line of sight, 0 to 90, as far as the perspective is weak."""
        if not (self.semi_major_px > 0 and math.isfinite(self.semi_minor_px)):
            return math.nan
        return math.degrees(math.acos(min(1.0, max(0.0, self.semi_minor_px / self.semi_major_px))))


@dataclass(frozen=True, slots=True)
class Rejection:
    """A candidate that was measured and rejected, and why: a short code that the method's table explains."""

    circle: Circle
    why: str


@dataclass(frozen=True, slots=True)
class Detection:
    """The vision pipeline's result for one image. `circle` is None where no marker was found."""

    circle: Circle | None
    area_px2: float = 0.0  # equation 8, of the chosen contour
    circularity: float = 0.0  # 4 pi area / perimeter^2, 1 for a disc
    fill: float = 0.0  # area / area of the enclosing circle, 1 for a disc
    candidates: int = 0  # contours larger than S_min
    x_n: float | None = None  # equation 11, only where intrinsics are known
    y_n: float | None = None
    stage_ns: tuple[tuple[str, int], ...] = ()  # time per stage, in pipeline order
    ellipse: Ellipse | None = None  # the rim, where the method fits one; `circle` is the one round it
    confidence: float | None = None  # 0 to 1; None: the method doesn't report it
    visible: float | None = None  # share of the rim that was seen; None: the method doesn't report it
    contrast: float | None = None  # fall of redness across the rim as in clear air, log units; None: not reported
    veil: float | None = None  # share of airlight over the marker, 0 in clear air; None: no marker, or not reported
    frames: int = 1  # that were summed for it; it is as old as the oldest of them
    rejected: tuple[Rejection, ...] = ()  # the best few of the candidates not taken
    tracking: Tracking = Tracking.OFF
    predicted: Circle | None = None  # where the marker should be; only while it coasts
    wrong_size: Circle | None = None  # no circle, but one that the ranger's distance makes too large or too small
