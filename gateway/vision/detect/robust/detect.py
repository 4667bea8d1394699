"""The robust method: candidates, evidence for each, rim to sub-pixel, decision. Pure: the clock is handed in."""

import math
from dataclasses import replace

import numpy as np

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection, Ellipse, Rejection
from gateway.vision.detect.lens import normalise
from gateway.vision.detect.method import NowNs
from gateway.vision.detect.radii import WITHDRAWN, MarkerRadii
from gateway.vision.detect.robust import proposer
from gateway.vision.detect.robust.decision import Candidate, Limits, circle_of, clear_contrast, confidence
from gateway.vision.detect.robust.marker_colour import marker_of
from gateway.vision.detect.robust.perspective import disc_centre
from gateway.vision.detect.robust.search import Rejected, search_expected, search_frame
from gateway.vision.detect.stage_timer import StageTimer
from gateway.vision.pixels import Pixels, check_picture, grey_levels
from gateway.vision.track.distractors import SIZE

Window = tuple[int, int, int, int]  # x0, y0, x1, y1 px of the full frame, the last two beyond it

SMALLEST_PX = 4.0  # of a radius, whatever the limits say: less is not a rim
SPARSE, AT_ONCE = 16, 0.5  # every so many columns; so much of a row has another colour than the lost ones below it


def detect(
    image: Pixels,
    params: VisionConfig,
    now_ns: NowNs = lambda: 0,
    *,
    window: Window | None = None,
    expected: Circle | None = None,
    radii_px: tuple[float, float] | None = None,
) -> Detection:
    """The red disc in one (H, W, 3) BGR picture of 8 bits or more. `now_ns` gives the times of `stage_ns`; without it,
    0. Of more than 8 bits every stage uses all, and the rim is fitted without the kernel.

    `window` restricts the search to a part of the picture. With a window and an `expected` circle, that place is
    searched first, and if the marker is there nothing else is; without a window a prediction changes nothing.
    Coordinates are always the full frame's. A disc whose radius lies outside `radii_px` is not the marker; where there
    is none, the best of these is `wrong_size`. Raises ValueError for anything but such a picture with at least one
    pixel.
    """
    check_picture(image)
    timer = StageTimer(now_ns)
    limits = limits_of(image, params, radii_px)
    x0, y0, cut = _part(image, window)
    part = grey_levels(limits.marker.seen(cut))
    taken: Candidate | None = None
    seeds = 1
    rejected: list[Rejected] = []
    if window is not None and expected is not None:
        near = replace(expected, u_px=expected.u_px - x0, v_px=expected.v_px - y0)
        taken = search_expected(part, near, limits)
        timer.ended("expected")
    if taken is None:
        taken, seeds, rejected = search_frame(part, limits, timer)
    found = Detection(
        circle=None,
        candidates=seeds,
        rejected=tuple(Rejection(Circle(c.u_px + x0, c.v_px + y0, c.radius_px), why) for _, c, why in rejected),
    )
    if taken is not None:
        found = _filled(found, taken, x0, y0)
    elif radii_px is not None:
        found = replace(found, wrong_size=next((r.circle for r in found.rejected if r.why == SIZE), None))
    if found.circle is not None and params.intrinsics is not None:
        # The image of a tilted disc's centre is not its ellipse's centre; the ellipse stays as seen.
        centre = None if found.ellipse is None else disc_centre(found.ellipse, params.intrinsics)
        circle = found.circle if centre is None else replace(found.circle, u_px=centre[0], v_px=centre[1])
        x_n, y_n = normalise(circle.u_px, circle.v_px, params.intrinsics) or (None, None)
        found = replace(found, circle=circle, x_n=x_n, y_n=y_n)
    timer.ended("normalise")
    return replace(found, stage_ns=timer.stage_ns)


class FullFrameDetector:
    """A Detector without tracking: each frame by itself."""

    def __init__(self, params: VisionConfig, now_ns: NowNs) -> None:
        proposer.prepare(params)
        self._params = params
        self._now_ns = now_ns
        self._radii = WITHDRAWN

    def expect(self, radii: MarkerRadii) -> None:
        self._radii = radii

    def __call__(self, image: Pixels, t_ns: int = 0) -> Detection:
        return detect(image, self._params, self._now_ns, radii_px=self._radii.at(t_ns))


def limits_of(image: Pixels, params: VisionConfig, radii_px: tuple[float, float] | None) -> Limits:
    """The settings for one picture; `radii_px` as for `detect`."""
    diagonal_px = math.hypot(*image.shape[:2])
    return Limits(
        min_radius_px=max(SMALLEST_PX, params.min_radius_share * diagonal_px),
        max_radius_px=params.max_radius_share * diagonal_px,
        min_confidence=params.min_confidence,
        possible_px=radii_px,
        proposals=params.proposals,
        marker=marker_of(params.marker_colour),
    )


def _part(image: Pixels, window: Window | None) -> tuple[int, int, Pixels]:
    """The window as far as it lies in the picture, at least one pixel of it, and its corner."""
    image = image[: _received(image)]
    if window is None:
        return 0, 0, image
    height, width = image.shape[:2]
    x0, y0 = min(max(0, window[0]), width - 1), min(max(0, window[1]), height - 1)
    return x0, y0, image[y0 : max(y0 + 1, window[3]), x0 : max(x0 + 1, window[2])]


def _received(image: Pixels) -> int:
    """Rows. A decoder fills what was lost below them with one colour: that is the picture's edge, not a thing in it."""
    fill = image[-1, 0]
    if (image[-1, ::SPARSE] != fill).any():
        return len(image)
    other = np.logical_or.reduce([image[:, ::SPARSE, channel] != fill[channel] for channel in range(3)])
    last = int(np.flatnonzero(other.any(axis=1)).max(initial=-1))  # an even ground begins here and there, in many rows
    return last + 1 if last >= 0 and other[last].mean() >= AT_ONCE else len(image)


def _filled(found: Detection, taken: Candidate, x0: int, y0: int) -> Detection:
    e = taken.rim.ellipse
    ellipse = replace(e, u_px=e.u_px + x0, v_px=e.v_px + y0)
    return replace(
        found,
        circle=circle_of(ellipse),
        ellipse=ellipse,
        area_px2=math.pi * e.semi_major_px * e.semi_minor_px,
        circularity=_circularity(e),
        fill=e.semi_minor_px / e.semi_major_px,
        confidence=confidence(taken),
        visible=taken.rim.visible,
        contrast=clear_contrast(taken.evidence),
        veil=taken.veil,
    )


def _circularity(e: Ellipse) -> float:
    """4 pi area / perimeter^2 of the ellipse (Ramanujan's perimeter, good to 1e-5 here)."""
    a, b = e.semi_major_px, e.semi_minor_px
    h = ((a - b) / (a + b)) ** 2
    perimeter = math.pi * (a + b) * (1 + 3 * h / (10 + math.sqrt(4 - 3 * h)))
    return 4 * math.pi * math.pi * a * b / perimeter**2
