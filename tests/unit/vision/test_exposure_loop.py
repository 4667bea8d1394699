"""The exposure loop with rendered frames: detector, controls and a camera with a real sensor, in virtual time."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest

from gateway.config import CameraConfig, VisionConfig
from gateway.core.detection import Detection
from gateway.core.readings import CameraExposure, ExposureState
from gateway.errors import ConfigError, LinkError
from gateway.sim.camera import SimCameraSpec
from gateway.sim.scenario import parse
from gateway.vision.detect.registry import detector
from gateway.vision.exposure.settings import Exposure, ExposureLimits, ExposureRules
from gateway.vision.process.exposure_loop import ExposureLoop
from gateway.vision.source.contract import ExposureControls, Frame, Source
from gateway.vision.source.specs import check_exposure, exposure_rules
from tests.long import mostly_long
from tests.virtual_time import BlockingClock

pytestmark = pytest.mark.one_interpreter

S, MS = 1_000_000_000, 1_000_000
FRAME_NS = S // 30
RULES = ExposureRules(8000.0)
SMALL = {"width_px": 320, "height_px": 240, "focal_px": 300, "fps": 30}
STANDING: dict[str, Any] = {"start": {"distance_cm": 60}, "light": {"drift": 0.0}, "clutter": {"things": 0}}
HEAD_LAMP = [{"at_s": 0, "level": 0.15}, {"at_s": 2, "over_s": 1, "level": 6}]
"""Dusk, and a lamp on the marker forty times as bright, within a second."""


@dataclass
class Moment:
    t_s: float
    found: Detection
    clipped: float  # share of the true marker's pixels at white in red
    level: float  # their mean in red
    exposure: CameraExposure


@dataclass
class Run:
    moments: list[Moment] = field(default_factory=list)

    def after(self, t_s: float) -> list[Moment]:
        return [moment for moment in self.moments if moment.t_s >= t_s]

    def found(self, t_s: float = 0.0) -> float:
        some = self.after(t_s)
        return sum(moment.found.circle is not None for moment in some) / len(some)

    def longest_clipped_s(self) -> float:
        longest = run = 0
        for moment in self.moments:
            run = run + 1 if moment.clipped > 0.1 else 0
            longest = max(longest, run)
        return longest * FRAME_NS / S

    def changes(self, t_s: float = 0.0) -> list[float]:
        """Factors between the exposures of frames that differ."""
        amounts = [amount(moment.exposure) for moment in self.after(t_s)]
        return [b / a for a, b in pairwise(amounts) if a != b]

    def turns(self) -> int:
        return sum((a > 1) != (b > 1) for a, b in pairwise(self.changes()))


def amount(exposure: CameraExposure) -> float:
    return Exposure(1000 * (exposure.time_ms or 0), exposure.gain_db or 0).amount


def played(seconds: float, over: Mapping[str, Any], *, controlled: bool = True, method: str = "paper") -> Run:
    """As in the vision process: the capture thread's steps and the detector's, in turn."""
    scenario = parse({**STANDING, **over, "camera": {**SMALL, **over.get("camera", {})}})
    clock, run = BlockingClock(100 * S), Run()
    camera = SimCameraSpec(scenario, clock.now, "simulated camera").open(clock)
    find = detector(VisionConfig(method=method), clock.now_ns)
    loop = ExposureLoop(RULES, clock)
    if controlled:
        loop.take_over(camera, "simulated camera")
    for seq in range(1, round(scenario.camera.fps * seconds)):
        frame = camera.read()
        loop.captured(seq, frame.t_capture_ns)
        found = find(frame.image, frame.t_capture_ns)
        loop.look(frame.image, seq, frame.t_capture_ns, found)
        red = frame.image[100:140, 140:180, 2]  # inside the marker
        exposure = loop.state or CameraExposure(ExposureState.NO_CONTROLS)
        t_s = (frame.t_capture_ns - 100 * S) / S
        run.moments.append(Moment(t_s, found, float(np.mean(red >= 254)), float(red.mean()), exposure))
    return run


@pytest.mark.mostly_long
@pytest.mark.parametrize("delay", [1, 2, 3])
def test_dusk_to_head_lamp_within_a_second(delay: int) -> None:
    run = played(6, {"ambient": HEAD_LAMP, "camera": {"exposure_delay": delay}}, method="robust")
    assert run.longest_clipped_s() <= 0.5
    assert run.turns() <= 2
    assert run.changes(4.5) == [], "settled within one and a half seconds of the lamp's full light"
    assert run.found(0.5) == 1.0
    assert all(130 < moment.level < 235 for moment in run.after(4.5))
    assert {moment.exposure.state for moment in run.moments} == {ExposureState.CONTROLLED}


def test_without_control_the_same_lamp_clips_the_marker_for_good() -> None:
    """What the test above would look like if the exposure did nothing."""
    run = played(5, {"ambient": HEAD_LAMP}, controlled=False)
    assert all(moment.clipped > 0.5 for moment in run.after(3.5))


@pytest.mark.long
def test_the_light_fails() -> None:
    """From full light to a thirtieth: gain, too, is needed; and its noise is no reason to hunt."""
    run = played(5, {"ambient": [{"at_s": 2, "over_s": 0.2, "level": 0.03}]}, method="robust")
    assert run.turns() <= 1
    assert run.changes(4.0) == []
    assert run.found(3.5) == 1.0
    gain_db = run.moments[-1].exposure.gain_db
    assert gain_db is not None
    assert gain_db > 10


@pytest.mark.parametrize("flicker", [0.25, 0.45])
@pytest.mark.parametrize("hz", mostly_long([97.0, 100.0, 118.0]))
def test_lamps_that_flicker_do_not_make_it_hunt(flicker: float, hz: float) -> None:
    """On the mains, other phases of the lamp in every frame: the beat is seen, 10, 7 and 2 Hz."""
    run = played(6, {"light": {"drift": 0.0, "flicker": flicker, "flicker_hz": hz}}, method="robust")
    assert run.changes(2.0) == []
    assert run.turns() <= 3
    assert run.longest_clipped_s() <= 0.5
    assert run.found(1.0) == 1.0


@pytest.mark.long
@pytest.mark.parametrize(("hz", "fps"), [(100.0, 25.05), (120.0, 29.97)])
def test_a_slow_beat_of_lamps_and_frames_is_not_followed(hz: float, fps: float) -> None:
    """Of 5 and 8 s, after two of them."""
    light = {"drift": 0.0, "flicker": 0.25, "flicker_hz": hz}
    run = played(30, {"light": light, "camera": {"fps": fps}})
    assert run.changes(17.0) == []
    assert len(run.changes()) <= 9
    assert run.found(1.0) == 1.0


@pytest.mark.long
def test_the_sun_beside_the_marker_does_not_darken_it() -> None:
    sun = {"at_s": 1.5, "u_px": 250, "v_px": 40, "radius_px": 25, "level": 300, "scatter": 0.001}
    run = played(4, {"glare": [sun]})
    assert run.found(0.5) == 1.0
    assert run.longest_clipped_s() == 0.0
    assert run.changes(2.5) == []
    assert all(moment.level > 130 for moment in run.after(1.0))


@pytest.mark.long
def test_a_lamp_in_a_bay_without_marker_does_not_blind_it_for_the_next_truck() -> None:
    """Night, a lamp in the picture, no marker in sight for 4 s; then it is found within half a second."""
    lamp = {"u_px": 60, "v_px": 60, "radius_px": 20, "level": 30}
    hidden = {"kind": "marker_hidden", "at_s": 0.0, "for_s": 4.0}
    run = played(6, {"glare": [lamp], "ambient": [{"at_s": 0, "level": 0.2}], "faults": [hidden]})
    assert all(moment.found.circle is None for moment in run.moments if moment.t_s < 3.9)
    assert run.found(4.5) == 1.0
    assert run.turns() <= 2


@pytest.mark.long
def test_a_marker_that_leaves_and_one_that_comes() -> None:
    legs = [
        {"distance_cm": 60, "lateral_mm": 900, "speed_cm_s": 100, "acceleration_cm_s2": 200, "hold_s": 3},
        {"distance_cm": 60, "lateral_mm": 0, "speed_cm_s": 100, "acceleration_cm_s2": 200, "hold_s": 3},
    ]
    run = played(8, {"legs": legs, "ambient": [{"at_s": 0, "level": 0.3}]})
    assert any(moment.found.circle is None for moment in run.after(2.0))
    assert run.found(6.5) == 1.0
    assert run.turns() <= 4
    assert run.changes(7.0) == []


@pytest.mark.long
def test_a_camera_that_keeps_its_own_exposure_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        run = played(8, {"ambient": [{"at_s": 0, "level": 0.3}], "camera": {"exposure_obeyed": False}})
    assert run.moments[-1].exposure.state is ExposureState.IGNORED
    assert caplog.messages == [
        'simulated camera: camera.exposure = "marker": the camera accepts other settings, but its pictures do not '
        "follow them; tried every 10 s"
    ]
    assert run.changes(7.0) == []


class TestWithoutControls:
    def test_a_source_without_exposure_is_used_as_it_is_and_reported(self, caplog: pytest.LogCaptureFixture) -> None:
        loop = ExposureLoop(RULES, BlockingClock(100 * S))
        loop.take_over(Plain(), "camera 3")
        loop.captured(1, S)
        loop.look(np.zeros((4, 4, 3), np.uint8), 1, S, Detection(None))
        assert loop.state == CameraExposure(ExposureState.NO_CONTROLS)
        assert caplog.messages == [
            'camera 3: camera.exposure = "marker": the camera has no exposure time that can be set; it is left as it is'
        ]

    def test_one_that_refuses_to_be_taken_over(self, caplog: pytest.LogCaptureFixture) -> None:
        loop = ExposureLoop(RULES, BlockingClock(100 * S))
        loop.take_over(Stubborn(None), "camera 3")
        loop.captured(1, S)
        assert loop.state == CameraExposure(ExposureState.REFUSED)
        assert "camera 3: no" in caplog.messages

    def test_one_that_refuses_a_setting_is_asked_again_after_ten_seconds(
        self, caplog: pytest.LogCaptureFixture
    ) -> None:
        controls = Refusing()
        loop = ExposureLoop(RULES, BlockingClock(100 * S))
        loop.take_over(Stubborn(controls), "camera 3")
        assert loop.state == CameraExposure(ExposureState.CONTROLLED, 1.0, None)
        dark = np.full((64, 64, 3), 5, np.uint8)
        for seq in range(1, 40 * 30):
            t_ns = S + seq * FRAME_NS
            controls.refuses = seq < 25 * 30
            loop.captured(seq, t_ns)
            loop.look(dark, seq, t_ns, Detection(None))
            if seq == 24 * 30:
                assert loop.state == CameraExposure(ExposureState.REFUSED, 1.0, None)
                assert controls.asked == 3
        assert loop.state is not None
        assert loop.state.state is not ExposureState.REFUSED
        assert caplog.messages == [
            "camera 3: refused",
            'camera 3: camera.exposure = "marker": the camera refuses to be set; tried every 10 s',
            'camera 3: camera.exposure = "marker": the camera obeys again',
        ]


class Plain(Source):
    def read(self) -> Frame:
        raise LinkError("ended")

    def close(self) -> None:
        pass


class Stubborn(Plain):
    def __init__(self, controls: ExposureControls | None) -> None:
        self._controls = controls

    def exposure_controls(self, rules: ExposureRules) -> ExposureControls:
        if self._controls is None:
            raise LinkError("camera 3: no")
        return self._controls


class Refusing:
    limits = ExposureLimits((100.0, 8000.0))
    controls_gain = False
    now = Exposure(1000.0)

    def __init__(self) -> None:
        self.asked = 0
        self.refuses = True

    def set(self, exposure: Exposure) -> Exposure:
        self.asked += 1
        if self.refuses:
            raise LinkError("camera 3: refused")
        self.now = exposure
        return exposure


class TestConfiguration:
    def test_by_default_the_camera_is_left_alone(self) -> None:
        assert exposure_rules(CameraConfig()) is None

    def test_the_rules_of_a_controlled_one(self) -> None:
        camera = CameraConfig(exposure="marker", exposure_max_ms=4, gain_range_db=(0.0, 18.0))
        assert exposure_rules(camera) == ExposureRules(4000.0, (0.0, 18.0))

    @pytest.mark.parametrize("url", ["0", "/dev/video2", "gige://camera"])
    def test_what_may_have_an_exposure(self, url: str) -> None:
        check_exposure(CameraConfig(url=url, exposure="marker"))

    @pytest.mark.parametrize(
        ("url", "what"), [("rtsp://u:secret@cam/1", r"a stream \(rtsp://\)"), ("film.mp4", "a file"), ("a/b", "a file")]
    )
    def test_what_has_none(self, url: str, what: str) -> None:
        check_exposure(CameraConfig(url=url))
        with pytest.raises(ConfigError, match=rf'^camera\.exposure = "marker": {what} has no exposure time') as raised:
            check_exposure(CameraConfig(url=url, exposure="marker"))
        assert "secret" not in str(raised.value)

    @pytest.mark.parametrize("gains", [(10.0, 10.0), (12.0, 0.0), (0.0, 90.0), (True, 5.0)])
    def test_gains_that_cannot_be(self, gains: Any) -> None:
        with pytest.raises(ValueError, match="gain_range_db"):
            CameraConfig(gain_range_db=cast("tuple[float, float]", gains))
