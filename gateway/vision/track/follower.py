"""Follow the marker from frame to frame, with any search: predict, search, label. Pure but for the track it keeps.

Only what the search measured in this very frame is reported as measured. A frame without a measurement is *coasted*
while the track is younger than `vision.coast_s` and its prediction is useful: the prediction is reported beside an
empty `circle`, so that it cannot be mistaken for a measurement. After that the marker is *lost*.

**A jump begins a tentative track.** A circle that the track cannot explain, at another place or of another size, may be
another red object: a lamp, while the marker is covered. It is reported as measured once CONFIRMED_HITS consecutive
frames have shown it and these measurements agree with each other. Until then it is reported as rejected (`jump`), and
the frame is coasted or lost. The marker at its place ends the tentative track, and so does a frame without a circle.
While there is a much larger one, the full frame is searched, so that the window round the prediction cannot hide what
the search prefers; of discs of about the same size the followed one stays. A jerk is not a jump: a circle of about the
same size that overlaps the prediction, or the last measurement, starts a new track, and is a measurement. Without a
track nothing contradicts a circle, and the first one counts. Measurements count only if each is newer than the last.
Red objects that were seen beside the marker before it was covered are not accepted so soon: see `distractors`.

**The ranger's distance may limit the marker's radius** (`expect`). A circle of another radius is not a measurement.
If it is the tracked object, either that is a lamp or the ranger is wrong. An object that never had a possible radius
is dropped: the first circle of the marker counts. One that had is not dropped for another: there is no measurement.
Either way the frame reports it (`wrong_size`), and fusion treats that as a contradiction, unless it is only a known
distractor.
"""

from collections.abc import Sequence
from dataclasses import replace

from gateway.core.detection import Circle, Detection, Rejection, Tracking
from gateway.durations import NS_PER_S
from gateway.vision.detect.geometry import SAME_SIZE, same_circle
from gateway.vision.detect.method import Search, Summing, TimedPicture
from gateway.vision.detect.radii import WITHDRAWN, MarkerRadii
from gateway.vision.pixels import Image
from gateway.vision.track.distractors import HELD_NS, Distractors
from gateway.vision.track.kalman_filter import Prediction, Track, usable

JUMP = "jump"  # the rejection code of a circle of a tentative track
REPORTED = 5  # rejections, at most


