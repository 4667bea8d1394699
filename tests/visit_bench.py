"""One bay in virtual time: the simulator's world, its ranger's real bytes, a camera without pictures, the real step.

The camera's readings are made from the truth, as the robust method was seen to give them on rendered frames: R within a
fraction of a pixel, a marker behind the spout coasts and is lost, and a red lamp is taken for the marker after three
frames when the marker is covered. The ranger is the simulated board, its wire, and the gateway's own session.
"""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from gateway.bay import Recorder
from gateway.config import GatewayConfig, parse
from gateway.core import interlock, visit_progress
from gateway.core.detection import Circle
from gateway.core.events import Event, diff
from gateway.core.interlock import Rules
from gateway.core.plc import Control, PlcWrite, Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.retained import RetainedState
from gateway.core.shown import shown
from gateway.core.state import FunctionCheck, StateVector, Tick
from gateway.core.visit_progress import VisitProgress
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_S
from gateway.ranger.hcsr04.session import Hcsr04Session
from gateway.sim.hcsr04 import SensorErrors
from gateway.sim.ranger import faults_of
from gateway.sim.ranger_board import POWER_ON, RangerBoard, RangerFault
from gateway.sim.scenario import FaultKind, Scenario
from gateway.sim.scenario import parse as parse_scenario
from gateway.sim.spout import LAMP_MM, LAMP_RADIUS_MM
from gateway.sim.world import SPOUT_MM, Truth, World, spout_box

STEP_S = 0.01
MOMENTS_HZ = 50
LEAD_S = 4.0  # before world time 0, so that the sensors have come up
COAST_FRAMES = 8
CONTRAST = 1.4  # of the rim
LAMP_FRAMES = 3
UNIX_NS = 1_700_000_000 * NS_PER_S  # Unix time minus the gateway's clock
HIDDEN_SHARE = 0.2  # of R above the centre: the robust method loses a marker that is covered from above as far as that
PLC = Writer("10.0.0.9")

Plc = Callable[[float, StateVector], PlcWrite | None]


def gateway(*, writes: bool = True, **sections: Any) -> GatewayConfig:
    """A configuration for one bay; the heartbeat is not required unless a test asks for it."""
    handshake = {"heartbeat_required": False, "heartbeat_deadline_s": 1.0}
    return parse({"modbus": {"writes": writes, "plc_addresses": [PLC.address], "handshake": handshake}} | sections)


def truck(*legs: Mapping[str, Any], faults: tuple[Mapping[str, Any], ...] = (), **more: Any) -> Scenario:
    """A scenario that begins with a truck at 120 cm."""
    return parse_scenario({"start": {"distance_cm": 120}, "legs": legs, "faults": faults} | more)


@dataclass(frozen=True, slots=True)
class Moment:
    """What the gateway said, and what was so."""

    t_s: float
    state: StateVector
    truth: Truth
    heard_mm: float  # what the sound meets: the truck, or something nearer


