"""The truck that a driver drives: along the line of sight, on a slope, through pedals that answer late. Pure.

    du/dt = (u_wanted - u) / PEDAL_S           what the pedals do, mm/s^2, follows what the foot wants
    u_wanted = clamp((v_wanted - v) / SPEED_S + w, -brake, +drive);    -brake against the motion where v_wanted = 0
    dw/dt = (v_wanted - v) / SPEED_S / SLOPE_S                         he learns what the slope needs
    dv/dt = u + g s                                                    s: slope, positive falls towards the spout

`v` is positive towards the spout. A truck that is to stand, and does, is held by its brake: it does not roll then. A
direction is changed at a standstill only, and takes `gear_s`. What stands before the spout ends its way.
"""

from bisect import bisect_right
from dataclasses import dataclass, field

from gateway.sim.scenario import Scenario
from gateway.sim.world import Motion, Vector, World

G_MM_S2 = 9810.0
PEDAL_S = 0.25  # air brakes and a torque converter
SPEED_S = 0.5  # how hard a driver corrects his speed
SLOPE_S = 2.0
END_MM = 45.0  # the marker can not come nearer to the ranger
STANDS_MM_S = 3.0  # slower than this, the brake holds


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Of one truck at one bay."""

    drive_mm_s2: float = 400.0
    brake_mm_s2: float = 1000.0
    gear_s: float = 2.0
    slope: float = 0.0  # 0.01: 1 cm down to the spout for each metre


@dataclass(slots=True)
class Truck:
    """Moves with each `step`."""

    dynamics: Dynamics
    distance_mm: float
    speed_mm_s: float = 0.0
    gear: int = 1  # 1: towards the spout, -1: away from it
    changes: int = 0  # of direction
    starts: int = 0  # from a standstill
    _pedal_mm_s2: float = 0.0
    _learned_mm_s2: float = 0.0
    _in_gear_s: float = 0.0  # time until the gear is in
    _held: bool = True

    def step(self, wanted_mm_s: float, brake_off: bool, dt_s: float) -> None:
        """`wanted_mm_s`: speed towards the spout. `brake_off`: nobody holds the truck."""
        dynamics = self.dynamics
        self._in_gear_s = max(0.0, self._in_gear_s - dt_s)
        gear = self.gear if not wanted_mm_s else (1 if wanted_mm_s > 0 else -1)
        if gear != self.gear:
            if self._held:
                self.gear, self._in_gear_s, self.changes = gear, dynamics.gear_s, self.changes + 1
            wanted_mm_s = 0.0
        if self._in_gear_s > 0:
            wanted_mm_s = 0.0
        if not wanted_mm_s and not brake_off and abs(self.speed_mm_s) < STANDS_MM_S:
            self.speed_mm_s = self._pedal_mm_s2 = self._learned_mm_s2 = 0.0
            self._held = True
            return
        if self._held:
            self._held = False
            self.starts += wanted_mm_s != 0.0
        wanted_mm_s2 = 0.0 if brake_off else self._wanted_mm_s2(wanted_mm_s, dt_s)
        self._pedal_mm_s2 += (wanted_mm_s2 - self._pedal_mm_s2) * min(1.0, dt_s / PEDAL_S)
        before_mm_s = self.speed_mm_s
        self.speed_mm_s += (self._pedal_mm_s2 + G_MM_S2 * dynamics.slope) * dt_s
        if not wanted_mm_s and not brake_off and before_mm_s * self.speed_mm_s < 0:
            self.speed_mm_s = 0.0  # a brake does not push
        self.distance_mm -= self.speed_mm_s * dt_s
        if self.distance_mm < END_MM:
            self.distance_mm, self.speed_mm_s = END_MM, 0.0

    def _wanted_mm_s2(self, wanted_mm_s: float, dt_s: float) -> float:
        """Drive along the gear, brake against the motion."""
        dynamics, speed = self.dynamics, self.speed_mm_s
        if not wanted_mm_s:
            return -dynamics.brake_mm_s2 if speed > 0 else dynamics.brake_mm_s2
        error = (wanted_mm_s - speed) / SPEED_S
        self._learned_mm_s2 += error / SLOPE_S * dt_s
        along = self.gear * (error + self._learned_mm_s2)
        return self.gear * max(-dynamics.brake_mm_s2, min(dynamics.drive_mm_s2, along))


@dataclass
class DrivenWorld(World):
    """The simulator's world, with a truck that stands where it was driven to instead of on a plan."""

    scenario: Scenario
    _times: list[float] = field(default_factory=list)
    _places: list[tuple[float, float]] = field(default_factory=list)  # distance, speed

    def __post_init__(self) -> None:
        World.__init__(self, self.scenario)

    def drove(self, t_s: float, distance_mm: float, speed_mm_s: float) -> None:
        """Times ascend."""
        self._times.append(t_s)
        self._places.append((distance_mm, speed_mm_s))

    def _here(self, t_s: float) -> tuple[Vector, float, int]:
        at = bisect_right(self._times, t_s)
        if at == 0:
            return super()._here(-1.0)
        distance_mm, speed_mm_s = self._places[at - 1]
        distance_mm -= speed_mm_s * (t_s - self._times[at - 1])
        start = self._start
        place = Vector(start.x, start.y, distance_mm)
        drive = min(1.0, abs(speed_mm_s) / 200.0)
        return self._shaken(place, drive, t_s), abs(speed_mm_s), -1

    def _phase(self, speed: float, leg: int) -> Motion:
        return Motion.HOLD if speed <= 0 else Motion.APPROACH
