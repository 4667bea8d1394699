"""Exposure time and gain of a V4L2 camera, for a controller. Only cameras that state their exposure time in units of
time (V4L2_CID_EXPOSURE_ABSOLUTE, 100 us; USB cameras do) can be controlled. The unit of V4L2_CID_GAIN is the driver's
own: `camera.gain_range_db` says what its two ends amount to; in between it counts as even in dB.
"""

import logging
import math

from gateway.errors import LinkError
from gateway.vision.exposure.settings import Exposure, ExposureLimits, ExposureRules
from gateway.vision.source.v4l2_controls import ControlDevice
from gateway.vision.source.v4l2_device import (
    AUTOGAIN,
    EXPOSURE_ABSOLUTE,
    EXPOSURE_AUTO,
    EXPOSURE_AUTO_PRIORITY,
    GAIN,
    MANUAL,
    Range,
    V4l2Device,
    device_path,
)

log = logging.getLogger(__name__)

UNIT_US = 100.0
FRAME_SHARE = 0.9  # of the frame period is the longest exposure


class V4l2Exposure:
    """Begins with the exposure that the camera has, or the nearest that is allowed, so that a process which takes the
    place of another goes on where that one ended."""

    def __init__(self, device: ControlDevice, label: str) -> None:
        self._device = device
        self._label = label
        self._found: list[tuple[int, int]] = []  # what was changed, and what it was before
        self._gain: Range | None = None
        self._gain_db = (0.0, 0.0)
        self.limits = ExposureLimits((UNIT_US, UNIT_US))
        self.now = Exposure(UNIT_US)

    @property
    def controls_gain(self) -> bool:
        return self._gain is not None

    def take_over(self, time: Range, rules: ExposureRules, fps: float) -> None:
        """`time`: of EXPOSURE_ABSOLUTE. `fps`: 0: unknown. Raises OSError."""
        device, label = self._device, self._label
        self._switch(EXPOSURE_AUTO, MANUAL)
        self._switch(EXPOSURE_AUTO_PRIORITY, 0)  # the exposure is not to lower the frame rate
        self._gain = None if rules.gain_range_db is None else device.range_of(GAIN)
        if rules.gain_range_db is not None and (self._gain is None or self._gain.least == self._gain.most):
            log.warning("%s: camera.gain_range_db: the camera has no gain that can be set", label)
            self._gain = None
        self._gain_db = (0.0, 0.0) if self._gain is None or rules.gain_range_db is None else rules.gain_range_db
        gain_step_db = 0.0
        if self._gain is not None:
            self._switch(AUTOGAIN, 0)
            gain_step_db = self._db_a_unit * self._gain.step
        self.limits = ExposureLimits(
            _times_us(time, rules.max_time_us, fps), UNIT_US * time.step, self._gain_db, gain_step_db
        )
        settings = (EXPOSURE_ABSOLUTE,) if self._gain is None else (EXPOSURE_ABSOLUTE, GAIN)
        before = [(control, device.get(control)) for control in settings]
        self._found += before
        self.now = self._read(*(value for _, value in before))
        self._apply(self.limits.setting(self.now.amount))

    def set(self, exposure: Exposure) -> Exposure:
        try:
            self._apply(exposure)
        except OSError as error:
            raise _refused(self._label, error) from error
        return self.now

    def close(self) -> None:
        """As it was found."""
        for control, value in reversed(self._found):
            try:
                self._device.set(control, value)
            except OSError as error:
                log.debug("%s: control %#x: %s", self._label, control, error)
        self._found = []
        self._device.close()

    @property
    def _db_a_unit(self) -> float:
        assert self._gain is not None
        return (self._gain_db[1] - self._gain_db[0]) / (self._gain.most - self._gain.least)

    def _apply(self, exposure: Exposure) -> None:
        values = [self._device.set(EXPOSURE_ABSOLUTE, round(exposure.time_us / UNIT_US))]
        if self._gain is not None:
            unit = round((exposure.gain_db - self._gain_db[0]) / self._db_a_unit)
            values.append(self._device.set(GAIN, self._gain.least + unit))
        self.now = self._read(*values)

    def _read(self, time: int, gain: int = 0) -> Exposure:
        gain_db = 0.0 if self._gain is None else self._gain_db[0] + (gain - self._gain.least) * self._db_a_unit
        return Exposure(UNIT_US * max(1, time), gain_db)

    def _switch(self, control: int, value: int) -> None:
        if self._device.range_of(control) is not None and (before := self._device.get(control)) != value:
            self._device.set(control, value)
            self._found.append((control, before))


def exposure_controls(
    device: int | str, label: str, rules: ExposureRules, fps: float, handle: V4l2Device | None = None
) -> V4l2Exposure | None:
    """None: it has no exposure time that can be set. `handle`: of the device, where there is one already. Raises
    LinkError where it refuses."""
    try:
        opened = handle.again() if handle else V4l2Device(device_path(device))
    except OSError as error:
        raise _refused(label, error) from error
    return taken_over(opened, label, rules, fps)


def taken_over(device: ControlDevice, label: str, rules: ExposureRules, fps: float) -> V4l2Exposure | None:
    """Of an open device, which is closed with it. As `exposure_controls`."""
    time = device.range_of(EXPOSURE_ABSOLUTE)
    if time is None:
        device.close()
        return None
    controls = V4l2Exposure(device, label)
    try:
        controls.take_over(time, rules, fps)
    except OSError as error:
        controls.close()
        raise _refused(label, error) from error
    return controls


def _times_us(time: Range, most_us: float, fps: float) -> tuple[float, float]:
    """Within the driver's range, the configured limit and the frame period; at least the driver's shortest."""
    least = max(1, time.least)
    most_us = min(most_us, FRAME_SHARE * 1e6 / fps) if math.isfinite(fps) and fps > 0 else most_us
    steps = max(0, math.floor((min(UNIT_US * time.most, most_us) / UNIT_US - least) / time.step))
    return UNIT_US * least, UNIT_US * (least + steps * time.step)


def _refused(label: str, error: OSError) -> LinkError:
    return LinkError(f'{label}: camera.exposure = "marker": {error.strerror}')
