"""The V4L2 controls against a driver that is a table: units, limits, order, refusals, and what is left behind."""

import errno
import fcntl
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from gateway.errors import LinkError
from gateway.vision.exposure.settings import Exposure, ExposureRules
from gateway.vision.source import v4l2_exposure
from gateway.vision.source.capture import CameraSource
from gateway.vision.source.contract import ExposureControlled
from gateway.vision.source.specs import CameraSpec
from gateway.vision.source.v4l2_device import (
    AUTOGAIN,
    CONTROL,
    EXPOSURE_ABSOLUTE,
    EXPOSURE_AUTO,
    EXPOSURE_AUTO_PRIORITY,
    G_CTRL,
    GAIN,
    QUERY,
    QUERYCTRL,
    S_CTRL,
)  # fmt: skip
from gateway.vision.source.v4l2_exposure import V4l2Exposure, exposure_controls
from tests.virtual_time import HandClock

RULES = ExposureRules(8000.0)
WITH_GAIN = ExposureRules(8000.0, (0.0, 20.0))


@dataclass
class Driver:
    """As a USB camera has them: id to (least, most, step, value)."""

    controls: dict[int, list[int]] = field(
        default_factory=lambda: {
            EXPOSURE_AUTO: [0, 3, 1, 3],
            EXPOSURE_AUTO_PRIORITY: [0, 1, 1, 1],
            EXPOSURE_ABSOLUTE: [3, 2047, 1, 250],
            AUTOGAIN: [0, 1, 1, 1],
            GAIN: [0, 100, 1, 64],
        }
    )
    flags: dict[int, int] = field(default_factory=dict)
    fails: dict[int, int] = field(default_factory=dict)  # id to errno, of setting it
    keeps: set[int] = field(default_factory=set)  # those that it accepts, and does not set
    sets: list[tuple[int, int]] = field(default_factory=list)

    def ioctl(self, fd: int, request: int, record: bytearray) -> int:
        os.fstat(fd)  # it is open
        control = int.from_bytes(record[:4], "little")
        if control not in self.controls:
            raise OSError(errno.EINVAL, "Invalid argument")
        least, most, step, value = self.controls[control]
        if request == QUERYCTRL:
            assert len(record) == 68
            record[:] = QUERY.pack(control, 1, b"Exposure", least, most, step, value, self.flags.get(control, 0))
        elif request == G_CTRL:
            record[:] = CONTROL.pack(control, value)
        elif request == S_CTRL:
            if control in self.fails:
                raise OSError(self.fails[control], os.strerror(self.fails[control]))
            wanted = CONTROL.unpack(record)[1]
            self.sets.append((control, wanted))
            if control not in self.keeps:
                self.controls[control][3] = min(max(wanted, least), most)
        else:
            raise AssertionError(hex(request))
        return 0

    def value(self, control: int) -> int:
        return self.controls[control][3]


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    driver = Driver()
    monkeypatch.setattr(fcntl, "ioctl", driver.ioctl)
    return driver


@pytest.fixture
def device(tmp_path: Path) -> str:
    path = tmp_path / "video0"
    path.touch()
    return str(path)


def opened(device: str, rules: ExposureRules = RULES, fps: float = 30.0) -> V4l2Exposure:
    controls = exposure_controls(device, "camera 0", rules, fps)
    assert controls is not None
    return controls


def test_the_numbers_are_those_of_the_kernels_headers() -> None:
    """As gcc has them on x86-64; the records hold no pointers, so they are the same everywhere."""
    assert (QUERY.size, CONTROL.size) == (68, 8)
    assert (
        (3 << 30) | (68 << 16) | (ord("V") << 8) | 36,
        (3 << 30) | (8 << 16) | (ord("V") << 8) | 27,
        (3 << 30) | (8 << 16) | (ord("V") << 8) | 28,
    ) == (QUERYCTRL, G_CTRL, S_CTRL)


def test_taken_over_the_camera_is_manual_and_keeps_its_rate_and_begins_within_the_limits(
    driver: Driver, device: str
) -> None:
    controls = opened(device)
    assert (driver.value(EXPOSURE_AUTO), driver.value(EXPOSURE_AUTO_PRIORITY)) == (1, 0)
    assert controls.limits.time_us == (300.0, 8000.0)
    assert controls.limits.time_step_us == 100.0
    assert (controls.now, driver.value(EXPOSURE_ABSOLUTE)) == (Exposure(8000.0), 80), "25 ms were too long"
    assert driver.value(GAIN) == 64
    assert driver.value(AUTOGAIN) == 1, "its gain is not touched"
    assert not controls.controls_gain
    assert controls.limits.gain_db == (0.0, 0.0)


def test_one_that_is_manual_already_goes_on_with_its_exposure(driver: Driver, device: str) -> None:
    driver.controls[EXPOSURE_AUTO][3], driver.controls[EXPOSURE_ABSOLUTE][3] = 1, 12
    assert opened(device).now == Exposure(1200.0)
    assert (EXPOSURE_AUTO, 1) not in driver.sets


