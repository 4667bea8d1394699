"""What the tracked exact search promises, checked frame by frame against the plain pipeline."""

from dataclasses import replace

from gateway.core.detection import Detection
from gateway.vision.detect.paper import pipeline, stages
from gateway.vision.detect.paper.exact.tracker import ROUND, ExactTracker
from tests.vision_frames import PAPER, Things

FRAME_NS = 33_000_000


def comparable(detection: Detection) -> Detection:
    """What the promise is about."""
    return replace(detection, stage_ns=(), candidates=0)


def searched_in_full(detection: Detection) -> bool:
    return any(stage == "scan" for stage, _ in detection.stage_ns)


def check_promise(tracker: ExactTracker, things: Things, frames: int) -> tuple[int, int]:
    """Frames in which the answer was not the plain one, all of them within the promise; and frames searched in full."""
    wrong = errors = full = 0
    for n in range(frames):
        image = things.frame()
        found = tracker(image, n * FRAME_NS)
        plain = pipeline.detect(image, PAPER)
        full += searched_in_full(found)
        if comparable(found) == comparable(plain):
            wrong = 0
            continue
        wrong, errors = wrong + 1, errors + 1
        assert wrong < ROUND, "a larger component was elsewhere for longer than a round"
        assert not searched_in_full(found)
        assert found.circle is not None
        assert found.area_px2 <= plain.area_px2
        components = pipeline.trace(image, PAPER).contours
        assert found.circle in [stages.enclosing_circle(contour) for contour in components]
    return errors, full
