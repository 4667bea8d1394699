"""The interface of every ranger: a session that makes readings of bytes, and a port that carries the bytes.

A session does no IO and reads no clock: bytes and monotonic times in, `RangeReading`s out, each with its
quality, the time of the echo and the counters of damaged, missing and rejected measurements. A thread, a port and the
event loop come from gateway/ranger/ranger_service.py. Gate, median and repeated faults are the same for all:
conditioning.py.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from gateway.config import RangerConfig
from gateway.core.readings import RangeReading, RangeStats
from gateway.core.relay import RelayDecision


class RangerSession(Protocol):
    """The state of one ranger in the gateway. It outlives connections; so do its counters."""

    @property
    def identity(self) -> str:
        """Name and version of the device on this connection; empty: not known (yet)."""

    @property
    def stats(self) -> RangeStats:
        """The counters so far."""

    def opened(self, now_ns: int) -> list[RangeReading]:
        """A connection is open and its input was flushed."""

    def request(self, now_ns: int) -> bytes:
        """What to send to the device now; empty: nothing. Called before every read."""

    def feed(self, data: bytes, arrived_ns: int) -> list[RangeReading]:
        """Bytes that were complete at `arrived_ns`; empty where none arrived."""

    def tick(self, now_ns: int) -> list[RangeReading]:
        """Time passes, about every 0.1 s: silence and lasting faults are reported."""

    def lost(self, now_ns: int, detail: str) -> RangeReading:
        """The port cannot be opened or was lost."""


@runtime_checkable
class RelaySession(Protocol):
    """A session whose device has a relay."""

    def decided(self, decision: RelayDecision) -> None:
        """What the relay is to do, after each state of the bay. Called by another thread than the other methods."""


class Connection(Protocol):
    """An open port, used by one thread. All methods raise LinkError when it is lost."""

    def read(self) -> bytes:
        """What has arrived; returns within about 0.1 s, also without any."""

    def write(self, data: bytes) -> None: ...

    def close(self) -> None:
        """Never raises."""


@dataclass(frozen=True, slots=True)
class RangerType:
    """One type of ranger, as registered. `connect` and `check_url` None: `port` is a serial port's URL."""

    session: Callable[[RangerConfig], RangerSession]
    connect: Callable[[RangerConfig], Connection] | None = None  # blocks; raises LinkError
    check_url: Callable[[str], None] | None = None  # raises ConfigError for a port that can never be opened
    period_s: Callable[[RangerConfig], float] | None = None  # between two readings; None: not known
    max_range_mm: Callable[[RangerConfig], float] | None = None  # the farthest distance measured; None: not known
