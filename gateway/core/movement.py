"""Distance and closing speed of a vehicle at any time, from a ranger's readings with their own ages; and what the
drive's setpoint must remember. Pure.

A Kalman filter with two states: the distance, and by how much the vehicle is faster than its setpoint was a while ago.
The variances grow with the time since the newest reading, by accelerations that are not known.
"""

from dataclasses import dataclass, field
from math import sqrt

from gateway.core.setpoint_history import SetpointHistory
from gateway.durations import NS_PER_S

NOISE_MM = 2.5  # standard deviation of a reading: the ranger's steps and noise, after its median
START_MM_S = 1000.0  # of the speed, while only one reading is known
KNOWN_MM_S = 50.0  # the speed is known when its standard deviation is less
JUMP_MM = 40.0  # a reading that differs more from what was expected is of something else


@dataclass(frozen=True, slots=True)
class Movement:
    """What is known at `t_ns` (monotonic), the time of a reading or one since."""

    t_ns: int
    distance_mm: float
    excess_mm_s: float = 0.0  # closing speed less the setpoint that acts
    distance_var: float = NOISE_MM**2  # mm2
    covariance: float = 0.0  # mm2/s, of distance and excess
    speed_var: float = START_MM_S**2  # mm2/s2

    @property
    def distance_sd_mm(self) -> float:
        return sqrt(max(0.0, self.distance_var))

    @property
    def speed_sd_mm_s(self) -> float:
        return sqrt(max(0.0, self.speed_var))

    @property
    def known(self) -> bool:
        return self.speed_sd_mm_s <= KNOWN_MM_S


@dataclass(frozen=True, slots=True)
class Cut:
    """The setpoint became 0 for the vehicle to run out. `moving`: it drove as it was told."""

    t_ns: int
    distance_mm: float
    speed_mm_s: float
    moving: bool


@dataclass(frozen=True, slots=True)
class Told:
    """By how much what was set may have moved the vehicle since it was here. `t_ns`: of the newest reading."""

    distance_mm: float
    t_ns: int
    by_mm: tuple[float, ...] = (0.0, 0.0, 0.0)  # acting at once, and by half and all of the longest delay later

    def added(self, history: SetpointHistory, t_ns: int, delay_s: float) -> "Told":
        late_s = (0.0, delay_s / 2, delay_s)
        by_mm = (mm + history.moved_mm(self.t_ns, t_ns, s) for mm, s in zip(self.by_mm, late_s, strict=True))
        return Told(self.distance_mm, t_ns, tuple(by_mm))


@dataclass(frozen=True, slots=True)
class Same:
    """Pictures in a row that show the same R. Times of the first and the newest."""

    radius_px: float
    first_ns: int
    t_ns: int
    pictures: int = 1


@dataclass(frozen=True, slots=True)
class DriveMemory:
    """What the setpoint must remember between steps. Times monotonic ns; None: not so."""

    history: SetpointHistory = field(default_factory=SetpointHistory)
    movement: Movement | None = None  # at the newest good distance
    still_mm: float | None = None  # the vehicle has been here
    still_ns: int = 0  # since then
    speed_mm_s: float = 0.0  # the setpoint
    rise_mm_s2: float = 0.0  # its acceleration
    run_mm_s: float | None = None  # creep speed of the run that goes on
    peak_mm_s: float = 0.0  # the highest setpoint of the run
    peak_ns: int = 0  # then it was near that for the last time
    begun: tuple[int, float, float] | None = None  # t_ns, distance mm, setpoint: since then the lag is measured
    cut: Cut | None = None
    there: bool = False  # it stood at its place, and has not left it since
    unmoved: Told | None = None  # no reading since then is another
    same: Same | None = None
    frozen: bool = False  # both sensors, so it seems
    tries: int = 0  # runs of this approach that have ended
    tried_mm: float = 0.0  # the distance at which the last one did
    lag_s: float | None = None  # the vehicle follows its setpoint so late
    slips_s: tuple[float, ...] = ()  # so late it came to a standstill, newest last

    def resumed(self) -> "DriveMemory":
        """After a time in which nothing was decided."""
        return DriveMemory(tries=self.tries, tried_mm=self.tried_mm, lag_s=self.lag_s, slips_s=self.slips_s)


def distance_at(movement: Movement, t_ns: int, moved_mm: float) -> float:
    """Predicted to `t_ns`, mm. `moved_mm`: by the setpoint meanwhile."""
    return movement.distance_mm - moved_mm - movement.excess_mm_s * ((t_ns - movement.t_ns) / NS_PER_S)


def at(movement: Movement, t_ns: int, moved_mm: float, acceleration_sd: float) -> Movement:
    """Likewise. `acceleration_sd`: standard deviation of the accelerations that may act, mm/s2."""
    dt = (t_ns - movement.t_ns) / NS_PER_S
    speed_var = (acceleration_sd * dt) ** 2
    return Movement(
        t_ns,
        movement.distance_mm - moved_mm - movement.excess_mm_s * dt,
        movement.excess_mm_s,
        movement.distance_var - 2 * dt * movement.covariance + dt * dt * (movement.speed_var + speed_var / 4),
        movement.covariance - dt * (movement.speed_var + speed_var / 2),
        movement.speed_var + speed_var,
    )


def measured(
    movement: Movement | None, distance_mm: float, t_ns: int, moved_mm: float, acceleration_sd: float
) -> Movement:
    """After a good reading. One that is older than the newest, or jumps, is where the filter begins anew."""
    if movement is None or t_ns < movement.t_ns:
        return Movement(t_ns, distance_mm)
    before = at(movement, t_ns, moved_mm, acceleration_sd)
    differs_mm = distance_mm - before.distance_mm
    if abs(differs_mm) > JUMP_MM + 3 * before.distance_sd_mm:
        return Movement(t_ns, distance_mm)
    variance = before.distance_var + NOISE_MM**2
    of_distance, of_speed = before.distance_var / variance, before.covariance / variance
    return Movement(
        t_ns,
        before.distance_mm + of_distance * differs_mm,
        before.excess_mm_s + of_speed * differs_mm,
        before.distance_var * (1 - of_distance),
        before.covariance * (1 - of_distance),
        before.speed_var - of_speed * before.covariance,
    )
