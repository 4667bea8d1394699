"""When the file of an outbox is written: changes that follow each other closely go to the disk together. Pure.

A commit makes the disk write some 20 kB, whatever is in it, and nearly all events are acknowledged by the broker before
they must be there. So a change waits for DELAY_S. Where one write follows the other for minutes (a sensor that flickers
while the broker is away), there is one in PERIOD_S, after WRITES of them.
"""

from dataclasses import dataclass

from gateway.durations import NS_PER_S

DELAY_S = 0.25
PERIOD_S = 5.0
WRITES = 40
AT_ONCE = 512  # changes; so many wait for nothing, so that the journal never fills up


@dataclass(slots=True)
class WritePace:
    """Times: monotonic ns."""

    _left: float = WRITES
    _counted_ns: int | None = None

    def wait_s(self, oldest_ns: int, now_ns: int) -> float:
        """How long the changes wait on, of which the oldest is of `oldest_ns`; 0: they are to be written."""
        if self._counted_ns is not None:
            self._left = min(WRITES, self._left + (now_ns - self._counted_ns) / NS_PER_S / PERIOD_S)
        self._counted_ns = now_ns
        return max(0.0, DELAY_S - (now_ns - oldest_ns) / NS_PER_S, (1 - self._left) * PERIOD_S)

    def wrote(self) -> None:
        self._left = max(0.0, self._left - 1)
