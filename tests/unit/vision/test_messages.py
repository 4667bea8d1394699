"""What the processes of a bay say to each other comes out as it went in."""

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.clock import SystemClock
from gateway.config import Intrinsics, VisionConfig
from gateway.core.detection import Circle, Detection, Ellipse, Rejection, Tracking
from gateway.core.readings import PictureHealth
from gateway.errors import ProtocolError
from gateway.processes.channel import Failed
from gateway.processes.codec import MAX_MESSAGE_BYTES, Codec, record_of, record_packed
from gateway.sim.camera import SimCameraSpec
from gateway.sim.scenario import Scenario
from gateway.vision.detect.radii import MarkerRadii
from gateway.vision.process import vision_process
from gateway.vision.source.contract import SourceSpec
from gateway.vision.source.frame_rules import FrameRules
from gateway.vision.source.specs import CameraSpec, FileSpec, StreamSpec
from gateway.vision.source.v4l2_controls import ControlSetting, OfferedControl
from gateway.vision.transport import messages
from gateway.vision.transport.messages import (
    ControlsReport,
    ControlsRequest,
    DetectorSpec,
    FrameResult,
    Opened,
    Ready,
    SourceLost,
    SourceRecord,
    VisionJob,
)
from gateway.vision.transport.ring_spec import RingSpec

INT = st.integers(-(2**63), 2**63 - 1)
NUMBER = st.floats(allow_nan=False)
CIRCLES = st.builds(Circle, NUMBER, NUMBER, NUMBER)
MAYBE = st.none() | NUMBER
STAGE = st.tuples(st.text(), INT)
DETECTIONS = st.builds(
    Detection,
    circle=st.none() | CIRCLES,
    area_px2=NUMBER,
    circularity=NUMBER,
    fill=NUMBER,
    candidates=INT,
    x_n=MAYBE,
    y_n=MAYBE,
    stage_ns=st.lists(STAGE, max_size=12).map(tuple),
    ellipse=st.none() | st.builds(Ellipse, NUMBER, NUMBER, NUMBER, NUMBER, NUMBER),
    confidence=MAYBE,
    visible=MAYBE,
    rejected=st.lists(st.builds(Rejection, CIRCLES, st.text()), max_size=3).map(tuple),
    tracking=st.sampled_from(Tracking),
    predicted=st.none() | CIRCLES,
    wrong_size=st.none() | CIRCLES,
)
PICTURES = st.builds(PictureHealth, NUMBER, NUMBER, NUMBER, MAYBE, MAYBE, MAYBE, st.integers(0, 63))
FROM_VISION = st.one_of(
    st.builds(FrameResult, INT, INT, DETECTIONS, INT, st.none() | PICTURES),
    st.builds(Opened, st.booleans(), st.booleans()),
    st.builds(SourceLost, st.text(), st.booleans()),
    st.builds(Failed, st.text(), st.booleans()),
    st.just(Ready()),
    st.builds(
        ControlsReport,
        st.lists(st.builds(OfferedControl, st.text(), INT, INT, INT, INT, INT, st.none() | INT), max_size=3).map(tuple),
        INT,
        st.dictionaries(st.text(), INT, max_size=3),
        st.text(),
    ),
)
CLOCK = SystemClock(2.5, 3, 4)
RULES = FrameRules(640, None, (640, 480), 1.5, repeats_age=False, max_megapixels=25.0)
DETECTOR = DetectorSpec(VisionConfig())


def job(spec: SourceSpec, detector: DetectorSpec = DETECTOR) -> VisionJob:
    return VisionJob(3, SourceRecord.of(spec), detector, CLOCK, RingSpec(7, 25.0, 8), RULES, 5, 4, (0, 1), 0.5)


@given(FROM_VISION)
def test_every_message_of_a_vision_process_arrives_as_it_was_sent(message: object) -> None:
    assert messages.FROM_VISION.unpacked(Codec.packed(message)) == message


@given(
    st.builds(MarkerRadii, NUMBER, NUMBER, INT)
    | st.builds(
        ControlsRequest,
        INT,
        st.lists(st.builds(ControlSetting, st.text(), INT, st.booleans()), max_size=3).map(tuple),
        st.dictionaries(st.text(), INT, max_size=3),
    )
)
def test_every_message_to_a_vision_process_arrives_as_it_was_sent(message: object) -> None:
    assert vision_process.CODEC.unpacked(Codec.packed(message)) == message


@pytest.mark.parametrize(
    "spec",
    [
        CameraSpec("/dev/video0", 1280, 720, 29.97),
        StreamSpec("rtsp://anna:secret@camera/live", 9.0, 2.0),
        FileSpec("/films/ü.avi", loop=True),
    ],
)
def test_a_job_arrives_as_it_was_sent_and_names_its_source(spec: SourceSpec) -> None:
    again = vision_process.CODEC.unpacked(Codec.packed(job(spec)))

    assert again == job(spec)
    assert again.source.spec() == spec


def test_a_scenario_of_a_thousand_legs_is_a_job_too() -> None:
    legs = tuple({"name": f"leg {n}", "distance_cm": 10 + n % 400, "lateral_mm": n / 7} for n in range(1000))
    spec = SimCameraSpec(Scenario.model_validate({"legs": legs, "camera": {"fps": 12.5}}), 10**15, "a camera")
    packed = Codec.packed(job(spec))

    assert len(packed) <= MAX_MESSAGE_BYTES
    again = vision_process.CODEC.unpacked(packed)
    assert again.source.spec() == spec
    assert again.source.spec().scenario.model_fields_set == {"legs", "camera"}


def test_a_job_holds_the_settings_as_they_were_given() -> None:
    lens = Intrinsics(fx=600.5, fy=601.0, cx=320.0, cy=240.0, distortion=(0.1, 0.0, 0.0, -1e-3))
    vision = VisionConfig(method="paper", red_low_1=(1, 50, 60), affinity=(0, 1), intrinsics=lens)
    sent = job(CameraSpec(0), DetectorSpec(vision, "some.module:detector"))

    again = vision_process.CODEC.unpacked(Codec.packed(sent))

    assert again == sent
    assert again.detector.vision.model_fields_set == vision.model_fields_set


@pytest.mark.parametrize(
    "kind", ["os:system", "gateway.vision.source.specs:source_spec", "gateway.vision.source.specs:None"]
)
def test_a_source_is_a_record_and_nothing_else(kind: str) -> None:
    with pytest.raises(ProtocolError, match="no record of a source"):
        SourceRecord(kind, b"\x90").spec()


def test_a_field_that_is_added_travels_without_a_second_place() -> None:
    """The records of the model are not listed anywhere: their fields are."""

    @dataclass(frozen=True, slots=True)
    class Tomorrow(Detection):
        veil: float | None = None

    found = Tomorrow(Circle(5.0, 6.0, 7.0), veil=0.25)
    assert record_of(Tomorrow, record_packed(found)) == found
