"""What sensors that send a plain number have in common: number to distance, numbers that are none, silence. Sans-IO.

The methods are described in gateway/ranger/contract.py.
"""

import math

from gateway.config import RangerConfig
from gateway.core import details
from gateway.core.readings import Quality, RangeReading, RangeStats
from gateway.durations import NS_PER_S
from gateway.ranger.conditioning import Conditioner

NS_PER_MS = 1_000_000
SILENCE_NS = NS_PER_S
"""No number for this time: reported."""
SAME = 1e-6
"""Numbers that differ by less, relatively, are one: a float32 has no more digits."""


class NumberSession:
    """The state of one sensor in the gateway. Its counters outlive connections, the rest does not."""

    def __init__(self, config: RangerConfig, identity: str) -> None:
        number = config.number
        self.period_ns = round(number.period_ms * NS_PER_MS)
        self._delay_ns = round(number.delay_ms * NS_PER_MS)
        self._number = number
        self._name = identity
        self._conditioner = Conditioner(config, self.period_ns)
        self._seq = 0
        self._start(0)

    def _start(self, now_ns: int) -> None:
        self._heard_ns = now_ns  # the newest number; none yet: since when one is expected
        self._measured = False
        self._last: float | None = None
        self._changed_ns = now_ns
        self._trouble = ""
        """Why the newest bytes gave no number; empty: there were none."""

    @property
    def identity(self) -> str:
        return self._name if self._measured else ""

    @property
    def stats(self) -> RangeStats:
        return self._conditioner.stats

    def opened(self, now_ns: int) -> list[RangeReading]:
        self._start(now_ns)
        self._conditioner.opened()
        return self._fault(Quality.WAITING, now_ns, details.SENSOR_PORT_OPEN())

    def lost(self, now_ns: int, detail: str) -> RangeReading:
        return self._conditioner.lost(now_ns, detail)

    def tick(self, now_ns: int) -> list[RangeReading]:
        self._conditioner.update_rate(now_ns)
        silent_ns = now_ns - self._heard_ns
        if silent_ns >= max(SILENCE_NS, 3 * self.period_ns):
            trouble = self._trouble or details.SENSOR_NOTHING()
            return self._fault(Quality.STALE, now_ns, details.SENSOR_FOR(trouble, f"{silent_ns / NS_PER_S:.0f}"))
        if not self._measured:
            return self._fault(Quality.WAITING, now_ns, self._trouble or details.WAITING_SENSOR())
        return []

    def _unusable(self, trouble: str, *, damaged: int = 0, gaps: int = 0, rejected: int = 0) -> None:
        """What was received, or was not, gives no number."""
        self._trouble = trouble
        self._conditioner.count(damaged=damaged, gaps=gaps, rejected=rejected)
        if gaps:
            self._conditioner.gap()

    def _received(self, number: float, sent_ns: int, arrived_ns: int, invalid: str = "") -> list[RangeReading]:
        """A number, as sent at `sent_ns` or later. `invalid`: why the device itself calls it so."""
        self._seq = (self._seq + 1) & 0xFFFF
        self._heard_ns, self._measured, self._trouble = arrived_ns, True, ""
        if number != self._last:
            self._last, self._changed_ns = number, arrived_ns
        self._conditioner.arrived(arrived_ns)
        self._conditioner.count(lines=1)
        distance_mm = number * self._number.mm_per_unit + self._number.offset_mm
        quality = Quality.LINK_DOWN if invalid else self._quality(number, distance_mm)
        detail = invalid or ("" if quality is Quality.GOOD else details.SENSOR_SENDS(f"{number:g}"))
        unchanged_ns, limit_s = arrived_ns - self._changed_ns, self._number.unchanged_s
        if quality is Quality.GOOD and limit_s and unchanged_ns > limit_s * NS_PER_S:
            quality, detail = Quality.STUCK, details.SENSOR_STUCK(f"{number:g}", f"{unchanged_ns / NS_PER_S:.0f}")
        return self._conditioner.measured(distance_mm, quality, sent_ns - self._delay_ns, self._seq, detail)

    def _quality(self, number: float, distance_mm: float) -> Quality:
        meaning = self._number
        if any(math.isclose(number, one, rel_tol=SAME) for one in meaning.no_echo):
            return Quality.NO_ECHO
        if meaning.fault_below is not None and not number >= meaning.fault_below:
            return Quality.LINK_DOWN
        if meaning.fault_above is not None and not number <= meaning.fault_above:
            return Quality.LINK_DOWN
        if not distance_mm >= meaning.nearest_mm:  # NaN, too
            return Quality.TOO_NEAR
        return Quality.TOO_FAR if distance_mm > meaning.farthest_mm else Quality.GOOD

    def _fault(self, quality: Quality, now_ns: int, detail: str) -> list[RangeReading]:
        return self._conditioner.fault(quality, now_ns, self._seq, detail)
