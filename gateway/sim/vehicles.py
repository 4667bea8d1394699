"""Vehicles that a PLC moves: how each follows a speed reference. Pure: the time step is an argument.

`way_mm` is what it has driven towards the spout since the start, `speed_mm_s` its speed, positive towards the spout.

    wagon shunter    after a dead time, dv/dt = clamp((v_ref - v) / TRACTION_S + w, -brake, +force / mass) + g s, where
                     w learns what the gradient s needs; v_ref = 0 brakes with the full brake
    rope winch       the drum follows v_ref; rope and wagon are a spring and a damper:
                     dv/dt = omega^2 (drum - wagon) + 2 zeta omega (v_drum - v) + g s - rolling resistance
    yard tractor     speeds are multiples of a step (the drive rounds down); AGVs are the same
    spout trolley    two axes that are moved to a position

s is positive where the track falls towards the spout. A vehicle that is to stand, and does, is held by its brake.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from random import Random

G_MM_S2 = 9810.0
STEP_S = 0.01  # of the integration
STANDS_MM_S = 2.0  # slower than this, a brake holds
TRACTION_S = 0.3  # how hard the shunter's drive corrects its speed
LEARN_S = 2.0  # and how soon it has learned the gradient
TRACTOR_S = 0.1


class VehicleKind(StrEnum):
    SHUNTER = "shunter"
    WINCH = "winch"
    TRACTOR = "tractor"


class _DeadTime:
    """What was given `dead_s` ago; 0 before that."""

    def __init__(self, dead_s: float) -> None:
        self._given = deque([0.0] * round(dead_s / STEP_S))

    def __call__(self, value: float) -> float:
        self._given.append(value)
        return self._given.popleft()


class Vehicle:
    """One of a `VehicleKind`. A subclass has the equations."""

    def __init__(self, dead_s: float, slope: float) -> None:
        self.way_mm = self.speed_mm_s = 0.0
        self._pull_mm_s2 = G_MM_S2 * slope
        self._delayed = _DeadTime(dead_s)

    def drive(self, reference_mm_s: float, dt_s: float) -> None:
        """With this speed reference for `dt_s`, a multiple of STEP_S."""
        for _ in range(round(dt_s / STEP_S)):
            self._step(self._delayed(reference_mm_s))

    def _step(self, reference_mm_s: float) -> None:
        raise NotImplementedError

    def _accelerate(self, by_mm_s2: float, *, brakes: bool) -> None:
        """`brakes`: to a standstill, and no farther."""
        before = self.speed_mm_s
        self.speed_mm_s += by_mm_s2 * STEP_S
        if brakes and before * self.speed_mm_s <= 0:
            self.speed_mm_s = 0.0
        self.way_mm += (before + self.speed_mm_s) / 2 * STEP_S


@dataclass(frozen=True, slots=True)
class ShunterData:
    """Of a wagon shunter with its wagon."""

    mass_t: float = 60.0
    lag_s: float = 1.0  # dead time and TRACTION_S
    force_kn: float = 6.0
    brake_mm_s2: float = 150.0  # on the level
    slope: float = 0.0


class Shunter(Vehicle):
    def __init__(self, data: ShunterData) -> None:
        super().__init__(data.lag_s - TRACTION_S, data.slope)
        self._traction_mm_s2 = 1000 * data.force_kn / data.mass_t
        self._brake_mm_s2 = data.brake_mm_s2
        self._learned_mm_s2 = 0.0

    def _step(self, reference_mm_s: float) -> None:
        speed = self.speed_mm_s
        if reference_mm_s == 0:
            self._learned_mm_s2 = 0.0
            if abs(speed) < STANDS_MM_S:
                self.speed_mm_s = 0.0
            else:
                self._accelerate(self._pull_mm_s2 - math.copysign(self._brake_mm_s2, speed), brakes=True)
            return
        error = (reference_mm_s - speed) / TRACTION_S
        wanted = error + self._learned_mm_s2
        applied = max(-self._brake_mm_s2, min(self._traction_mm_s2, wanted))
        if applied == wanted:  # a drive at its limit learns nothing
            self._learned_mm_s2 += error / LEARN_S * STEP_S
        self._accelerate(applied + self._pull_mm_s2, brakes=False)


@dataclass(frozen=True, slots=True)
class WinchData:
    """Of a winch with an endless rope under tension, which pulls both ways, and its wagon."""

    lag_s: float = 0.3
    acceleration_mm_s2: float = 150.0  # of the drum, both ways
    rope_hz: float = 0.8  # of the wagon on the rope
    damping: float = 0.15  # share of the critical one
    resistance_mm_s2: float = 15.0  # rolling
    slope: float = 0.0


class Winch(Vehicle):
    def __init__(self, data: WinchData) -> None:
        super().__init__(data.lag_s, data.slope)
        self._ramp_mm_s = data.acceleration_mm_s2 * STEP_S
        omega = 2 * math.pi * data.rope_hz
        self._spring, self._damper = omega**2, 2 * data.damping * omega
        self._resistance_mm_s2 = data.resistance_mm_s2
        self._drum_mm_s = 0.0
        self._stretch_mm = -self._pull_mm_s2 / self._spring  # drum before wagon; it hangs on the gradient

    def _step(self, reference_mm_s: float) -> None:
        change = reference_mm_s - self._drum_mm_s
        self._drum_mm_s += max(-self._ramp_mm_s, min(self._ramp_mm_s, change))
        self._stretch_mm += (self._drum_mm_s - self.speed_mm_s) * STEP_S
        rope = self._spring * self._stretch_mm + self._damper * (self._drum_mm_s - self.speed_mm_s)
        force = rope + self._pull_mm_s2
        held_mm_s2 = self._resistance_mm_s2 * (1 + 1e-9)  # where the two are equal, rounding does not move it
        if abs(self.speed_mm_s) < STANDS_MM_S and abs(force) <= held_mm_s2:
            self.speed_mm_s = 0.0
            return
        against = math.copysign(self._resistance_mm_s2, self.speed_mm_s or force)
        self._accelerate(force - against, brakes=abs(force) <= self._resistance_mm_s2)


@dataclass(frozen=True, slots=True)
class TractorData:
    """Of a yard tractor or AGV."""

    lag_s: float = 0.3  # dead time and TRACTOR_S
    step_mm_s: float = 20.0
    acceleration_mm_s2: float = 300.0
    brake_mm_s2: float = 400.0
    slope: float = 0.0  # its drive holds the speed; only its brake feels it


class Tractor(Vehicle):
    def __init__(self, data: TractorData) -> None:
        super().__init__(data.lag_s - TRACTOR_S, data.slope)
        self._data = data

    def _step(self, reference_mm_s: float) -> None:
        data = self._data
        wanted = math.trunc(reference_mm_s / data.step_mm_s) * data.step_mm_s
        error = (wanted - self.speed_mm_s) / TRACTOR_S
        brake = data.brake_mm_s2 - self._pull_mm_s2
        if wanted == 0 and abs(self.speed_mm_s) < STANDS_MM_S:
            self.speed_mm_s = 0.0
            return
        self._accelerate(max(-brake, min(data.acceleration_mm_s2, error)), brakes=wanted == 0)


class SpoutTrolley:
    """Two axes, mm, each moved to a position at up to `speed_mm_s`, from `lag_s` after it was given."""

    def __init__(self, speed_mm_s: float = 50.0, lag_s: float = 0.3, step_mm: float = 0.5) -> None:
        self.x_mm = self.y_mm = 0.0
        self._x, self._y = _DeadTime(lag_s), _DeadTime(lag_s)
        self._way_mm, self._step_mm = speed_mm_s * STEP_S, step_mm

    def move(self, x_mm: float, y_mm: float, dt_s: float) -> None:
        """Towards this position for `dt_s`, a multiple of STEP_S."""
        for _ in range(round(dt_s / STEP_S)):
            self.x_mm = self._moved(self.x_mm, self._x(x_mm))
            self.y_mm = self._moved(self.y_mm, self._y(y_mm))

    def _moved(self, at_mm: float, wanted_mm: float) -> float:
        wanted_mm = round(wanted_mm / self._step_mm) * self._step_mm
        return at_mm + max(-self._way_mm, min(self._way_mm, wanted_mm - at_mm))


def drive_keys(kind: VehicleKind) -> dict[str, float]:
    """[drive] as one would configure it for any of this kind: the brake downhill, the longest lag, and from the newest
    image until FB_Approach's life sign ends, 0.6 s."""
    match kind:
        case VehicleKind.SHUNTER:
            own = {"brake_mm_s2": 100.0, "lag_s": 1.5, "acceleration_mm_s2": 60.0}
        case VehicleKind.WINCH:
            own = {"brake_mm_s2": 120.0, "lag_s": 0.6}
        case VehicleKind.TRACTOR:
            own = {"brake_mm_s2": 300.0, "lag_s": 0.4, "acceleration_mm_s2": 200.0, "min_speed_mm_s": 25.0}
    return {"latency_s": 0.6, **own}


