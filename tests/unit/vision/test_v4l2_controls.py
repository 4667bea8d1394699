"""`[camera.controls]` against a driver that is a table: order, range, what is read back, what a lost camera says."""

import errno
from typing import Any

import cv2
import numpy as np
import pytest

from gateway.clock import Clock
from gateway.config import CameraConfig, ControlsConfig, parse
from gateway.errors import ConfigError, LinkError
from gateway.processes.codec import record_of, record_packed
from gateway.sim.controls import SimControls
from gateway.vision.process.controls_trial import ControlsTrial
from gateway.vision.source.capture import CameraSource
from gateway.vision.source.specs import CameraSpec, source_spec
from gateway.vision.source.v4l2_controls import (
    CONTROLS,
    CameraControls,
    ControlSetting,
    OfferedControl,
    opened,
    settings_of,
)
from gateway.vision.source.v4l2_device import (
    AUTO_WHITE_BALANCE,
    AUTOGAIN,
    EXPOSURE_ABSOLUTE,
    EXPOSURE_AUTO,
    FOCUS_ABSOLUTE,
    GAIN,
    POWER_LINE_FREQUENCY,
    WHITE_BALANCE_TEMPERATURE,
)
from gateway.vision.transport.messages import ControlsReport
from tests.unit.vision.test_v4l2_exposure import Driver, device, driver
from tests.virtual_time import HandClock

__all__ = ["device", "driver"]  # fixtures
S = 1_000_000_000


def controls(device: str, **keys: Any) -> CameraControls:
    return opened(device, "camera 0", settings_of(ControlsConfig(**keys)))


def test_every_key_of_the_file_is_a_control() -> None:
    assert set(CONTROLS) == set(ControlsConfig.model_fields)


def test_what_differs_is_set_an_automatic_before_what_it_would_set(driver: Driver, device: str) -> None:
    driver.controls |= {
        AUTO_WHITE_BALANCE: [0, 1, 1, 1],
        WHITE_BALANCE_TEMPERATURE: [2800, 6500, 10, 4000],
        POWER_LINE_FREQUENCY: [0, 2, 1, 2],
    }
    fixed = controls(
        device, white_balance_temperature=4600, exposure_time_absolute=50, gain=64, power_line_frequency="50hz"
    )
    fixed.apply(0)
    assert driver.sets == [
        (EXPOSURE_AUTO, 1), (EXPOSURE_ABSOLUTE, 50), (AUTOGAIN, 0), (AUTO_WHITE_BALANCE, 0),
        (WHITE_BALANCE_TEMPERATURE, 4600), (POWER_LINE_FREQUENCY, 1),
    ]  # fmt: skip
    fixed.apply(0)
    assert len(driver.sets) == 6, "what it has is not set again"
    fixed.close()
    assert driver.value(EXPOSURE_ABSOLUTE) == 50, "as the next opening needs it"


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"gain": 101}, r"gain = 101: the camera takes 0 to 100$"),
        ({"exposure_time_absolute": 2}, r"exposure_time_absolute = 2: the camera takes 3 to 2047$"),
        ({"focus_absolute": 7}, r"focus_absolute = 7: the camera takes 0 to 250 in steps of 5$"),
        ({"zoom_absolute": 7}, r"zoom_absolute = 7: the camera has no such control that can be set$"),
        ({"white_balance_automatic": False}, "white_balance_automatic = false: the camera has no such control"),
        ({"brightness": 20}, r"brightness = 20: the camera refuses: Input/output error$"),
        ({"contrast": 20}, r"contrast = 20: the camera accepts it, and keeps 32$"),
    ],
)
@pytest.mark.failure_mode("C10")
def test_a_camera_that_does_not_have_what_the_file_says_is_lost_with_the_reason(
    driver: Driver, device: str, keys: dict[str, Any], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver.controls[FOCUS_ABSOLUTE] = [0, 250, 5, 0]
    driver.controls[CONTROLS["brightness"]] = [0, 255, 1, 128]
    driver.controls[CONTROLS["contrast"]] = [0, 64, 1, 32]
    driver.fails[CONTROLS["brightness"]] = errno.EIO
    driver.keeps.add(CONTROLS["contrast"])
    with pytest.raises(LinkError, match=f"^camera 0: camera.controls.{words}"):
        controls(device, **keys).apply(0)


def test_one_without_a_switch_for_the_automatic_needs_none(driver: Driver, device: str) -> None:
    for control in (EXPOSURE_AUTO, AUTOGAIN):
        del driver.controls[control]
    controls(device, exposure_time_absolute=50, gain=10).apply(0)
    assert (driver.value(EXPOSURE_ABSOLUTE), driver.value(GAIN)) == (50, 10)


class Capture:
    """OpenCV's, as far as it is used."""

    released = False

    def grab(self) -> bool:
        return True

    def retrieve(self) -> tuple[bool, Any]:
        return True, np.zeros((48, 64, 3), np.uint8)

    def get(self, key: int) -> float:
        return 0.0

    def set(self, key: int, value: float) -> bool:
        return True

    def isOpened(self) -> bool:
        return True

    def release(self) -> None:
        self.released = True


@pytest.fixture
def capture(monkeypatch: pytest.MonkeyPatch) -> Capture:
    made = Capture()
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: made)
    return made


