"""Events wait here, in order and bounded, until the other system has acknowledged them. Pure.

`Outbox` is what a sink needs; `MemoryOutbox` keeps it in memory, and `durable` also on disk, where it survives
a restart. Entries are opaque bytes under an id that is unique across restarts.
"""

import heapq
from collections import OrderedDict
from collections.abc import Collection, Iterable, Iterator, Sized
from dataclasses import dataclass
from itertools import islice
from typing import Protocol

from gateway.sinks.contract import StoreStatus

CLOCK_SET_MS = 1_577_836_800_000  # 2020-01-01: an earlier stamp is of a clock that was not set yet
OVERHEAD_BYTES = 200  # of an entry beyond its topic and payload, roughly


@dataclass(frozen=True, slots=True)
class OutboxEntry:
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
class OutboxLimits:
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
        """Entries given up before they were acknowledged, since the start; without those of unused topics."""

    @property
    def unused_dropped(self) -> int:
        """Entries of unused topics given up since the start."""

    @property
    def store(self) -> StoreStatus | None:
        """The file behind it; None: in memory only."""

    def put(self, entry: OutboxEntry) -> object:
        """Take the newest entry; `unix_ms` of it is the time by which older ones age."""

    def batch(self, limit: int, without: Collection[str] = ()) -> list[OutboxEntry]:
        """The oldest entries, at most `limit`, none of the topics `without`; they stay until they are acknowledged."""

    def acknowledge(self, entry_id: str) -> object:
        """The other system has the entry; in any order. An id that is not in here is ignored: it was dropped."""

    def count(self, topics: Iterable[str]) -> int:
        """How many entries of these topics wait."""

    def set_unused(self, topic: str, unused: bool) -> None:
        """Nobody has a use for the entries of an unused topic: where room is needed, they are dropped before all
        others, and are counted apart."""

    def expire(self, topic: str, age_ms: int, now_ms: int, limit: int) -> Sized:
        """Drop the oldest entries of the topic that happened more than `age_ms` before `now_ms`, at most `limit`; the
        result has as many."""

    def __len__(self) -> int: ...


Numbered = tuple[int, OutboxEntry]  # and its place in the order across all queues
Queue = OrderedDict[str, Numbered]  # by id, the oldest first; unlike a dict's, its first one is found at once


class MemoryOutbox:
    """Everything in constant time but for the number of topics, within `limits`."""

    store = None

    def __init__(self, limits: OutboxLimits) -> None:
        self._limits = limits
        self._count = 0  # entries ever put
        self._kinds: tuple[Queue, Queue] = (OrderedDict(), OrderedDict())  # by drop_last: all entries are in one
        self._topics: dict[str, Queue] = {}  # and in that of their topic; none is empty
        self._unused: set[str] = set()
        self._bytes = 0
        self._dropped = 0
        self._unused_dropped = 0

    @property
    def dropped(self) -> int:
        return self._dropped

    @property
    def unused_dropped(self) -> int:
        return self._unused_dropped

    def put(self, entry: OutboxEntry) -> list[OutboxEntry]:
        """Returns what had to be dropped for it; that may be the entry itself."""
        self._count += 1
        self._kinds[entry.drop_last][entry.id] = self._count, entry
        self._topics.setdefault(entry.topic, OrderedDict())[entry.id] = self._count, entry
        self._bytes += entry.size
        gone: list[OutboxEntry] = []
        for queue in self._kinds:
            while queue and _expired(_first(queue), self._limits.age_ms, entry.unix_ms):
                gone.append(self._drop(_first(queue)))
        while len(self) > self._limits.events or (self._bytes > self._limits.size_bytes and len(self) > 1):
            gone.append(self._drop(self._least_needed()))
        return gone

    def append(self, other: "MemoryOutbox") -> list[OutboxEntry]:
        """Append what waits in `other`; its drops and unused topics count here, too. Returns what was dropped."""
        self._dropped += other._dropped
        self._unused_dropped += other._unused_dropped
        self._unused |= other._unused
        return [lost for entry in other.waiting() for lost in self.put(entry)]

    def batch(self, limit: int, without: Collection[str] = ()) -> list[OutboxEntry]:
        queues = [queue for topic, queue in self._topics.items() if topic not in without] if without else self._kinds
        return list(islice(in_order(queue.values() for queue in queues), limit))

    def acknowledge(self, entry_id: str) -> OutboxEntry | None:
        """The entry; None where there is none of this id any more."""
        found = next((queue[entry_id][1] for queue in self._kinds if entry_id in queue), None)
        if found is not None:
            self._remove(found)
        return found

    def count(self, topics: Iterable[str]) -> int:
        return sum(len(self._topics[topic]) for topic in topics if topic in self._topics)

    def set_unused(self, topic: str, unused: bool) -> None:
        (self._unused.add if unused else self._unused.discard)(topic)

    def expire(self, topic: str, age_ms: int, now_ms: int, limit: int) -> list[OutboxEntry]:
        """Returns what was dropped."""
        oldest = [entry for _, entry in islice(self._topics.get(topic, OrderedDict()).values(), limit)]
        return [self._drop(entry) for entry in oldest if _expired(entry, age_ms, now_ms)]

    def numbered(self) -> tuple[list[Numbered], list[Numbered]]:
        """Everything, for `in_order`: taken in a fraction of a millisecond, so that what is slow is done without it."""
        common, last = self._kinds
        return list(common.values()), list(last.values())

    def waiting(self) -> list[OutboxEntry]:
        """Everything, oldest first."""
        return list(in_order(self.numbered()))

    def __contains__(self, entry_id: str) -> bool:
        return any(entry_id in queue for queue in self._kinds)

    def __len__(self) -> int:
        return sum(map(len, self._kinds))

    def _least_needed(self) -> OutboxEntry:
        """The oldest of the unused topics; else the oldest that is not to be dropped last; else the oldest."""
        unused = [next(iter(self._topics[topic].values())) for topic in self._unused if topic in self._topics]
        return min(unused)[1] if unused else _first(self._kinds[0] or self._kinds[1])

    def _drop(self, entry: OutboxEntry) -> OutboxEntry:
        if entry.topic in self._unused:
            self._unused_dropped += 1
        else:
            self._dropped += 1
        self._remove(entry)
        return entry

    def _remove(self, entry: OutboxEntry) -> None:
        self._bytes -= entry.size
        del self._kinds[entry.drop_last][entry.id]
        queue = self._topics[entry.topic]
        del queue[entry.id]
        if not queue:
            del self._topics[entry.topic]


def in_order(queues: Iterable[Iterable[Numbered]]) -> Iterator[OutboxEntry]:
    """The entries of queues that are in order each, oldest first."""
    return (entry for _, entry in heapq.merge(*queues, key=lambda item: item[0]))


def _first(queue: Queue) -> OutboxEntry:
    return next(iter(queue.values()))[1]


def _expired(entry: OutboxEntry, age_ms: int, now_ms: int) -> bool:
    return entry.unix_ms >= CLOCK_SET_MS and now_ms - entry.unix_ms > age_ms
