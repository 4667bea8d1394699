"""The simulated camera, as any other source of frames: opened in the vision process, paced by the clock.

World time is (now - origin) of the clock. Nothing is kept between two openings: a replaced vision process shows the
same world at the same time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from gateway.clock import Clock
from gateway.core.readings import AgeProof
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.errors import LinkError
from gateway.sim.controls import SimControls
from gateway.sim.driven_way import DrivenWay
from gateway.sim.led import Led
from gateway.sim.scenario import DEFAULT_EXPOSURE_MS, Camera, FaultKind, Scenario
from gateway.sim.world import TruckHold, World
from gateway.vision.exposure.settings import Exposure, ExposureLimits, ExposureRules
from gateway.vision.source.contract import Frame, Needs, Source
from gateway.vision.source.v4l2_controls import CameraControls, ControlSetting, problem

if TYPE_CHECKING:
    from gateway.sim.render import Painter

FREEZE_STEP_S = 0.02  # how often a hung read looks whether the hang is over


@dataclass(frozen=True, slots=True)
class SimCameraSpec:
    """What is sent to the vision process. World time 0 is `origin_ns` of the clock given to `open`."""

    needs: ClassVar[Needs] = Needs.FILES
    scenario: Scenario
    origin_ns: int
    label: str = "simulated camera"
    hold: TruckHold | None = None
    track: DrivenWay | None = None
    controls: tuple[ControlSetting, ...] = ()  # of those that it has not, nothing is simulated
    led: Led | None = None  # of the beacon, in its view

    def open(self, clock: Clock) -> "SimCamera":
        """Paints the textures, most of a second. Raises LinkError while the scenario has the camera lost."""
        from gateway.sim.render import Painter  # noqa: PLC0415 - OpenCV stays out of the main process

        camera = SimCamera(self, clock, Painter(self.scenario, self.led))
        camera.check_link()
        return camera


class SimExposure:
    """Settings take effect `camera.exposure_delay` frames later. `last`: number of the frame that was exposed last."""

    controls_gain = True

    def __init__(self, camera: Camera, rules: ExposureRules, last: Callable[[], int]) -> None:
        longest_us = min(rules.max_time_us, 0.9e6 / camera.fps)
        self.limits = ExposureLimits((min(20.0, longest_us), longest_us), 0.0, (0.0, camera.gain_max_db), 0.1)
        self.now = self.limits.setting(1000 * (camera.exposure_ms or DEFAULT_EXPOSURE_MS))
        self._delay = camera.exposure_delay
        self._obeyed = camera.exposure_obeyed
        self._last = last
        self._shown: list[tuple[int, Exposure]] = [(-(2**62), self.now)]  # from which frame on, newest last

    def set(self, exposure: Exposure) -> Exposure:
        self.now = exposure
        if self._obeyed:
            self._shown.append((self._last() + 1 + self._delay, exposure))
        return exposure

    def of_frame(self, index: int) -> Exposure:
        while len(self._shown) > 1 and self._shown[1][0] <= index:
            del self._shown[0]
        return self._shown[0][1]


class SimCamera(Source):
    """Renders the world at the moment of each exposure."""

    def __init__(self, spec: SimCameraSpec, clock: Clock, painter: "Painter") -> None:
        self.may_repeat = not spec.scenario.camera.noise  # drawn without noise, a still scene is always the same
        self._spec = spec
        self._clock = clock
        self._world = World(spec.scenario, hold=spec.hold, track=spec.track)
        self._painter: Painter | None = painter
        self._period_ns = round(NS_PER_S / spec.scenario.camera.fps)
        self._exposure: SimExposure | None = None
        self._device = SimControls()
        taken = [one for one in spec.controls if not problem(self._device, one)]
        self._controls = CameraControls(self._device, spec.label, taken)
        self._controls.apply(clock.now_ns())
        self._last = self._index(clock.now_ns())  # of the frame exposed last; negative before world time 0
        self._lit = (self._last - 1, 0.0)  # number of the picture that is shown, and how much of its exposure is lit

    def read(self) -> Frame:
        """The next frame, stamped at the middle of its exposure, when it is due.

        Frame k is exposed at k periods of world time. A late caller gets the present frame: missed frames
        are lost, as with a real camera. Raises LinkError while the camera is lost and after `close`.
        """
        if self._painter is None:
            raise LinkError(f"{self._spec.label}: closed")
        self._wait_for(self._last + 1)
        while self._spec.scenario.active(FaultKind.CAMERA_FREEZE, self._world_s()):
            self.check_link()
            self._clock.block(FREEZE_STEP_S)
        self.check_link()
        t_ns = self._clock.now_ns()
        self._last = self._index(t_ns)
        shown_s, index = self._spec.scenario.shown_s(self._world_s(t_ns)), self._last
        stuck_s = self._spec.scenario.since_s(FaultKind.CAMERA_STUCK, shown_s)
        if stuck_s is not None:
            shown_s, index = stuck_s, round(stuck_s * NS_PER_S) // self._period_ns
        exposure = None if self._exposure is None else self._exposure.of_frame(index)
        lit = self._lit_share(index, shown_s, exposure)
        picture = self._device.seen(self._painter.frame(self._world.truth(shown_s), index, exposure, lit))
        return Frame(picture, t_ns, age_proof=AgeProof.OWN_CLOCK)

    def _lit_share(self, index: int, shown_s: float, exposure: Exposure | None) -> float:
        """For which part of the exposure the LED was lit. One picture always shows the same."""
        if self._spec.led is not None and index != self._lit[0]:
            ms = self._spec.scenario.camera.exposure_ms if exposure is None else exposure.time_us / 1000
            middle_ns, half_ns = self._spec.origin_ns + round(shown_s * NS_PER_S), round(ms * NS_PER_MS / 2)
            self._lit = (index, self._spec.led.lit(middle_ns - half_ns, middle_ns + half_ns))
        return self._lit[1]

    def controls(self) -> CameraControls:
        return self._controls

    def exposure_controls(self, rules: ExposureRules) -> "SimExposure":
        """From now on the pictures are those of a sensor with shot noise, full wells, exposure time and gain."""
        self._exposure = SimExposure(self._spec.scenario.camera, rules, lambda: self._last)
        return self._exposure

    def close(self) -> None:
        self._painter = None

    def check_link(self) -> None:
        if self._spec.scenario.active(FaultKind.CAMERA_LOST, self._world_s()):
            raise LinkError(f"{self._spec.label}: the camera is lost (fault of the scenario)")

    def _index(self, t_ns: int) -> int:
        return (t_ns - self._spec.origin_ns) // self._period_ns

    def _wait_for(self, index: int) -> None:
        """Until the exposure of frame `index`; at once where that is past."""
        due_ns = self._spec.origin_ns + index * self._period_ns
        while (left_ns := due_ns - self._clock.now_ns()) > 0:
            self._clock.block(left_ns / NS_PER_S)

    def _world_s(self, t_ns: int | None = None) -> float:
        return ((self._clock.now_ns() if t_ns is None else t_ns) - self._spec.origin_ns) / NS_PER_S
