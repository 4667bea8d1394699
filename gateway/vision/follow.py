"""Follow the marker from frame to frame, round any search: predict, search, label. Pure but for the track it keeps.

What is told as measured is what the search measured in this very frame. A frame in which it finds nothing is *coasted*
as long as the track is young enough (`vision.coast_s`) and says anything at all; the prediction is then told beside an
empty `circle`, so that nobody can mistake it for a measurement. After that the marker is *lost*.

The gate refuses no measurement: the search alone decides what is the marker. A measured circle that can't be the one
followed begins a track of its own.
"""

from dataclasses import replace
from typing import Protocol

from gateway.model import Circle, Detection, Tracking
from gateway.vision.pixels import Image
from gateway.vision.tracking import NS_PER_S, Prediction, Track, usable


class Search(Protocol):
    """Looks for the marker in one picture."""

    def __call__(self, image: Image, t_ns: int, expected: Prediction | None) -> Detection:
        """`expected`: where it should be, None where nobody knows. A hint of where to look first, not what to find.

        It may be a poor one: see `Prediction.useful`.
        """
        ...


class Follower:
    """A Detector. One for each sequence of frames: with several vision processes each follows in its own share."""

    def __init__(self, search: Search, coast_s: float) -> None:
        self._search = search
        self._coast_ns = round(coast_s * NS_PER_S)
        self._track: Track | None = None

    def __call__(self, image: Image, t_ns: int = 0) -> Detection:
        track = self._track
        expected = None if track is None else track.at(t_ns)
        found = self._search(image, t_ns, expected)
        if found.circle is not None and usable(found.circle):
            self._track = self._taught(found.circle, found.visible, t_ns, expected)
            return replace(found, tracking=Tracking.MEASURED, predicted=None)
        if track is not None and expected is not None and self._may_coast(track, expected, t_ns, image):
            return replace(found, circle=None, tracking=Tracking.COASTED, predicted=expected.circle)
        if track is not None and t_ns > track.t_ns:
            self._track = None
        return replace(found, circle=None, tracking=Tracking.LOST, predicted=None)

    def _taught(self, found: Circle, visible: float | None, t_ns: int, expected: Prediction | None) -> Track | None:
        track = self._track
        follows = track is not None and expected is not None and expected.admits(found)
        late = track is not None and track.t_ns - t_ns > self._coast_ns  # the clock was set back: begin with it anew
        if track is not None and follows and not late:
            return track.with_measured(found, t_ns, visible)
        return Track.begun(found, t_ns)

    def _may_coast(self, track: Track, expected: Prediction, t_ns: int, image: Image) -> bool:
        young = 0 < t_ns - track.t_ns <= self._coast_ns
        height, width = image.shape[:2]
        inside = -0.5 <= expected.circle.u_px <= width - 0.5 and -0.5 <= expected.circle.v_px <= height - 0.5
        return young and inside and track.confirmed and expected.useful