@pytest.mark.failure_mode("C10")
def test_they_are_set_before_the_first_frame_again_after_it_and_looked_at_every_ten_seconds(
    driver: Driver, device: str, capture: Capture
) -> None:
    clock = HandClock()
    camera = camera_with(device, clock, gain=10)
    assert driver.value(GAIN) == 10
    driver.controls[GAIN][3] = 64  # the camera begins its stream with its own
    camera.read()
    assert driver.value(GAIN) == 10
    driver.controls[GAIN][3] = 11
    clock.t_ns += 10 * S - 1
    camera.read()
    clock.t_ns += 1
    with pytest.raises(LinkError, match=r"gain = 10: it was changed from outside, to 11$"):
        camera.read()
    camera.close()
    again = camera_with(device, clock, gain=10)
    assert driver.value(GAIN) == 10, "lost, opened again, and set again"
    again.close()


def test_a_camera_that_can_not_be_set_is_released(driver: Driver, device: str, capture: Capture) -> None:
    with pytest.raises(LinkError, match="takes 0 to 100"):
        camera_with(device, HandClock(), gain=101)
    assert capture.released


def camera_with(device: str, clock: Clock, **keys: Any) -> CameraSource:
    spec = CameraSpec(device, controls=settings_of(ControlsConfig(**keys)))
    assert record_of(CameraSpec, record_packed(spec)) == spec, "it travels to the vision process"
    source = spec.open(clock)
    assert isinstance(source, CameraSource)
    return source


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ({"controls": {"gain": 5, "gain_automatic": True}},
         "controls.gain = 5: has no effect with camera.controls.gain_automatic = true"),
        ({"controls": {"exposure_time_absolute": 5, "auto_exposure": "aperture_priority"}},
         'exposure_time_absolute = 5: has no effect with camera.controls.auto_exposure = "aperture_priority"'),
        ({"exposure": "marker", "controls": {"exposure_time_absolute": 5}},
         'controls.exposure_time_absolute = 5: camera.exposure = "marker" sets it'),
        ({"exposure": "marker", "gain_range_db": [0, 20], "controls": {"gain": 5}},
         'controls.gain = 5: camera.exposure = "marker" sets it'),
        ({"controls": {"gain": True}}, "controls.gain = true: should be a number"),
        ({"controls": {"gain_automatic": 1}}, "controls.gain_automatic = 1: should be true or false"),
        ({"controls": {"iris": 1}}, "controls.iris = 1: unknown key"),
        ({"controls": {"power_line_frequency": "55hz"}}, "power_line_frequency = .*'disabled', '50hz'"),
    ],
)  # fmt: skip
def test_what_the_file_may_not_say(camera: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse({"camera": camera})


def test_a_gain_that_the_exposure_control_leaves_alone_may_be_fixed() -> None:
    (bay,) = parse({"camera": {"exposure": "marker", "controls": {"gain": 5}}}).bays
    assert [(one.name, one.value, one.implied) for one in settings_of(bay.camera.controls)] == [
        ("gain_automatic", 0, True),
        ("gain", 5, False),
    ]


def test_only_a_camera_of_this_machine_has_controls() -> None:
    for url in ("rtsp://cam/1", "film.avi"):
        with pytest.raises(ConfigError, match=r"camera.controls: only a camera of this machine"):
            source_spec(CameraConfig.model_validate({"url": url, "controls": {"gain": 5}}))


def tried(**keys: Any) -> tuple[ControlSetting, ...]:
    return settings_of(ControlsConfig(**keys))


def test_what_is_tried_is_over_the_file_and_goes_back_to_it_or_to_what_was_found(driver: Driver, device: str) -> None:
    driver.controls[CONTROLS["brightness"]] = [0, 255, 1, 128]
    fixed = controls(device, gain=10)
    fixed.apply(0)
    found, fault = fixed.try_(tried(gain=20, exposure_time_absolute=50, brightness=7), {})
    assert fault == ""
    assert found == {
        "auto_exposure": 3, "exposure_time_absolute": 250, "gain_automatic": 0, "gain": 10, "brightness": 128
    }  # fmt: skip
    assert [driver.value(control) for control in (EXPOSURE_AUTO, EXPOSURE_ABSOLUTE, GAIN)] == [1, 50, 20]
    fixed.look(3600 * S)  # what is tried is no fault

    found, _ = fixed.try_(tried(brightness=9), {})
    assert found == {"brightness": 128}, "as it was before the first try"
    assert [driver.value(control) for control in (EXPOSURE_AUTO, EXPOSURE_ABSOLUTE, GAIN)] == [3, 250, 10]
    assert [row.fixed for row in fixed.offered() if row.name in ("gain", "gain_automatic", "brightness")] == [
        None, 10, None
    ]  # fmt: skip

    found, _ = fixed.try_((), {})
    assert (found, driver.value(CONTROLS["brightness"])) == ({}, 128)
    driver.controls[GAIN][3] = 11
    with pytest.raises(LinkError, match="changed from outside, to 11"):
        fixed.look(7200 * S)


def test_an_automatic_that_is_tried_may_move_what_the_file_fixes_until_the_trial_ends(
    driver: Driver, device: str
) -> None:
    fixed = controls(device, gain=10)
    fixed.apply(0)
    fixed.try_(tried(gain_automatic=True), {})
    driver.controls[GAIN][3] = 77  # the camera's own
    fixed.look(3600 * S)
    fixed.try_((), {})
    assert (driver.value(AUTOGAIN), driver.value(GAIN)) == (0, 10)


def test_a_process_that_takes_the_place_of_another_puts_back_what_that_one_found(driver: Driver, device: str) -> None:
    driver.controls[CONTROLS["brightness"]] = [0, 255, 1, 7]  # tried by the one before
    found, _ = controls(device).try_((), {"brightness": 128})
    assert (found, driver.value(CONTROLS["brightness"])) == ({}, 128)
    found, _ = controls(device, gain=10).try_((), {"gain": 33})
    assert (found, driver.value(GAIN)) == ({}, 10), "the file has been saved meanwhile"


def test_what_the_camera_refuses_is_said_and_the_rest_is_tried(driver: Driver, device: str) -> None:
    driver.keeps.add(EXPOSURE_ABSOLUTE)
    driver.fails[AUTOGAIN] = errno.EBUSY
    _, fault = controls(device).try_(tried(gain=20, exposure_time_absolute=50, zoom_absolute=4), {})
    assert fault == (
        "exposure_time_absolute = 50: the camera accepts it, and keeps 250; "
        "gain_automatic = false: the camera refuses: Device or resource busy; "
        "zoom_absolute = 4: the camera has no such control that can be set"
    )
    assert driver.value(GAIN) == 20


def test_the_simulated_camera_has_controls_that_change_its_picture() -> None:
    device, grey = SimControls(), np.full((2, 2, 3), 100, np.uint8)
    camera = CameraControls(device, "simulated", ())
    assert device.seen(grey) is grey
    for keys, bgr in (
        ({"exposure_time_absolute": 25}, [50, 50, 50]),
        ({"gain": 30}, [200, 200, 200]),  # 6 dB
        ({"brightness": -20}, [80, 80, 80]),
        ({"white_balance_temperature": 5750}, [80, 100, 125]),
        ({"exposure_time_absolute": 330}, [255, 255, 255]),
    ):
        _, fault = camera.try_(tried(**keys), {})
        assert (fault, device.seen(grey)[0, 0].tolist()) == ("", bgr)
    camera.try_((), {})
    assert device.seen(grey) is grey
    with pytest.raises(OSError, match="Permission denied"):
        device.set(WHITE_BALANCE_TEMPERATURE, 3000)


def test_a_trial_has_ended_only_when_the_camera_says_so() -> None:
    trial = ControlsTrial()
    assert trial.ended
    trial.set(ControlsConfig(gain=5), CameraConfig())
    number = trial.message().number
    trial.set(ControlsConfig(), CameraConfig())  # before any report of the first change
    assert (trial.under_way, trial.ended) == (False, False)
    trial.reported(ControlsReport((), number, {"gain": 1}))
    assert (trial.under_way, trial.ended) == (True, False)
    trial.reported(ControlsReport((), trial.message().number))
    assert (trial.under_way, trial.ended) == (False, True)


def test_a_report_of_what_was_tried_before_is_not_shown_but_what_it_found_is_kept() -> None:
    trial = ControlsTrial()
    trial.set(ControlsConfig(gain=5), CameraConfig())
    trial.reported(ControlsReport((OfferedControl("gain", 0, 9, 1, 0, 5),), trial.message().number, {"gain": 1}))
    late = trial.message().number
    trial.set(ControlsConfig(gain=6), CameraConfig())
    trial.reported(ControlsReport((), late, {"gain": 1, "brightness": 3}))
    assert not trial.report
    assert trial.message().found == {"gain": 1, "brightness": 3}