class Follower:
    """A Detector. One for each sequence of frames: with several vision processes each follows in its own share."""

    def __init__(self, search: Search, coast_s: float) -> None:
        self._search = search
        self._summing = search if isinstance(search, Summing) else None  # once: it takes long
        self._coast_ns = round(coast_s * NS_PER_S)
        self._track: Track | None = None
        self._tentative: Track | None = None  # after a jump: may be another object than the tracked one
        self._distractors: Distractors | None = None
        self._radii = WITHDRAWN

    def expect(self, radii: MarkerRadii) -> None:
        self._radii = radii

    def recent(self, frames: Sequence[TimedPicture]) -> None:
        if self._summing is not None:
            self._summing.recent(frames)

    def keeps(self, t_ns: int) -> int:
        return 1 if self._summing is None else self._summing.keeps(t_ns)

    def __call__(self, image: Image, t_ns: int = 0) -> Detection:
        track = self._track
        expected = None if track is None else track.at(t_ns)
        tentative = self._tentative
        undecided = (
            tentative is not None
            and not tentative.confirmed
            and (track is None or tentative.r.x > SAME_SIZE * track.r.x)
        )
        radii_px = self._radii.at(t_ns)
        found = self._search(image, t_ns, None if undecided else expected, radii_px)
        if radii_px is not None and self._distractors is not None:
            found = self._of_possible_size(found, self._distractors, t_ns)
            track, expected = (None, None) if self._track is None else (track, expected)
        if found.circle is None or not usable(found.circle):
            self._tentative = None
        elif self._accepted(found.circle, found, t_ns, expected, image):
            seen = self._distractors or Distractors(found.circle, t_ns)
            self._distractors = seen.updated(found.circle, t_ns, found.rejected, fits=radii_px is not None)
            return replace(found, tracking=Tracking.MEASURED, predicted=None)
        else:
            found = _withheld(found)
        if track is not None and expected is not None and self._may_coast(track, expected, t_ns, image):
            return replace(found, circle=None, tracking=Tracking.COASTED, predicted=expected.circle)
        if track is not None and t_ns > track.t_ns and not (self._tentative is not None and self._recent(track, t_ns)):
            self._track = None
        return replace(found, circle=None, tracking=Tracking.LOST, predicted=None)

    def _of_possible_size(self, found: Detection, known: Distractors, t_ns: int) -> Detection:
        """After rejections for their radius; may end the track."""
        seen = found.circle is not None and same_circle(found.circle, known.marker)
        followed = None if seen else known.refused_for_size(found.rejected)
        if followed is None:
            return found if found.wrong_size is None else replace(found, wrong_size=known.wrong_size(found.rejected))
        if known.fitted and 0 <= t_ns - known.t_ns <= HELD_NS:
            self._distractors = replace(known, marker=followed, t_ns=t_ns)
            return replace(found if found.circle is None else _withheld(found), wrong_size=followed)
        self._track = self._tentative = self._distractors = None
        return found

    def _accepted(self, circle: Circle, found: Detection, t_ns: int, expected: Prediction | None, image: Image) -> bool:
        """Whether it is a measurement: of the tracked object, of the first one, or of a confirmed jump."""
        track, tentative = self._track, self._tentative
        if track is not None and (expected is None or self._matches(expected, circle) or t_ns <= track.t_ns):
            self._track, self._tentative = self._updated(track, circle, found.visible, t_ns, expected), None
            return True
        height, width = image.shape[:2]
        held = self._distractors is not None and self._distractors.holds(circle, t_ns, found.rejected, width, height)
        if track is None and tentative is None and not held:
            self._track, self._distractors = Track.started(circle, t_ns), None
            return True
        forecast = None if tentative is None or t_ns < tentative.t_ns else tentative.at(t_ns)
        if tentative is not None and forecast is not None and forecast.admits(circle):
            tentative = tentative.updated(circle, t_ns, found.visible)
        else:
            tentative = Track.started(circle, t_ns)
        if tentative is not None and tentative.confirmed and not held:
            self._track, self._tentative, self._distractors = tentative, None, None
            return True
        self._tentative = tentative
        return False

    def _updated(
        self, track: Track, found: Circle, visible: float | None, t_ns: int, expected: Prediction | None
    ) -> Track | None:
        late = track.t_ns - t_ns > self._coast_ns  # the clock was set back: start anew
        if expected is not None and expected.admits(found) and not late:
            return track.updated(found, t_ns, visible)
        return Track.started(found, t_ns)

    def _recent(self, track: Track, t_ns: int) -> bool:
        return 0 < t_ns - track.t_ns <= self._coast_ns

    def _may_coast(self, track: Track, expected: Prediction, t_ns: int, image: Image) -> bool:
        height, width = image.shape[:2]
        inside = -0.5 <= expected.circle.u_px <= width - 0.5 and -0.5 <= expected.circle.v_px <= height - 0.5
        return self._recent(track, t_ns) and inside and track.confirmed and expected.useful

    def _matches(self, expected: Prediction, found: Circle) -> bool:
        """At the prediction or at the last measurement: frames that arrive in bursts distort the velocity."""
        places = [expected.circle] if self._distractors is None else [expected.circle, self._distractors.marker]
        return expected.admits(found) or any(same_circle(place, found, expected.near_px) for place in places)


def _withheld(found: Detection) -> Detection:
    """Without its circle, which is reported as rejected."""
    assert found.circle is not None
    refused = (Rejection(found.circle, JUMP), *found.rejected[: REPORTED - 1])
    return Detection(None, candidates=found.candidates, rejected=refused, stage_ns=found.stage_ns)
