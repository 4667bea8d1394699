"""Events wait here, in order and bounded, until the other system has acknowledged them. Pure.

`Outbox` is what a sink needs; `MemoryOutbox` keeps it in memory, and `durable` also on disk, where it survives
a restart. Entries are opaque bytes under an id that is unique across restarts.
"""

import heapq
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from typing import Protocol

from gateway.sinks.contract import StoreStatus

CLOCK_SET_MS = 1_577_836_800_000  # 2020-01-01: an earlier stamp is of a clock that was not set yet
OVERHEAD_BYTES = 200  # of an entry beyond its topic and payload, roughly


@dataclass(frozen=True, slots=True)
class Entry:
    """One event, rendered once: a redelivery is the same bytes under the same id."""

    id: str
    topic: str
    payload: bytes
    drop_last: bool  # a change of stop: dropped only when nothing else is left to drop
    unix_ms: int = 0  # when it happened

    @property
    def size(self) -> int:
        return len(self.topic) + len(self.payload) + OVERHEAD_BYTES


@dataclass(frozen=True, slots=True)
class Limits:
    """How much may wait; what is over it is dropped, oldest first, changes of stop last, and counted."""

    events: int
    size_bytes: int = 1 << 62
    age_ms: int = 1 << 62

    def __post_init__(self) -> None:
        for name in ("events", "size_bytes", "age_ms"):
            if (value := getattr(self, name)) < 1:
                raise ValueError(f"{name} = {value} must be at least 1")


class Outbox(Protocol):
    """In order of `put`, for any entries. No call waits, none raises."""

    @property
    def dropped(self) -> int:
        """Entries given up before they were acknowledged, since the start."""

    @property
    def store(self) -> StoreStatus | None:
        """The file behind it; None: in memory only."""

    def put(self, entry: Entry) -> object:
        """Take the newest entry; `unix_ms` of it is the time by which older ones age."""

    def oldest(self) -> Entry | None:
        """The entry to deliver next; it stays until it is acknowledged."""

    def batch(self, limit: int) -> list[Entry]:
        """The oldest entries, at most `limit`; they stay until they are acknowledged one by one, in this order."""

    def acknowledge(self, entry_id: str) -> object:
        """The other system has the entry. An id that is not the oldest any more is ignored: it was dropped."""

    def __len__(self) -> int: ...


class MemoryOutbox:
    """Everything in constant time, within `limits`."""

    store = None

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._count = 0  # entries ever put: their order across the two queues
        self._last: deque[tuple[int, Entry]] = deque()
        self._first: deque[tuple[int, Entry]] = deque()
        self._bytes = 0
        self._dropped = 0

    @property
    def dropped(self) -> int:
        return self._dropped

    def put(self, entry: Entry) -> list[Entry]:
        """Returns what had to be dropped for it; that may be the entry itself."""
        self._count += 1
        (self._last if entry.drop_last else self._first).append((self._count, entry))
        self._bytes += entry.size
        gone: list[Entry] = []
        for queue in (self._first, self._last):
            while queue and self._expired(queue[0][1], entry.unix_ms):
                gone.append(self._take(queue))
        while len(self) > self._limits.events or (self._bytes > self._limits.size_bytes and len(self) > 1):
            gone.append(self._take(self._first or self._last))
        self._dropped += len(gone)
        return gone

    def prepend(self, entries: Iterable[Entry]) -> list[Entry]:
        """Entries, oldest first, that are older than all in here. Returns those dropped."""
        waiting, dropped = self.waiting(), self._dropped
        self._last.clear()
        self._first.clear()
        self._bytes = 0
        gone = [lost for entry in (*entries, *waiting) for lost in self.put(entry)]
        self._dropped = dropped + len(gone)
        return gone

    def append(self, other: "MemoryOutbox") -> list[Entry]:
        """Append what waits in `other`; its drops count here, too. Returns what was dropped."""
        self._dropped += other.dropped
        return [lost for entry in other.waiting() for lost in self.put(entry)]

    def oldest(self) -> Entry | None:
        queue = self._next()
        return queue[0][1] if queue else None

    def batch(self, limit: int) -> list[Entry]:
        both = heapq.merge(self._last, self._first, key=lambda item: item[0])
        return [entry for _, entry in islice(both, limit)]

    def acknowledge(self, entry_id: str) -> Entry | None:
        """The entry; None where the id is not the oldest one's."""
        queue = self._next()
        return self._take(queue) if queue and queue[0][1].id == entry_id else None

    def copy(self) -> "MemoryOutbox":
        """A copy, made in microseconds; what is slow can be done with it."""
        copy = MemoryOutbox(self._limits)
        copy._last, copy._first = self._last.copy(), self._first.copy()
        return copy

    def waiting(self) -> list[Entry]:
        """Everything, oldest first."""
        return [entry for _, entry in sorted([*self._last, *self._first], key=lambda item: item[0])]

    def __len__(self) -> int:
        return len(self._last) + len(self._first)

    def _take(self, queue: deque[tuple[int, Entry]]) -> Entry:
        entry = queue.popleft()[1]
        self._bytes -= entry.size
        return entry

    def _expired(self, entry: Entry, now_ms: int) -> bool:
        return entry.unix_ms >= CLOCK_SET_MS and now_ms - entry.unix_ms > self._limits.age_ms

    def _next(self) -> deque[tuple[int, Entry]]:
        if self._last and self._first:
            return min(self._last, self._first, key=lambda queue: queue[0][0])
        return self._last or self._first
