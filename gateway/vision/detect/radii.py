"""Which radii the marker can have at the truck's distance: sent by the main process to the vision processes.

It holds for a moment only and restricts the search, nothing else: without it every radius is possible.
"""

from dataclasses import dataclass
from math import inf

from gateway.processes.codec import Message

LIFE_NS = 500_000_000
PERIOD_NS = 100_000_000  # no more often than that
CHANGE = 0.05  # of either limit: less is nothing new


class MarkerRadii(Message, frozen=True):
    """To a vision process: in frames captured until then (monotonic) the marker's radius lies between these, px."""

    low_px: float
    high_px: float
    until_ns: int

    def at(self, t_ns: int) -> tuple[float, float] | None:
        """Both limits, for a frame of that time; None: unknown. An invalid range (NaN, upside down) limits
        nothing."""
        if t_ns > self.until_ns or not 0 < self.low_px <= self.high_px < inf:
            return None
        return self.low_px, self.high_px


WITHDRAWN = MarkerRadii(0.0, 0.0, 0)


@dataclass(slots=True)
class RadiiUpdates:
    """Of what is known again and again, what is worth a message: what is new, and what would else expire."""

    _sent: MarkerRadii = WITHDRAWN
    _sent_ns: int = 0

    def due(self, radii_px: tuple[float, float] | None, now_ns: int) -> MarkerRadii | None:
        """`radii_px` None: no longer known."""
        held = self._sent.at(now_ns)
        if radii_px is None:
            self._sent = WITHDRAWN
            return WITHDRAWN if held is not None else None
        age_ns = now_ns - self._sent_ns
        if held is not None and (age_ns < PERIOD_NS or (age_ns < LIFE_NS // 2 and not _differ(held, radii_px))):
            return None
        self._sent, self._sent_ns = MarkerRadii(*radii_px, now_ns + LIFE_NS), now_ns
        return self._sent


def _differ(held: tuple[float, float], radii_px: tuple[float, float]) -> bool:
    return any(abs(new - old) > CHANGE * old for old, new in zip(held, radii_px, strict=True))
