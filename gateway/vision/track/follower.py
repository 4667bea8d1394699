"""Follow the marker from frame to frame, round any search: predict, search, label. Pure but for the track it keeps.

What is told as measured is what the search measured in this very frame. A frame in which it finds nothing is *coasted*
as long as the track is young enough (`vision.coast_s`) and says anything at all; the prediction is then told beside an
empty `circle`, so that nobody can mistake it for a measurement. After that the marker is *lost*.

**A jump is on trial.** A circle that the track cannot explain, at another place or of another size, may be another red
thing: a lamp, when the marker is covered. It is told as measured when CONFIRMED_HITS frames running have shown it and
its sightings fit each other; until then as refused (`jump`), and the frame is coasted or lost. The marker at its place
ends the trial, and so does a frame that shows nothing. During a trial the whole frame is searched, so that the window
round the prediction can't hide what the search prefers. A jerk is no jump: what is nearly as large and overlaps the
prediction, or the marker as it was measured last, begins a new track, but is a measurement. Where nothing is followed
there is nothing to contradict, and the first sight counts. Sightings count only if each is newer than the last. What
stood beside the marker before it was covered is not believed so soon: see `bystanders`.

**The ranger's distance may tell how large the marker can be** (`expect`). What is larger or smaller is not measured.
If it is the very thing that was followed, either that is a lamp or the ranger is wrong. A thing that never had a
possible radius is forgotten: the first sight of the marker counts. One that had is not given up for another: there is
no measurement. Either way the frame says what was seen (`wrong_size`), and fusion calls it a contradiction; not,
though, if it is only a known bystander.
"""

from dataclasses import replace

from gateway.core.model import Circle, Detection, Rejection, Tracking
from gateway.vision.detect.geometry import same_circle
from gateway.vision.detect.method import Search
from gateway.vision.detect.radii import WITHDRAWN, MarkerRadii
from gateway.vision.pixels import Image
from gateway.vision.track.distractors import HELD_NS, Bystanders
from gateway.vision.track.kalman_filter import NS_PER_S, Prediction, Track, usable

JUMP = "jump"  # the code of a circle on trial among those refused
TOLD = 5  # of those refused


class Follower:
    """A Detector. One for each sequence of frames: with several vision processes each follows in its own share."""

    def __init__(self, search: Search, coast_s: float) -> None:
        self._search = search
        self._coast_ns = round(coast_s * NS_PER_S)
        self._track: Track | None = None
        self._trial: Track | None = None  # what may be another thing than the one followed
        self._others: Bystanders | None = None
        self._radii = WITHDRAWN

    def expect(self, radii: MarkerRadii) -> None:
        self._radii = radii

    def __call__(self, image: Image, t_ns: int = 0) -> Detection:
        track = self._track
        expected = None if track is None else track.at(t_ns)
        undecided = self._trial is not None and not self._trial.confirmed
        radii_px = self._radii.at(t_ns)
        found = self._search(image, t_ns, None if undecided else expected, radii_px)
        if radii_px is not None and self._others is not None:
            found = self._of_possible_size(found, self._others, t_ns)
            track, expected = (None, None) if self._track is None else (track, expected)
        if found.circle is None or not usable(found.circle):
            self._trial = None
        elif self._believed(found.circle, found, t_ns, expected, image):
            seen = self._others or Bystanders(found.circle, t_ns)
            self._others = seen.with_measured(found.circle, t_ns, found.rejected, fits=radii_px is not None)
            return replace(found, tracking=Tracking.MEASURED, predicted=None)
        else:
            found = _on_trial(found)
        if track is not None and expected is not None and self._may_coast(track, expected, t_ns, image):
            return replace(found, circle=None, tracking=Tracking.COASTED, predicted=expected.circle)
        if track is not None and t_ns > track.t_ns and not (self._trial is not None and self._young(track, t_ns)):
            self._track = None
        return replace(found, circle=None, tracking=Tracking.LOST, predicted=None)

    def _of_possible_size(self, found: Detection, known: Bystanders, t_ns: int) -> Detection:
        """What follows from the radii that were refused; it may end the track."""
        seen = found.circle is not None and same_circle(found.circle, known.marker)
        followed = None if seen else known.refused_for_size(found.rejected)
        if followed is None:
            return found if found.wrong_size is None else replace(found, wrong_size=known.wrong_size(found.rejected))
        if known.fitted and 0 <= t_ns - known.t_ns <= HELD_NS:
            self._others = replace(known, marker=followed, t_ns=t_ns)
            return replace(found if found.circle is None else _on_trial(found), wrong_size=followed)
        self._track = self._trial = self._others = None
        return found

    def _believed(self, circle: Circle, found: Detection, t_ns: int, expected: Prediction | None, image: Image) -> bool:
        """Is it a measurement: of what is followed, of something new that nothing contradicts, or of one confirmed?"""
        track, trial = self._track, self._trial
        if track is not None and (expected is None or self._explained(expected, circle) or t_ns <= track.t_ns):
            self._track, self._trial = self._taught(track, circle, found.visible, t_ns, expected), None
            return True
        height, width = image.shape[:2]
        held = self._others is not None and self._others.holds(circle, t_ns, found.rejected, width, height)
        if track is None and trial is None and not held:
            self._track, self._others = Track.begun(circle, t_ns), None
            return True
        forecast = None if trial is None or t_ns < trial.t_ns else trial.at(t_ns)
        if trial is not None and forecast is not None and forecast.admits(circle):
            trial = trial.with_measured(circle, t_ns, found.visible)
        else:
            trial = Track.begun(circle, t_ns)
        if trial is not None and trial.confirmed and not held:
            self._track, self._trial, self._others = trial, None, None
            return True
        self._trial = trial
        return False

    def _taught(
        self, track: Track, found: Circle, visible: float | None, t_ns: int, expected: Prediction | None
    ) -> Track | None:
        late = track.t_ns - t_ns > self._coast_ns  # the clock was set back: begin with it anew
        if expected is not None and expected.admits(found) and not late:
            return track.with_measured(found, t_ns, visible)
        return Track.begun(found, t_ns)

    def _young(self, track: Track, t_ns: int) -> bool:
        return 0 < t_ns - track.t_ns <= self._coast_ns

    def _may_coast(self, track: Track, expected: Prediction, t_ns: int, image: Image) -> bool:
        height, width = image.shape[:2]
        inside = -0.5 <= expected.circle.u_px <= width - 0.5 and -0.5 <= expected.circle.v_px <= height - 0.5
        return self._young(track, t_ns) and inside and track.confirmed and expected.useful

    def _explained(self, expected: Prediction, found: Circle) -> bool:
        """Where the track leads, or where the marker was seen last: frames that come in bursts mislead the motion."""
        places = [expected.circle] if self._others is None else [expected.circle, self._others.marker]
        return expected.admits(found) or any(same_circle(place, found, expected.near_px) for place in places)


def _on_trial(found: Detection) -> Detection:
    """Without its circle, which is told among those refused."""
    assert found.circle is not None
    refused = (Rejection(found.circle, JUMP), *found.rejected[: TOLD - 1])
    return Detection(None, candidates=found.candidates, rejected=refused, stage_ns=found.stage_ns)
