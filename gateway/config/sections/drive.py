"""`[drive]`: a drive that moves the vehicle to its place by the gateway's speed setpoint. Pure."""

from collections.abc import Iterator
from math import floor, sqrt

from pydantic import Field

from gateway.config.sections.common import MAX_DISTANCE_MM
from gateway.config.strict.section import Section


class DriveConfig(Section):
    """The speed setpoint of a drive that moves the vehicle. It follows stop and may_move, and decides neither."""

    max_speed_mm_s: float = Field(500.0, ge=1, le=3000, description="never faster")
    creep_speed_mm_s: float = Field(30.0, ge=1, le=500, description="speed of the last way before the place")
    min_speed_mm_s: float = Field(10.0, ge=0, le=500, description="the drive does not turn below it: never between")
    acceleration_mm_s2: float = Field(
        100.0, ge=5, le=2000, description="of a rising setpoint; towards the place it falls as the worst brake can do"
    )
    jerk_mm_s3: float = Field(200.0, ge=5, le=20_000, description="of a rising setpoint: change of its acceleration")
    brake_mm_s2: float = Field(
        150.0, ge=5, le=5000, description="deceleration of the worst brake: heaviest vehicle, wet rail, downhill"
    )
    lag_s: float = Field(0.5, ge=0, le=10, description="longest time from the drive's setpoint to the motion")
    latency_s: float = Field(
        0.6, ge=0, le=5, description="longest time until the drive is stopped: the PLC's life sign, network, two cycles"
    )
    dead_band_mm: float = Field(10.0, ge=1, le=500, description="so near to the place is at the place")
    place_mm: float = Field(
        10.0, ge=0, le=MAX_DISTANCE_MM, description="so far past where D becomes 1 the vehicle is to stand"
    )

    @property
    def delay_s(self) -> float:
        """Longest time from a setpoint to the motion that follows it."""
        return self.lag_s + self.latency_s

    def stopping_mm(self, speed_mm_s: float, age_s: float) -> float:
        """Way from now to standstill with the worst brake, for a speed that is known from `age_s` ago."""
        return speed_mm_s * (self.delay_s + age_s) + speed_mm_s * speed_mm_s / (2 * self.brake_mm_s2)

    def faults(self, overshoot_mm: float, deadline_s: float) -> Iterator[tuple[str, str]]:
        """What can't work: key and why. `overshoot_mm`: of guidance; `deadline_s`: of a distance."""
        if self.creep_speed_mm_s > self.max_speed_mm_s:
            yield "creep_speed_mm_s", f"must be at most max_speed_mm_s, {self.max_speed_mm_s:g}"
        if self.min_speed_mm_s > self.creep_speed_mm_s:
            yield "min_speed_mm_s", f"must be at most creep_speed_mm_s, {self.creep_speed_mm_s:g}"
        if self.dead_band_mm > overshoot_mm:
            yield "dead_band_mm", f"must be at most guidance.overshoot_mm, {overshoot_mm:g}"
        elif self.place_mm + self.dead_band_mm > overshoot_mm:
            yield (
                "place_mm",
                f"must be at most {overshoot_mm - self.dead_band_mm:g}: guidance.overshoot_mm, {overshoot_mm:g}, less "
                f"dead_band_mm, {self.dead_band_mm:g}",
            )
        elif (way_mm := self.stopping_mm(self.creep_speed_mm_s, deadline_s)) > overshoot_mm - self.place_mm:
            delay_s, left_mm = self.delay_s + deadline_s, overshoot_mm - self.place_mm
            most_mm_s = self.brake_mm_s2 * (sqrt(delay_s**2 + 2 * left_mm / self.brake_mm_s2) - delay_s)
            yield (
                "creep_speed_mm_s",
                f"must be at most {floor(most_mm_s)}: at {self.creep_speed_mm_s:g} mm/s a vehicle needs {way_mm:.0f} "
                "mm to stop, by lag_s, latency_s, fusion.range_deadline_s and brake_mm_s2; from the place to "
                f"guidance.overshoot_mm are {left_mm:g} mm",
            )


class RecipeDrive(Section):
    """What a recipe changes in [drive]; absent keys stay as they are. Without [drive] it has no effect."""

    max_speed_mm_s: float | None = Field(None, ge=1, le=3000, description="never faster")
    creep_speed_mm_s: float | None = Field(None, ge=1, le=500, description="speed of the last way before the place")
    dead_band_mm: float | None = Field(None, ge=1, le=500, description="so near to the place is at the place")
    place_mm: float | None = Field(
        None, ge=0, le=MAX_DISTANCE_MM, description="so far past where D becomes 1 the vehicle is to stand"
    )

    def of(self, drive: DriveConfig) -> DriveConfig:
        return drive.model_copy(update=self.model_dump(exclude_none=True))
