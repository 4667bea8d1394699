"""What an HC-SR04 makes of a true distance: jitter, steps, lost echoes and the limits of its range. Pure and seeded.

The datasheet promises 3 mm and 2 cm to 4 m; real modules step by about 4 mm (their own timer) and lose an echo now and
then. With the default errors no reading is further than 12 mm from the truth; the paper saw up to 17 mm.
"""

from dataclasses import dataclass
from random import Random

from gateway.ranger.hcsr04.protocol import BURST_NS, NO_FLAGS, Flags
from gateway.ranger.hcsr04.session import FARTHEST_MM, NEAREST_MM, speed_of_sound_m_s

NO_ECHO_NS = 38_000_000
"""Width of the ECHO pulse without an echo (datasheet)."""
JITTER_LIMIT = 4.0
"""In standard deviations: a module does not stray without bound."""


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """How imperfect the module is. All zero: exact to the timer tick."""

    jitter_mm: float = 2.5  # standard deviation
    step_mm: float = 4.0  # readings have such steps
    dropout: float = 0.005  # probability of a lost echo


@dataclass(frozen=True, slots=True)
class Echo:
    """One cycle: the ECHO pulse in 0.5 us ticks, its flags, and when it fell, counted from the trigger."""

    ticks: int
    flags: Flags
    fell_ns: int


def ticks_of(mm: float, air_c: float) -> int:
    """There and back, in 0.5 us ticks; the inverse of session.distance_mm."""
    return round(mm * 4000 / speed_of_sound_m_s(air_c))


def flight_ns(mm: float, air_c: float) -> int:
    """There and back."""
    return round(mm * 2_000_000 / speed_of_sound_m_s(air_c))


def measure(true_mm: float | None, air_c: float, errors: SensorErrors, random: Random) -> Echo:
    """One cycle. `true_mm` None: nothing in the beam. Draws the same number of random values in every case."""
    lost = random.random() < errors.dropout
    stray = max(-JITTER_LIMIT, min(JITTER_LIMIT, random.gauss(0.0, 1.0)))
    if true_mm is None or lost:
        return no_echo()
    mm = max(0.0, true_mm + stray * errors.jitter_mm)
    if errors.step_mm:
        mm = round(mm / errors.step_mm) * errors.step_mm
    return echo_at(mm, air_c)


def echo_at(mm: float, air_c: float) -> Echo:
    """The cycle of a module that measured `mm`, flagged as the firmware flags it."""
    flags = NO_FLAGS
    if mm < NEAREST_MM:
        flags = Flags.TOO_NEAR
    elif mm > FARTHEST_MM:
        flags = Flags.TOO_FAR
    return Echo(ticks_of(mm, air_c), flags, BURST_NS + flight_ns(mm, air_c))


def no_echo() -> Echo:
    return Echo(0, Flags.NO_ECHO, BURST_NS + NO_ECHO_NS)
