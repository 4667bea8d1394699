"""The table of values: what every output relies on."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest

from gateway.core.detection import Circle, Ellipse, Tracking
from gateway.core.readings import FRESH_FRAME, PictureHealth, Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.values import bay_values, visit_values
from gateway.values.bay_values import BAY_VALUES

SEEN = VisionReading(
    5, Quality.GOOD, Circle(1.0, 2.0, 3.0), 7, 0.1, 0.2, ellipse=Ellipse(1.0, 2.0, 3.0, 1.5, 0.0), confidence=0.9,
    visible=0.8, tracking=Tracking.MEASURED, predicted=Circle(4.0, 5.0, 6.0),
    picture=PictureHealth(0.5, 0.1, 0.4, 0.6, 0.2, 3.0, veil_proven=0.3),
)  # fmt: skip
STATE = StateVector("bay1", 5, vision=SEEN, range=RangeReading(5, Quality.GOOD, 296.5), z_vision_mm=290.0,
                    reason=Reason.TARGET_REACHED)  # fmt: skip
MARKER = {"u_px": 1.0, "v_px": 2.0, "radius_px": 3.0, "z_vision_mm": 290.0, "x_n": 0.1, "y_n": 0.2, "confidence": 0.9,
          "visible": 0.8, "frames_summed": 1, "semi_minor_px": 1.5}  # fmt: skip
FRAME = {"tracking": Tracking.MEASURED, "picture.sharpness": 0.6, "picture.shift_px": 3.0, "picture.veil_proven": 0.3}


def read(state: StateVector, names: Iterable[str]) -> dict[str, object]:
    return {name: BAY_VALUES[name].of(state) for name in names}


@pytest.mark.parametrize("quality", Quality)
def test_without_its_quality_a_value_is_not_there_whatever_the_record_holds(quality: Quality) -> None:
    state = replace(STATE, vision=replace(SEEN, quality=quality), range=replace(STATE.range, quality=quality))
    assert read(state, MARKER) == (MARKER if quality is Quality.GOOD else dict.fromkeys(MARKER))
    assert read(state, FRAME) == (FRAME if quality in FRESH_FRAME else dict.fromkeys(FRAME))
    assert BAY_VALUES["distance_mm"].of(state) == (296.5 if quality is Quality.GOOD else None)
    assert BAY_VALUES["predicted.u_px"].of(state) == (4.0 if quality is Quality.COASTED else None)
    assert BAY_VALUES["vision.quality.code"].of(state) == quality
    assert read(replace(STATE, vision=replace(SEEN, circle=None)), MARKER) == dict.fromkeys(MARKER)


@pytest.mark.parametrize("wrong", [float("nan"), float("inf")])
def test_what_is_no_number_is_not_known(wrong: float) -> None:
    state = replace(STATE, range=replace(STATE.range, distance_mm=wrong), vision=replace(SEEN, confidence=wrong))
    assert read(state, ("distance_mm", "confidence")) == {"distance_mm": None, "confidence": None}


def test_every_value_can_be_read_under_one_name() -> None:
    tables: tuple[tuple[Any, Any], ...] = ((bay_values.ROWS, STATE), (visit_values.ROWS, VisitSummary(5, 1.0)))
    for rows, source in tables:
        assert len({row.name for row in rows}) == len(rows)
        for row in rows:
            found = row.of(source)
            assert found is None or isinstance(found, row.kind), row.name
            assert found is not None or row.null, f"{row.name} does not say when it has no value"


def test_names_end_with_the_unit() -> None:
    units = {"radius_px": "px", "guidance.closing_mm_s": "mm/s", "rates.vision_hz": "Hz", "scale.px_mm": "px mm",
             "exposure.gain_db": "dB", "picture.veil": "", "plc.age_ms": "ms", "tilt_deg": "deg"}  # fmt: skip
    assert {name: BAY_VALUES[name].unit for name in units} == units


def test_an_enumeration_is_also_shown_by_name_code_and_words() -> None:
    names = {"reason.name": "TARGET_REACHED", "reason.code": 1,
             "reason.text": "D = 1: the marker is large enough and the distance short enough"}  # fmt: skip
    assert read(STATE, names) == names
