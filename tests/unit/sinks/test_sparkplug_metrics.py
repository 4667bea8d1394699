"""The device metrics of a sensor without a value."""

from dataclasses import replace

import pytest

from gateway.core.detection import Tracking
from gateway.core.fusion import initial
from gateway.core.readings import Quality, VisionReading
from gateway.core.state import Moved, Reason
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.sinks.sparkplug.metrics import VISIT, quality_code, readings, visit_readings
from gateway.sinks.sparkplug.wire import QualityCode

FRESH_FRAME = {Quality.GOOD, Quality.NO_TARGET, Quality.COASTED}


@pytest.mark.parametrize("quality", Quality)
def test_tracking_is_null_without_a_fresh_frame(quality: Quality) -> None:
    state = replace(initial("bay1", 5), vision=VisionReading(5, quality, tracking=Tracking.MEASURED))
    found = readings(state)["Marker/Tracking"]
    assert found == (("MEASURED", QualityCode.GOOD) if quality in FRESH_FRAME else (None, quality_code(quality)))


@pytest.mark.parametrize("quality", Quality)
def test_only_a_good_camera_has_a_marker(quality: Quality) -> None:
    state = replace(initial("bay1", 5), vision=VisionReading(5, quality, tracking=Tracking.COASTED))
    for name in ("Marker/U", "Marker/V", "Marker/Radius", "Marker/Confidence", "Distance Vision"):
        value, code = readings(state)[name]
        assert value is None
        assert code is not QualityCode.GOOD


def test_of_a_visit_what_is_not_known_is_null() -> None:
    visit = VisitSummary(
        1_800_000_000_000, 60.04, VisitEnd.NEXT_TRUCK, to_position_s=12.34, in_place_s=30.0, times_in_place=1,
        corrections=2, distance_mm=301.6, moved=Moved.MARKER, interruptions=1,
        faults=((Reason.CAMERA_DOWN, 2, 3.0), (Reason.RANGE_STALE, 1, 0.5)),
    )  # fmt: skip
    good = {name: value for name, (value, code) in visit_readings(visit).items() if code is QualityCode.GOOD}
    assert good == {
        "Visit/Last/Begun": 1_800_000_000_000, "Visit/Last/Length": 60.0, "Visit/Last/End": "next_truck",
        "Visit/Last/To Position": 12.3, "Visit/Last/In Place": 30.0, "Visit/Last/Times In Place": 1,
        "Visit/Last/Corrections": 2, "Visit/Last/Distance": 302.0, "Visit/Last/Moved": "MARKER",
        "Visit/Last/Faults": 3, "Visit/Last/Interrupted": True,
    }  # fmt: skip
    before = visit_readings(None)
    assert set(before.values()) == {(None, QualityCode.BAD)}
    assert set(before) == set(VISIT)
    assert set(before) <= set(readings(initial("bay1", 5)))
    odd = visit_readings(replace(visit, begun_ms=-5, distance_mm=float("nan")))
    assert (odd["Visit/Last/Begun"][0], odd["Visit/Last/Distance"]) == (0, (None, QualityCode.BAD))