class Bench:
    """World time runs as `run` is called; `now_ns` is the gateway's clock. What is public may be changed on the way."""

    def __init__(
        self,
        scenario: Scenario,
        config: GatewayConfig | None = None,
        *,
        seed: int = 0,
        record: Recorder | None = None,
    ) -> None:
        self.config = config or gateway()
        self.rules = Rules.of(self.config.bays[0], self.config)
        self.world = World(scenario)
        self.scenario = scenario
        self.plc: Plc | None = None
        self.vision_fault: Quality | None = None
        self.range_fault: Quality | None = None
        self.ticking = True  # False: the control task does not run, and the sensors do
        self.moments: list[Moment] = []
        self.events: list[Event] = []
        self.visits: list[VisitSummary] = []
        self.progress = VisitProgress()
        self.record: Recorder | None = record
        self.open_visit: Callable[[], VisitSummary | None] = lambda: None
        self._chance = random.Random(f"bench {seed} {scenario.seed}")
        self._origin_ns = 1000 * NS_PER_S
        self._ticks = 0  # of STEP_S since LEAD_S before world time 0
        sensor = scenario.ranger
        self._board = RangerBoard(
            lambda t_ns: self.world.distance_mm(self._t_s(t_ns)),
            seed=scenario.seed + seed,
            errors=SensorErrors(sensor.jitter_mm, sensor.step_mm, sensor.dropout),
            air_c=sensor.temperature_c,
            temperature_sensor=sensor.temperature_sensor,
        )
        self._board.boot(self.now_ns, POWER_ON)
        self._frame = round(-LEAD_S * scenario.camera.fps)
        self._pictures: list[tuple[int, VisionReading]] = []  # (when it is handed over, what)
        self._sight = MarkerSight(scenario, self._chance)
        self.power_on()

    @property
    def t_s(self) -> float:
        """World time."""
        return self._ticks * STEP_S - LEAD_S

    @property
    def now_ns(self) -> int:
        return self._origin_ns + round(self.t_s * NS_PER_S)

    @property
    def unix_ns(self) -> int:
        return self.now_ns + UNIX_NS

    def power_on(self, retained: RetainedState | None = None) -> None:
        """The gateway begins anew; the sensors were on all along."""
        self.state = interlock.initial("bay1", self.now_ns, self.rules, retained)
        self.progress = VisitProgress()
        if self.record is not None:
            self.record(None, self.state, [], self.open_visit)
        self._session = Hcsr04Session(self.config.bays[0].ranger)
        self._unplugged = False
        for reading in self._session.opened(self.now_ns):
            self.step(reading)

    def step(self, observation: Any) -> StateVector:
        old, self.state = self.state, interlock.step(self.state, observation, self.now_ns, self.rules)
        happened = diff(old, self.state)
        limits = self.rules.limits(self.state.plc.recipe)
        self.progress, ended = visit_progress.step(self.progress, old, self.state, limits, self.unix_ns)
        if ended is not None:
            self.visits.append(ended)
        self.events += happened
        if self.record is not None:
            self.record(observation, self.state, happened, self.open_visit)
        return self.state

    def check_function(self, mode: FunctionCheck) -> None:
        self.step(mode)

    def write(self, *bits: Control) -> StateVector:
        return self.step(PlcWrite(PLC, heartbeat=self._ticks & 0xFFFF, control=sum(1 << bit for bit in bits)))

    def run(self, until_s: float) -> StateVector:
        """Until that world time."""
        while self.t_s < until_s - 1e-9:
            self._ticks += 1
            self._range()
            self._camera()
            if self._ticks % 2 == 0 and self.ticking:
                self.step(Tick())
            if self.plc is not None and self._ticks % 5 == 0 and (write := self.plc(self.t_s, self.state)) is not None:
                self.step(write)
            if self._ticks % 2 == 0 and self.t_s >= 0:
                truth = self.world.truth(self.t_s, image_speed=False)
                echo_mm = faults_of(self.scenario, self.t_s).get(RangerFault.ECHO, truth.distance_mm)
                said = shown(self.state, self.now_ns)
                self.moments.append(Moment(self.t_s, said, truth, min(truth.distance_mm, echo_mm)))
        return self.state

    def run_until(self, wanted: Callable[[StateVector], bool], within_s: float = 60.0) -> StateVector:
        end_s = self.t_s + within_s
        while not wanted(self.state):
            assert self.t_s < end_s, f"not within {within_s} s; last: {self.state.visit}, reason {self.state.reason!r}"
            self.run(self.t_s + STEP_S)
        return self.state

    def _t_s(self, t_ns: int) -> float:
        return (t_ns - self._origin_ns) / NS_PER_S

    # -- the ranger ------------------------------------------------------------------------------------------------

    def _range(self) -> None:
        now_ns = self.now_ns
        faults = faults_of(self.scenario, self.t_s)
        self._board.faults = faults
        if self.range_fault is not None:
            self._board.advance(now_ns)
            if self._ticks % 10 == 0:
                self.step(RangeReading(now_ns, self.range_fault))
            return
        if RangerFault.UNPLUGGED in faults:
            if not self._unplugged or self._ticks % 10 == 0:
                self.step(self._session.lost(now_ns, "unplugged"))
            self._unplugged = True
            return
        readings: list[RangeReading] = []
        if self._unplugged:
            self._unplugged = False
            self._board.boot(now_ns, POWER_ON)
            readings += self._session.opened(now_ns)
        self._board.hear(self._session.request(now_ns), now_ns)
        for reading in [
            *readings,
            *self._session.feed(self._board.advance(now_ns), now_ns),
            *self._session.tick(now_ns),
        ]:
            self.step(reading)

    # -- the camera ------------------------------------------------------------------------------------------------

    def _camera(self) -> None:
        now_ns, fps = self.now_ns, self.scenario.camera.fps
        while self._origin_ns + self._frame * NS_PER_S / fps <= now_ns:
            taken_ns = self._origin_ns + round(self._frame * NS_PER_S / fps)
            reading = self._picture(taken_ns)
            if reading is not None:
                self._pictures.append((taken_ns + round(self._chance.uniform(0.02, 0.06) * NS_PER_S), reading))
            self._frame += 1
        ready = [reading for due_ns, reading in self._pictures if due_ns <= now_ns]
        self._pictures = [(due_ns, reading) for due_ns, reading in self._pictures if due_ns > now_ns]
        for reading in ready:
            self.step(reading)

    def _picture(self, t_ns: int) -> VisionReading | None:
        t_s = self._t_s(t_ns)
        active = self.scenario.active
        if self.vision_fault is not None:
            self._sight.unseen = COAST_FRAMES
            return VisionReading(t_ns, self.vision_fault)
        if active(FaultKind.CAMERA_FREEZE, t_s):
            return None
        if active(FaultKind.CAMERA_LOST, t_s):
            return VisionReading(t_ns, Quality.LINK_DOWN)
        quality, circle = self._sight.frame(self.world.truth(t_s, image_speed=False))
        if circle is None:
            return VisionReading(t_ns, quality)
        visible = 1 - self.scenario.crusted(t_s)
        return VisionReading(t_ns, quality, circle, frame_id=self._frame, visible=visible, contrast=CONTRAST)