def typical(kind: VehicleKind) -> Vehicle:
    """One of this kind on the level, in the middle of its ranges."""
    match kind:
        case VehicleKind.SHUNTER:
            return Shunter(ShunterData())
        case VehicleKind.WINCH:
            return Winch(WinchData())
        case VehicleKind.TRACTOR:
            return Tractor(TractorData())


def drawn(kind: VehicleKind, plant: Random, wagon: Random) -> Vehicle:
    """One of this kind: lag and gradient drawn by `plant`, what changes from wagon to wagon by `wagon`."""
    slope = plant.uniform(-0.005, 0.005)
    match kind:
        case VehicleKind.SHUNTER:
            return Shunter(ShunterData(mass_t=wagon.uniform(20, 90), lag_s=plant.uniform(0.5, 1.5), slope=slope))
        case VehicleKind.WINCH:
            return Winch(WinchData(rope_hz=wagon.uniform(0.5, 1.2), damping=wagon.uniform(0.08, 0.25), slope=slope))
        case VehicleKind.TRACTOR:
            return Tractor(TractorData(step_mm_s=plant.choice((10.0, 20.0, 25.0)), slope=slope))


def worst(kind: VehicleKind) -> Vehicle:
    """The one that stops last: the longest lag, downhill, the heaviest or softest."""
    match kind:
        case VehicleKind.SHUNTER:
            return Shunter(ShunterData(mass_t=90, lag_s=1.5, slope=0.005))
        case VehicleKind.WINCH:
            return Winch(WinchData(rope_hz=0.5, damping=0.08, slope=0.005))
        case VehicleKind.TRACTOR:
            return Tractor(TractorData(step_mm_s=25.0, slope=0.005))
