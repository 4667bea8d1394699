"""Events wait here, in order and bounded, until the broker has acknowledged them. Pure.

`Outbox` is what the publisher asks for; `MemoryOutbox` keeps it in memory. One that survives a restart of the gateway
fits behind the same four members: entries are opaque bytes under an id that is unique across restarts.
"""

from collections import deque
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Entry:
    """One event, rendered once: a redelivery is the same bytes under the same id."""

    id: str
    topic: str
    payload: bytes
    precious: bool  # a change of stop: dropped only when nothing else is left to drop


class Outbox(Protocol):
    """In order of `put`, whatever the entries are. No call waits, none raises."""

    @property
    def dropped(self) -> int:
        """Entries given up before they were acknowledged, since the start."""

    def put(self, entry: Entry) -> None:
        """Take the newest entry. When full, the oldest one that is not precious goes, else the oldest."""

    def oldest(self) -> Entry | None:
        """The entry to deliver next; it stays until it is acknowledged."""

    def acknowledge(self, entry_id: str) -> None:
        """The broker has the entry. An id that is not the oldest any more is ignored: it was dropped on its way."""

    def __len__(self) -> int: ...


class MemoryOutbox:
    """Everything in constant time, at most `limit` entries."""

    def __init__(self, limit: int) -> None:
        if limit < 1:
            raise ValueError(f"limit = {limit} must be at least 1")
        self._limit = limit
        self._count = 0  # entries ever put: their order across the two queues
        self._precious: deque[tuple[int, Entry]] = deque()
        self._common: deque[tuple[int, Entry]] = deque()
        self._dropped = 0

    @property
    def dropped(self) -> int:
        return self._dropped

    def put(self, entry: Entry) -> None:
        self._count += 1
        (self._precious if entry.precious else self._common).append((self._count, entry))
        if len(self) > self._limit:
            (self._common or self._precious).popleft()
            self._dropped += 1

    def oldest(self) -> Entry | None:
        queue = self._next()
        return queue[0][1] if queue else None

    def acknowledge(self, entry_id: str) -> None:
        queue = self._next()
        if queue and queue[0][1].id == entry_id:
            queue.popleft()

    def __len__(self) -> int:
        return len(self._precious) + len(self._common)

    def _next(self) -> deque[tuple[int, Entry]]:
        if self._precious and self._common:
            return min(self._precious, self._common, key=lambda queue: queue[0][0])
        return self._precious or self._common
