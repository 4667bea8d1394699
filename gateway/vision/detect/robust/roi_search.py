"""The robust search that starts at the prediction, and searches the full frame when that is not enough.

Every measurement comes from the same evidence, the same gates and the same refinement at full resolution, whether
the search was in a window or in the full frame; the window only leaves out candidates elsewhere. To prevent a track
from staying on a wrong object, the full frame is searched, too

- at once, in the same frame, when the window has no marker, or none that the track's gate admits;
- when a new red region appears elsewhere: a subsampled frame is checked every CHECK frames, CHECK_NS after the last
  check at the latest, and after a long gap;
- every FULL frames, if anything else in it is nearly as red as the marker; every FAINT frames, if anything is red at
  all.

Where window and full frame disagree, the result of the full frame is used, as it would be without tracking. There are
two exceptions: a circle that this search did not report at all may replace it, with more evidence; and of several discs
of about the same size the one that is followed stays.
"""

import math
from dataclasses import replace

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.vision.detect.geometry import SAME_SIZE, same_place
from gateway.vision.detect.method import NowNs
from gateway.vision.detect.robust import proposer
from gateway.vision.detect.robust.detect import Window, detect
from gateway.vision.detect.robust.marker_colour import marker_of
from gateway.vision.detect.robust.red_change import RedRegions, red_regions
from gateway.vision.detect.stage_timer import StageTimer, total_ns
from gateway.vision.pixels import Pixels
from gateway.vision.track.distractors import RED_DISC
from gateway.vision.track.kalman_filter import Prediction

CHECK, FULL, FAINT = 8, 64, 128  # frames; each a multiple of the one before
CHECK_NS = 300_000_000  # a slow camera's truck is not slower
ROUND_RIM = 1.35  # the evidence includes the surroundings: so many radii


class RoiSearch:
    """A `Search` that counts its frames."""

    def __init__(self, params: VisionConfig, now_ns: NowNs) -> None:
        proposer.prepare(params)
        self._params = params
        self._now_ns = now_ns
        self._near = 0  # consecutive frames that were searched in a window only
        self._regions: RedRegions | None = None  # other red regions, when last checked
        self._checked_ns = self._t_ns = 0  # when that was, and the frame at hand
        self._radii_px: tuple[float, float] | None = None  # possible in the frame at hand
        self._marker = marker_of(params.marker_colour)

    def __call__(
        self,
        image: Pixels,
        t_ns: int,
        expected: Prediction | None,
        radii_px: tuple[float, float] | None = None,
    ) -> Detection:
        self._t_ns, self._radii_px = t_ns, radii_px
        if expected is None or not _possible(expected.circle, radii_px):
            return self._recorded(image, self._full_search(image))
        window = window_round(expected, image.shape[1], image.shape[0])
        found = detect(image, self._params, self._now_ns, window=window, expected=expected.circle, radii_px=radii_px)
        if found.circle is None or not expected.admits(found.circle):
            return self._with_full_search(image, found)
        self._near += 1
        if self._near % CHECK == 0 or abs(t_ns - self._checked_ns) >= CHECK_NS or not expected.useful:
            timer = StageTimer(self._now_ns)
            due = self._full_search_due(image, found.circle)
            timer.ended("rivals")
            found = replace(found, stage_ns=found.stage_ns + timer.stage_ns)
            if due:
                return self._with_full_search(image, found, followed=True)
        return found

    def _full_search(self, image: Pixels) -> Detection:
        self._near = 0
        return detect(image, self._params, self._now_ns, radii_px=self._radii_px)

    def _with_full_search(self, image: Pixels, before: Detection, *, followed: bool = False) -> Detection:
        """`before`: the window's result, the marker that is followed or not; its time is reported, too."""
        full = self._full_search(image)
        better = self._recorded(image, _better(full, before, followed=followed))
        return replace(better, stage_ns=(("window", total_ns(before.stage_ns)), *full.stage_ns))

    def _recorded(self, image: Pixels, found: Detection) -> Detection:
        """The full frame has been searched: its red regions are known."""
        self._regions = None if found.circle is None else red_regions(self._marker.seen(image), found.circle)
        self._checked_ns = self._t_ns
        return found

    def _full_search_due(self, image: Pixels, followed: Circle) -> bool:
        """Whether a red region is new, or the known ones were not searched for too long."""
        before, self._regions = self._regions, red_regions(self._marker.seen(image), followed)
        self._checked_ns = self._t_ns
        due = (self._near % FULL == 0 and len(self._regions.boxes) > 0) or (
            self._near % FAINT == 0 and self._regions.faint
        )
        return before is None or due or self._regions.new_since(before)


def _possible(circle: Circle, radii_px: tuple[float, float] | None) -> bool:
    return radii_px is None or radii_px[0] <= circle.radius_px <= radii_px[1]


def _better(full: Detection, held: Detection, *, followed: bool) -> Detection:
    """The full search may have missed the circle that was found in the window; that one passed the same gates. It may
    also prefer another disc: the one that is followed yields to a much larger one only."""
    if held.circle is None:
        return full
    if _reported(full, held.circle):
        rival = full.circle
        stays = (
            followed
            and rival is not None
            and not same_place(rival, held.circle)
            and _about_as_large(rival, held.circle)
        )
        return held if stays else full
    return full if _rank(full) >= _rank(held) else held


def _about_as_large(rival: Circle, held: Circle) -> bool:
    return rival.radius_px <= SAME_SIZE * held.radius_px


def _reported(full: Detection, held: Circle) -> bool:
    """Whether the full search selected it, or rejected a good red disc there."""
    others = (rejected.circle for rejected in full.rejected if rejected.why in RED_DISC)
    chosen = () if full.circle is None else (full.circle,)
    return any(same_place(circle, held) for circle in (*chosen, *others))


def _rank(found: Detection) -> float:
    """About the rank among the candidates of one frame; a detection does not contain the redness."""
    return 0.0 if found.circle is None else (found.confidence or 0.0) * math.sqrt(found.circle.radius_px)


def window_round(expected: Prediction, width: int, height: int) -> Window:
    """Round the prediction, as far as the gate reaches, but no farther than what is near: beyond, all must be searched.

    With the surroundings of an admitted circle, cut to the picture; at least one pixel.
    """
    largest_px = min(expected.largest_px, expected.circle.radius_px + expected.near_px)
    half = min(expected.reach_px, expected.near_px) + ROUND_RIM * largest_px + 2
    u, v = expected.circle.u_px, expected.circle.v_px
    x0, y0 = (min(max(0, math.floor(at - half)), size - 1) for at, size in ((u, width), (v, height)))
    x1, y1 = (max(min(math.ceil(at + half) + 1, size), low + 1) for at, size, low in ((u, width, x0), (v, height, y0)))
    return x0, y0, x1, y1
