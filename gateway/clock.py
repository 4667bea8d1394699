"""The only import of `time`. Everything else is handed a clock or a time in nanoseconds.

Monotonic time decides; wall time is only published. CLOCK_BOOTTIME is one clock for all processes of a machine, so a
frame stamped in the vision process can be aged in the main process. Unlike CLOCK_MONOTONIC it goes on while the machine
is suspended: values from before are old afterwards.
"""

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import asyncio


def machine_ns() -> int:
    """CLOCK_BOOTTIME: since the machine's start, ns, the time it was suspended included."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def suspended_ns() -> int:
    """How long the machine has been suspended since its start, ns: so far CLOCK_MONOTONIC, a driver's clock, is
    behind."""
    return max(0, machine_ns() - time.monotonic_ns())


class Clock(Protocol):
    """A source of time. All durations are seconds of this clock, all instants its nanoseconds."""

    def now_ns(self) -> int:
        """Monotonic time, ns; never steps back, origin arbitrary."""

    def wall_ns(self) -> int:
        """Unix time, ns; may step: for publishing, and to compare with a clock that is set by NTP, too."""

    async def sleep(self, seconds: float) -> None:
        """Yield to the event loop for `seconds` of this clock."""

    def block(self, seconds: float) -> None:
        """Block the calling thread for `seconds` of this clock; never call it on the event loop."""

    def timeout(self, seconds: float) -> "asyncio.Timeout":
        """`asyncio.timeout` in seconds of this clock."""


@dataclass(frozen=True, slots=True)
class SystemClock:
    """The machine's clock, optionally running `speed` times faster for simulation. Children are sent it."""

    speed: float = 1.0
    origin_ns: int = field(default_factory=machine_ns)
    wall_origin_ns: int = field(default_factory=time.time_ns)

    def now_ns(self) -> int:
        now_ns = machine_ns()
        if self.speed == 1.0:
            return now_ns
        return self.origin_ns + int((now_ns - self.origin_ns) * self.speed)

    def wall_ns(self) -> int:
        # At true speed the published time follows the machine's, NTP corrections included.
        return time.time_ns() if self.speed == 1.0 else self.wall_origin_ns + self.now_ns() - self.origin_ns

    async def sleep(self, seconds: float) -> None:
        import asyncio  # noqa: PLC0415 - 3 MB, of which vision processes and recorder have no use

        await asyncio.sleep(seconds / self.speed)

    def block(self, seconds: float) -> None:
        time.sleep(max(0.0, seconds) / self.speed)

    def timeout(self, seconds: float) -> "asyncio.Timeout":
        import asyncio  # noqa: PLC0415 - as above

        return asyncio.timeout(seconds / self.speed)
