"""The device metrics of a sensor without a value."""

from dataclasses import replace

import pytest

from gateway.core.detection import Tracking
from gateway.core.fusion import initial
from gateway.core.readings import Quality, VisionReading
from gateway.sinks.sparkplug.metrics import quality_code, readings
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