class MarkerSight:
    """What the robust method finds in one frame after another, from the truth instead of pictures."""

    def __init__(self, scenario: Scenario, chance: random.Random) -> None:
        self.scenario = scenario
        self.unseen = 0  # frames without the marker, in a row
        self._lit = 0
        self._chance = chance

    def frame(self, truth: Truth) -> tuple[Quality, Circle | None]:
        """GOOD with the circle, COASTED or NO_TARGET."""
        black = self.scenario.active(FaultKind.CAMERA_BLACK, truth.t_s)
        circle = None if black or not self._can_see(truth) else Circle(truth.u_px, truth.v_px, truth.radius_px)
        self.unseen = 0 if circle else self.unseen + 1
        self._lit = self._lit + 1 if truth.lamp and not black else 0
        if circle is None and self.unseen > COAST_FRAMES and self._lit >= LAMP_FRAMES:
            circle = self._lamp()
        if circle is None:
            return Quality.COASTED if self.unseen <= COAST_FRAMES and not black else Quality.NO_TARGET, None
        noise = self._chance.gauss
        u_px, v_px = circle.u_px + noise(0, 0.1), circle.v_px + noise(0, 0.1)
        return Quality.GOOD, Circle(u_px, v_px, circle.radius_px + noise(0, 0.15))

    def _can_see(self, truth: Truth) -> bool:
        camera, radius = self.scenario.camera, truth.radius_px
        if self.scenario.active(FaultKind.MARKER_HIDDEN, truth.t_s):
            return False
        inside = radius <= truth.u_px < camera.width_px - radius and radius <= truth.v_px < camera.height_px - radius
        _, _, edge = spout_box(camera, truth.spout)
        return inside and edge < truth.v_px - HIDDEN_SHARE * radius

    def _lamp(self) -> Circle:
        camera = self.scenario.camera
        cx, cy = camera.centre_px
        scale = camera.focal_px / (SPOUT_MM + camera.offset_mm)
        return Circle(cx + scale * LAMP_MM[0], cy + scale * LAMP_MM[1], scale * LAMP_RADIUS_MM)


class Levels:
    """A PLC that lives and writes its bits as they are set."""

    def __init__(self, bench: Bench) -> None:
        self.bits = 0
        self.alive = True
        self._beat = 0
        bench.plc = self

    def __call__(self, t_s: float, state: StateVector) -> PlcWrite | None:
        if not self.alive:
            return None
        self._beat = (self._beat + 1) & 0xFFFF
        return PlcWrite(PLC, heartbeat=self._beat, control=self.bits)

    def release(self, on: bool = True) -> None:
        self.bits = 1 << Control.RELEASE if on else 0
