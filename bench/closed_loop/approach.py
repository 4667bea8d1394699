"""One approach in virtual time: a vehicle, its sensors, the gateway's own step, and the PLC's program.

The ranger is the simulated HC-SR04 (noise, steps of 4 mm, lost echoes) behind the gateway's own conditioning; the
camera gives circles made from the truth with the robust method's noise, 20 to 60 ms after the exposure, and misses the
marker while dust hides it. Equal arguments give equal results.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from random import Random
from typing import Any

from bench.closed_loop.faults import Failure, Fault, failures
from bench.closed_loop.plc import POLL_S, SCAN_S, ApproachBlock, Image, PlainProgram, Program, image_of
from gateway.config import DriveConfig, GatewayConfig
from gateway.core import interlock
from gateway.core.detection import Circle, Ellipse
from gateway.core.interlock import Rules
from gateway.core.movement import DriveMemory
from gateway.core.plc import Control, PlcWrite, Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.shown import shown
from gateway.core.state import StateVector, Tick
from gateway.durations import NS_PER_S
from gateway.ranger.conditioning import Conditioner
from gateway.ranger.hcsr04.protocol import NO_FLAGS, PERIOD_MS, Flags
from gateway.ranger.hcsr04.session import distance_mm
from gateway.sim.hcsr04 import SensorErrors, measure
from gateway.sim.vehicles import STEP_S, Vehicle, VehicleKind, drawn, drive_keys, worst
from tests.visit_bench import gateway

FOCAL_PX, RADIUS_MM = 600.0, 90.0
FPS = 15
TICK_S = 0.04  # twice the default: half the time of a processor
TICK_STEPS, SCAN_STEPS = round(TICK_S / STEP_S), round(SCAN_S / STEP_S)
AIR_C = 20.0
WIRE_S = 0.035  # a line at 9600 baud, and its way to the host
COAST_FRAMES = 8
LEAD_S = 1.5  # the sensors come up before the PLC's program begins
STANDS_MM_S = 1.0  # slower than this: a rope still gives a little
STOOD_S = 2.0  # standing in place for this time: the approach is over
GAVE_UP_S = 30.0  # likewise, though it is not in place
LIMIT_S = 180.0
FAULT_SOON_S, FAULT_OVER_S = 6.0, 7.0  # a fault that ends so soon is waited for, and so much longer
FAULTY_S = 60.0  # of one with faults
RUNS = 5  # approaches of one plant, which learns from them
PLC = Writer("10.0.0.9")
PLACE_MM = 10.0
PLAIN_RESERVE_MM = 100.0  # it slows down so much before the vehicle would have to
MS = 1_000_000
Seen = tuple[Circle, Ellipse | None]


class Aid(StrEnum):
    SETPOINT = "setpoint"
    PLAIN = "plain program"


@dataclass(frozen=True, slots=True)
class Result:
    """Of one approach. Distances mm, times s."""

    seed: int
    kind: str
    aid: str
    error_mm: float  # at the end: true distance to the place, positive short of it
    deepest_mm: float  # the least true distance to the mark (of a spout: marker) on the way; negative past it
    time_s: float  # from the first motion until it stands for good
    optimal_s: float  # the shortest time under the same limits
    in_place: bool
    collided: bool
    dust: bool
    faults: tuple[str, ...] = ()


@cache
def limits(kind: VehicleKind) -> Mapping[str, float]:
    """Every key of [drive] for this vehicle."""
    return DriveConfig(**drive_keys(kind)).model_dump()


@cache
def settings(kind: VehicleKind, aid: Aid) -> GatewayConfig:
    return settings_with(kind, aid)


def settings_with(kind: VehicleKind, aid: Aid, **more: Any) -> GatewayConfig:
    """`more`: further sections."""
    check = {"focal_px": FOCAL_PX, "marker_radius_mm": RADIUS_MM, "tolerance_mm": 30.0, "tolerance_share": 0.05,
             "lasting_s": 0.3}  # fmt: skip
    sections: dict[str, Any] = {"fusion": {"cross_check": check, "period_s": TICK_S}, **more}
    if aid is Aid.SETPOINT:
        sections["drive"] = drive_keys(kind)
    made = gateway(**sections)
    return made.model_copy(
        update={
            "modbus": made.modbus.model_copy(
                update={
                    "handshake": made.modbus.handshake.model_copy(
                        update={"heartbeat_required": True, "heartbeat_deadline_s": 1.0, "enable_required": True}
                    )
                }
            )
        }
    )


def optimal_s(way_mm: float, of: Mapping[str, float]) -> float:
    """The shortest time under these limits, s: the lag, then full acceleration, full speed, full brake."""
    up, down, full = of["acceleration_mm_s2"], of["brake_mm_s2"], of["max_speed_mm_s"]
    peak = min(full, math.sqrt(2 * way_mm * up * down / (up + down)))
    ramps_mm = peak**2 / 2 * (1 / up + 1 / down)
    return of["lag_s"] + peak / up + peak / down + (way_mm - ramps_mm) / peak


class Approach:
    """Runs with `run`. `learned`: the memory of the plant's earlier approaches; `program`: None is FB_Approach's model.

    `trace`: (t, distance, speed, reference, setpoint, DriveState) at each scan.
    """

    def __init__(
        self,
        kind: VehicleKind,
        aid: Aid,
        seed: int,
        config: GatewayConfig,
        *,
        with_faults: bool = False,
        learned: DriveMemory | None = None,
        trace: list[tuple[float, ...]] | None = None,
    ) -> None:
        self.kind, self.aid, self.seed, self.trace = kind, aid, seed, trace
        self.chance = chance = Random(f"approach {kind} {seed}")
        of = limits(kind)
        hard = with_faults and chance.random() < 0.3
        plant = Random(f"plant {kind} {seed // RUNS}")
        self.vehicle: Vehicle = worst(kind) if hard else drawn(kind, plant, chance)
        self.start_mm = chance.uniform(600, 1600) if with_faults else chance.uniform(1500, 3500)
        self.failures = failures(seed, 8.0) if with_faults else ()
        self.config, self.rules = config, Rules.of(config.bays[0], config)
        self.mark_mm = config.bays[0].fusion.distance_threshold_mm
        self.limit_mm = self.mark_mm - config.bays[0].guidance.overshoot_mm
        self.errors = SensorErrors(chance.uniform(1.0, 2.5), 4.0, chance.choice((0.0, 0.005, 0.02)))
        self.centre_px = (320 + chance.uniform(-20, 20), 240 + chance.uniform(-20, 20))
        self.dust = _dust(chance)
        self.program = _program(aid, of, self.mark_mm)
        self.conditioner = Conditioner(config.bays[0].ranger, PERIOD_MS * MS)
        self.conditioner.opened()
        self.steps = 0
        self.origin_ns = 1000 * NS_PER_S
        self.state: StateVector | None = self.powered(learned)
        self.later: list[tuple[float, RangeReading | VisionReading]] = []
        self.next_s = math.inf  # the first of them arrives
        self.images: deque[tuple[float, Image]] = deque()
        self.range_n = self.frame_n = self.unseen = self.beat = 0
        self.last_mm = self.start_mm
        self.last_seen: Seen | None = None
        self.reference_mm_s = 0.0
        self.phase_s = chance.uniform(0, POLL_S)

    def powered(self, learned: DriveMemory | None) -> StateVector:
        """The gateway's state at its start."""
        state = interlock.initial("bay1", self.now_ns, self.rules)
        return replace(state, memory=replace(state.memory, drive=learned)) if learned else state

    @property
    def t_s(self) -> float:
        return self.steps * STEP_S - LEAD_S

    @property
    def now_ns(self) -> int:
        return self.origin_ns + round(self.steps * STEP_S * NS_PER_S)

    @property
    def distance_mm(self) -> float:
        return self.start_mm - self.vehicle.way_mm

    def active(self, t_s: float) -> dict[Fault, Failure]:
        return {one.fault: one for one in self.failures if one.at_s <= t_s < one.at_s + one.for_s}

    def run(self) -> Result:
        moved_s: float | None = None
        stood_s = self.t_s
        deepest_mm, collided = self.start_mm, False
        t_s, longest_s = self.t_s, FAULTY_S if self.failures else LIMIT_S
        while t_s < longest_s:
            self.step()
            t_s, distance_mm = self.t_s, self.distance_mm
            if self.reference_mm_s or abs(self.vehicle.speed_mm_s) > STANDS_MM_S:
                stood_s = t_s
                moved_s = t_s if moved_s is None else moved_s
            deepest_mm = min(deepest_mm, distance_mm - self.mark_mm)
            if distance_mm < self.limit_mm:
                collided = True
                break
            patience_s = STOOD_S if self.state is not None and self.state.in_place else self._patience_s
            if t_s - stood_s >= patience_s and t_s - self._ended_s(t_s) >= patience_s:
                break
        return Result(
            seed=self.seed,
            kind=self.kind.value,
            aid=self.aid.value,
            error_mm=round(self.distance_mm - (self.mark_mm - PLACE_MM), 2),
            deepest_mm=round(deepest_mm, 2),
            time_s=round(stood_s - (moved_s or 0.0), 2),
            optimal_s=round(optimal_s(self.start_mm - self.mark_mm + PLACE_MM, limits(self.kind)), 2),
            in_place=self.state is not None and self.state.in_place,
            collided=collided,
            dust=bool(self.dust),
            faults=tuple(one.fault.name for one in self.failures),
        )

    @property
    def _patience_s(self) -> float:
        return FAULT_OVER_S if self.failures else GAVE_UP_S

    def _ended_s(self, t_s: float) -> float:
        """When the last fault ends that is not to last for long; then the vehicle may go on."""
        ends = (one.at_s + one.for_s for one in self.failures)
        return max((end for end in ends if end < t_s + FAULT_SOON_S), default=-LEAD_S)

    # -- one step --------------------------------------------------------------------------------------------------

    def step(self) -> None:
        active = self.active(self.t_s) if self.failures else {}
        faster = active[Fault.DRIVE_FASTER].amount if Fault.DRIVE_FASTER in active else 1.0
        self.vehicle.drive(faster * self.reference_mm_s, STEP_S)
        self.steps += 1
        t_s = self.t_s
        if Fault.GATEWAY_KILLED in active:
            self.state = None
        elif self.state is None:
            self.state = self.powered(None)
            self.conditioner.opened()
        self.range(t_s, active)
        self.camera(t_s, active)
        if self.next_s <= t_s:
            due = [one for one in self.later if one[0] <= t_s]
            self.later = [one for one in self.later if one[0] > t_s]
            self.next_s = min((at_s for at_s, _ in self.later), default=math.inf)
            for _, reading in due:
                self.fold(reading)
        if self.steps % TICK_STEPS == 0 and Fault.CONTROL_HELD not in active:
            self.fold(Tick())
        if self.steps % SCAN_STEPS == 0:
            self.plc(t_s, active)

    def arrives(self, at_s: float, reading: RangeReading | VisionReading) -> None:
        self.later.append((at_s, reading))
        self.next_s = min(self.next_s, at_s)

    def fold(self, observation: Any) -> None:
        if self.state is not None:
            self.state = interlock.step(self.state, observation, self.now_ns, self.rules)

    def plc(self, t_s: float, active: Mapping[Fault, Failure]) -> None:
        if t_s < 0:
            return
        if (t_s + self.phase_s) % POLL_S < SCAN_S - 1e-9 and self.state is not None and Fault.POLL_LOST not in active:
            self.fold(PlcWrite(PLC, heartbeat=self.heartbeat(), control=1 << Control.ENABLE))
            self.images.append((t_s + self.chance.uniform(0.01, 0.03), self.polled(self.state)))
        newest = None
        while self.images and self.images[0][0] <= t_s:
            newest = self.images.popleft()[1]
        self.reference_mm_s = self.program.scan(t_s, newest)
        if self.trace is not None and self.state is not None:
            told = shown(self.state, self.now_ns)
            speed = told.setpoint.speed_mm_s if self.aid is Aid.SETPOINT else self.reference_mm_s
            state = float(told.setpoint.state) if self.aid is Aid.SETPOINT else float(told.stop)
            self.trace.append((t_s, self.distance_mm, self.vehicle.speed_mm_s, self.reference_mm_s, speed, state))

    def heartbeat(self) -> int:
        """What the PLC writes next."""
        self.beat = (self.beat + 1) & 0xFFFF
        return self.beat

    def polled(self, state: StateVector) -> Image:
        return image_of(shown(state, self.now_ns))

    # -- the sensors -----------------------------------------------------------------------------------------------

    def range(self, t_s: float, active: Mapping[Fault, Failure]) -> None:
        if t_s + LEAD_S < self.range_n * PERIOD_MS / 1000:
            return
        self.range_n += 1
        true_mm: float | None = self.distance_mm
        if Fault.RANGER_DEAF in active:
            true_mm = None
        elif Fault.RANGER_FROZEN in active:
            true_mm = self.last_mm
        elif Fault.RANGER_NEAR in active:
            true_mm = min(self.distance_mm, active[Fault.RANGER_NEAR].amount)
        elif Fault.RANGER_FAR in active:
            true_mm = self.distance_mm + active[Fault.RANGER_FAR].amount
        elif Fault.RANGER_WILD in active and self.range_n % 2:
            true_mm = active[Fault.RANGER_WILD].amount
        else:
            self.last_mm = self.distance_mm
        echo = measure(true_mm, AIR_C, self.errors, self.chance)
        if self.state is None or Fault.RANGER_SILENT in active:
            return
        quality = {NO_FLAGS: Quality.GOOD, Flags.NO_ECHO: Quality.NO_ECHO, Flags.TOO_NEAR: Quality.TOO_NEAR}.get(
            echo.flags, Quality.TOO_FAR
        )
        delay_s = WIRE_S + echo.fell_ns / NS_PER_S
        if Fault.RANGER_LATE in active:
            delay_s += active[Fault.RANGER_LATE].amount
        raw_mm = distance_mm(echo.ticks, AIR_C)
        for reading in self.conditioner.measured(raw_mm, quality, self.now_ns, self.range_n):
            self.arrives(t_s + delay_s, reading)

    def camera(self, t_s: float, active: Mapping[Fault, Failure]) -> None:
        if (t_s + LEAD_S) * FPS < self.frame_n:
            return
        self.frame_n += 1
        if Fault.CAMERA_FROZEN in active or self.state is None:
            return
        seen: Seen | None = self.seen()
        hidden = Fault.MARKER_HIDDEN in active or any(begin <= t_s < end for begin, end in self.dust)
        if Fault.CAMERA_STUCK in active:
            seen = self.last_seen
        elif hidden:
            seen = None
        else:
            self.last_seen = seen
        circle, ellipse = seen or (None, None)
        self.unseen = 0 if circle else self.unseen + 1
        missing = Quality.COASTED if self.unseen <= COAST_FRAMES else Quality.NO_TARGET
        reading = VisionReading(self.now_ns, Quality.GOOD if circle else missing, circle, frame_id=self.frame_n,
                                visible=1.0 if circle else None, ellipse=ellipse)  # fmt: skip
        delay_s = self.chance.uniform(0.02, 0.06)
        if Fault.CAMERA_LATE in active:
            delay_s += active[Fault.CAMERA_LATE].amount
        self.arrives(t_s + delay_s, reading)

    def seen(self) -> Seen:
        """The marker as the camera finds it now."""
        radius_px, noise = FOCAL_PX * RADIUS_MM / self.distance_mm, self.chance.gauss
        u_px, v_px = self.centre_px
        return Circle(u_px + noise(0, 0.1), v_px + noise(0, 0.1), radius_px + noise(0, 0.15)), None


def _program(aid: Aid, of: Mapping[str, float], mark_mm: float) -> Program:
    ramp_mm_s2 = of["acceleration_mm_s2"]
    if aid is Aid.SETPOINT:
        return ApproachBlock(ramp_mm_s2, of["brake_mm_s2"])
    full_mm_s = of["max_speed_mm_s"]
    way_mm = full_mm_s * (of["lag_s"] + of["latency_s"]) + full_mm_s**2 / 2 / of["brake_mm_s2"]
    return PlainProgram(full_mm_s, of["creep_speed_mm_s"], mark_mm + way_mm + PLAIN_RESERVE_MM, ramp_mm_s2)


def _dust(chance: Random) -> tuple[tuple[float, float], ...]:
    """In one approach of three, one to three clouds hide the marker for up to 1.5 s."""
    if chance.random() > 1 / 3:
        return ()
    begins = [chance.uniform(1.0, 15.0) for _ in range(chance.randint(1, 3))]
    return tuple((begin, begin + chance.uniform(0.1, 1.5)) for begin in begins)
