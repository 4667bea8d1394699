"""A camera's exposure time and gain, and what it can be set to. Pure.

Both multiply the picture's brightness: the *amount* of an exposure is its time, us, times its gain as a factor.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Exposure:
    """What a camera is set to."""

    time_us: float
    gain_db: float = 0.0

    @property
    def amount(self) -> float:
        """The time that would give the same brightness without gain, us."""
        return self.time_us * 10 ** (self.gain_db / 20)


@dataclass(frozen=True, slots=True)
class ExposureRules:
    """What the configuration has to say of a camera whose exposure is controlled."""

    max_time_us: float
    gain_range_db: tuple[float, float] | None = None  # what the driver's least and greatest gain amount to


@dataclass(frozen=True, slots=True)
class ExposureLimits:
    """Least and most; both ends count. A step of 0: any value in between. A gain that can't be set: 0 to 0."""

    time_us: tuple[float, float]
    time_step_us: float = 0.0
    gain_db: tuple[float, float] = (0.0, 0.0)
    gain_step_db: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.time_us[0] <= self.time_us[1] < math.inf):
            raise ValueError(f"exposure times from {self.time_us[0]:g} to {self.time_us[1]:g} us")
        if not (-math.inf < self.gain_db[0] <= self.gain_db[1] < math.inf):
            raise ValueError(f"gains from {self.gain_db[0]:g} to {self.gain_db[1]:g} dB")

    def setting(self, amount: float) -> Exposure:
        """The settings nearest to this amount, 0 and infinity included: as much time as is allowed, since gain adds
        noise; then gain."""
        gain_least, gain_most = self.gain_db
        wanted_us = amount / 10 ** (gain_least / 20)
        time_us = _stepped(wanted_us, self.time_us, self.time_step_us)
        if gain_most > gain_least and time_us > wanted_us and time_us - self.time_step_us >= self.time_us[0]:
            time_us -= self.time_step_us  # the gain makes up for what is missing
        gain_db = 20 * math.log10(max(amount, 1e-9) / time_us)
        return Exposure(time_us, _stepped(gain_db, self.gain_db, self.gain_step_db))

    def below(self, exposure: Exposure) -> Exposure:
        """The next darker settings; the least ones: themselves."""
        if exposure.gain_db > self.gain_db[0]:
            lower_db = exposure.gain_db - max(self.gain_step_db, 0.5)
            return Exposure(exposure.time_us, max(self.gain_db[0], lower_db))
        lower_us = min(exposure.time_us - self.time_step_us, 0.9 * exposure.time_us)
        return Exposure(_stepped(lower_us, self.time_us, self.time_step_us), self.gain_db[0])


def _stepped(value: float, limits: tuple[float, float], step: float) -> float:
    """The nearest value that can be set, counted in steps from the least."""
    least, most = limits
    value = min(max(value, least), most)
    if step <= 0:
        return value
    return min(most, least + step * min(round((value - least) / step), math.floor((most - least) / step + 1e-9)))