@pytest.mark.parametrize(
    ("fps", "max_us", "most_us"),
    [(30, 50_000, 30_000), (30, 8000, 8000), (120, 50_000, 7500), (0, 50_000, 50_000), (0, 1e9, 204_700),
     (float("nan"), 7990, 7900), (5000, 8000, 300)],
)  # fmt: skip
def test_the_longest_time_is_that_of_driver_configuration_and_frame_period(
    driver: Driver, device: str, fps: float, max_us: float, most_us: float
) -> None:
    assert opened(device, ExposureRules(max_us), fps).limits.time_us == (300.0, most_us)


def test_a_gain_whose_ends_are_known_is_even_in_db(driver: Driver, device: str) -> None:
    controls = opened(device, WITH_GAIN)
    assert driver.value(AUTOGAIN) == 0
    assert controls.controls_gain
    assert controls.limits.gain_db == (0.0, 20.0)
    assert controls.limits.gain_step_db == pytest.approx(0.2)
    assert controls.set(Exposure(2500.0, 12.0)) == Exposure(2500.0, 12.0)
    assert (driver.value(EXPOSURE_ABSOLUTE), driver.value(GAIN)) == (25, 60)


def test_what_the_driver_makes_of_it_is_what_counts(driver: Driver, device: str) -> None:
    controls = opened(device, WITH_GAIN)
    driver.controls[EXPOSURE_ABSOLUTE][1] = 50
    assert controls.set(Exposure(7000.0, 0.0)) == Exposure(5000.0, 0.0) == controls.now


@pytest.mark.parametrize("flags", [0x1, 0x4])
def test_a_camera_whose_exposure_time_cannot_be_set_has_no_controls(driver: Driver, device: str, flags: int) -> None:
    driver.flags[EXPOSURE_ABSOLUTE] = flags
    assert exposure_controls(device, "camera 0", RULES, 30) is None
    driver.flags.clear()
    del driver.controls[EXPOSURE_ABSOLUTE]
    assert exposure_controls(device, "camera 0", RULES, 30) is None
    assert driver.sets == []


def test_one_without_a_switch_for_the_automatic(driver: Driver, device: str) -> None:
    for control in (EXPOSURE_AUTO, EXPOSURE_AUTO_PRIORITY, AUTOGAIN, GAIN):
        del driver.controls[control]
    controls = opened(device, WITH_GAIN)
    assert not controls.controls_gain
    assert controls.set(Exposure(700.0)) == Exposure(700.0)


def test_a_camera_that_refuses_is_a_lost_link_with_its_name_and_the_key(driver: Driver, device: str) -> None:
    controls = opened(device)
    driver.fails[EXPOSURE_ABSOLUTE] = errno.EIO
    with pytest.raises(LinkError, match=r'^camera 0: camera\.exposure = "marker": Input/output error$'):
        controls.set(Exposure(700.0))
    assert controls.now == Exposure(8000.0)
    driver.controls[EXPOSURE_AUTO][3] = 3
    driver.fails[EXPOSURE_AUTO] = errno.EBUSY
    with pytest.raises(LinkError, match="Device or resource busy"):
        opened(device)
    with pytest.raises(LinkError, match="No such file"):
        exposure_controls(device + "9", "camera 0", RULES, 30)


def test_closed_it_is_as_it_was_found_and_no_handle_is_left(driver: Driver, device: str) -> None:
    found = {control: row[3] for control, row in driver.controls.items()}
    handles = len(os.listdir("/proc/self/fd"))
    controls = opened(device, WITH_GAIN)
    controls.set(Exposure(700.0, 5.0))
    assert {control: row[3] for control, row in driver.controls.items()} != found
    controls.close()
    controls.close()
    assert {control: row[3] for control, row in driver.controls.items()} == found
    driver.fails[EXPOSURE_ABSOLUTE] = errno.EBUSY
    with pytest.raises(LinkError):
        opened(device)
    assert driver.value(EXPOSURE_AUTO) == 3, "what was switched off before it refused is on again"
    assert len(os.listdir("/proc/self/fd")) == handles


def test_a_camera_offers_its_controls_with_its_own_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def note(*args: Any) -> None:
        asked.append(args)

    class Capture:
        def get(self, key: int) -> float:
            return 60.0

        def release(self) -> None:
            pass

    monkeypatch.setattr(v4l2_exposure, "exposure_controls", note)
    camera = CameraSource(Capture(), CameraSpec(2), HandClock())  # type: ignore[arg-type]  # has what is used
    assert isinstance(camera, ExposureControlled)
    assert camera.exposure_controls(RULES) is None
    camera.close()
    assert asked == [(2, "camera 2", RULES, 60.0, None)]
