"""The shell of the exposure control, in the vision process: between its two threads and the camera.

The detector's thread measures the light, the capture thread sets the camera: a driver that hangs in it is noticed and
replaced like one that hangs in a read. Each sees the other's newest record; nothing waits.
"""

import logging

from gateway.clock import Clock
from gateway.core.detection import Detection
from gateway.core.readings import CameraExposure, ExposureState
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.vision.exposure.controller import ExposureController
from gateway.vision.exposure.light import FrameLight, LightMeter
from gateway.vision.exposure.settings import ExposureRules
from gateway.vision.pixels import Image
from gateway.vision.source.contract import ExposureControlled, ExposureControls, Source

log = logging.getLogger(__name__)

REFUSED_NS = 10 * NS_PER_S  # after a refusal the camera is not asked again for this time
WRONG = {
    ExposureState.IGNORED: "the camera accepts other settings, but its pictures do not follow them; tried every 10 s",
    ExposureState.REFUSED: "the camera refuses to be set; tried every 10 s",
    ExposureState.NO_CONTROLS: "the camera has no exposure time that can be set; it is left as it is",
}


class ExposureLoop:
    """Of one opened source. `state` is for any thread."""

    def __init__(self, rules: ExposureRules, clock: Clock) -> None:
        self._rules = rules
        self._clock = clock
        self._meter = LightMeter()
        self._light: FrameLight | None = None  # the newest, not yet used
        self._label = ""
        self._controls: ExposureControls | None = None
        self._controller: ExposureController | None = None
        self._refused_until_ns: int | None = None
        self.state: CameraExposure | None = None

    # The capture thread.

    def take_over(self, source: Source, label: str) -> None:
        """After the source's first frame. One without controls is used as it is, and reported."""
        self._label = label
        try:
            if isinstance(source, ExposureControlled):
                self._controls = source.exposure_controls(self._rules)
        except LinkError as error:
            log.warning("%s", error)
            self._report(ExposureState.REFUSED)
            return
        if self._controls is None:
            self._report(ExposureState.NO_CONTROLS)
            return
        self._controller = ExposureController(self._controls.limits, self._controls.now)
        self._report(self._controller.state)

    def captured(self, seq: int, t_capture_ns: int) -> None:
        """After each frame: set the camera, if something is to be changed."""
        controls, controller = self._controls, self._controller
        if controls is None or controller is None:
            return
        controller.captured(seq, t_capture_ns)
        light, self._light = self._light, None
        if light is None or (self._refused_until_ns is not None and t_capture_ns < self._refused_until_ns):
            return
        wanted = controller.step(light)
        if wanted is not None:
            try:
                now = controls.set(wanted)
            except LinkError as error:
                if self._refused_until_ns is None:
                    log.warning("%s", error)
                self._refused_until_ns = t_capture_ns + REFUSED_NS
                controller.refused()
                self._report(ExposureState.REFUSED)
                return
            self._refused_until_ns = None
            controller.applied(now, light, self._clock.now_ns())
        if self._refused_until_ns is None:
            self._report(controller.state)

    def _report(self, state: ExposureState) -> None:
        before, controls = self.state, self._controls
        if controls is None:
            self.state = CameraExposure(state)
        else:
            gain_db = controls.now.gain_db if controls.controls_gain else None
            self.state = CameraExposure(state, controls.now.time_us / 1000, gain_db)
        if before is None or before.state is not state:
            if state in WRONG:
                log.warning('%s: camera.exposure = "marker": %s', self._label, WRONG[state])
            elif before is not None and before.state in WRONG:
                log.warning('%s: camera.exposure = "marker": the camera obeys again', self._label)

    # The detector's thread.

    def look(self, image: Image, seq: int, t_capture_ns: int, found: Detection) -> None:
        """After each frame that was processed."""
        if self._controls is not None:
            self._light = self._meter.measure(image, seq, t_capture_ns, found)
