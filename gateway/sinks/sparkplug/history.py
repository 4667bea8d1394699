"""Changes that no host may have received yet, in an outbox, so that they outlive the gateway. Pure.

A change is kept from the moment it happens until a session has lasted so long after it was sent that it has arrived: at
QoS 0 nothing is acknowledged.
"""

import json
import logging
from collections.abc import Collection, Iterable
from dataclasses import dataclass

from gateway.sinks.contract import StoreStatus
from gateway.sinks.outbox.outbox import Outbox, OutboxEntry
from gateway.sinks.sparkplug.metrics import KEPT, Reading
from gateway.sinks.sparkplug.wire import QualityCode

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class BayChange:
    """The values of a bay after a change of stop, or of a visit that is over. `id` is unique across restarts."""

    id: str
    bay: str
    timestamp_ms: int
    values: dict[str, Reading]


class History:
    """`limit`: changes kept; the oldest goes first, and is counted. `boot`: a random number of this start."""

    def __init__(self, outbox: Outbox, limit: int, boot: str, bays: Collection[str]) -> None:
        self._outbox = outbox
        self._limit = limit
        self._boot = boot
        self._bays = frozenset(bays)
        self._count = 0
        self._sent: dict[str, int] = {}  # id -> when it was sent in this session, Unix ms; the oldest first
        self._unsent: dict[str, BayChange] = {}
        self._unusable = 0  # kept by an earlier start
        self._not_kept = 0
        self.unsent_again()

    @property
    def dropped(self) -> int:
        """Changes given up before they were sent, since the start."""
        return self._outbox.dropped + self._unusable + self._not_kept

    @property
    def store(self) -> StoreStatus | None:
        """The file behind it; None: in memory only."""
        return self._outbox.store

    def __len__(self) -> int:
        """Changes not sent in this session."""
        return len(self._unsent)

    def put(self, bay: str, timestamp_ms: int, values: dict[str, Reading], *, in_session: bool) -> None:
        """Takes microseconds and never raises. `in_session`: data will show it, too."""
        if self._limit == 0:
            self._not_kept += not in_session
            return
        self._count += 1
        change = BayChange(f"{self._boot}-{self._count}", bay, timestamp_ms, values)
        while self._sent and len(self._outbox) >= self._limit:  # has most likely arrived: makes room before the unsent
            self._forget_oldest_sent()
        self._unsent[change.id] = change
        self._outbox.put(OutboxEntry(change.id, bay, _encoded(values), drop_last=True, unix_ms=timestamp_ms))
        while len(self._unsent) > self._limit:
            del self._unsent[next(iter(self._unsent))]

    def unsent(self, bays: Collection[str]) -> list[BayChange]:
        """Those of these bays, oldest first."""
        return [change for change in self._unsent.values() if change.bay in bays]

    def sent(self, changes: Iterable[BayChange], now_ms: int) -> None:
        for change in changes:
            del self._unsent[change.id]
            self._sent[change.id] = now_ms

    def arrived(self, before_ms: int) -> None:
        """What was sent before `before_ms` (Unix) has certainly arrived."""
        while self._sent and next(iter(self._sent.values())) < before_ms:
            self._forget_oldest_sent()

    def unsent_again(self) -> None:
        """The session is lost: what was sent in it and has not certainly arrived is unsent again."""
        if not self._sent and len(self._outbox) == len(self._unsent):
            return
        self._sent.clear()
        known, self._unsent = self._unsent, {}
        for entry in sorted(self._outbox.batch(self._limit), key=lambda entry: entry.unix_ms):
            change = known.get(entry.id) or self._read(entry)
            if change is None:
                self._unusable += 1
                self._outbox.acknowledge(entry.id)
            else:
                self._unsent[entry.id] = change

    def _forget_oldest_sent(self) -> None:
        oldest = next(iter(self._sent))
        del self._sent[oldest]
        self._outbox.acknowledge(oldest)

    def _read(self, entry: OutboxEntry) -> BayChange | None:
        """None: of a bay that is not configured any more, or not ours."""
        try:
            values = {
                name: (value, QualityCode(quality))
                for name, (value, quality) in json.loads(entry.payload).items()
                if name in KEPT
            }
        except (ValueError, TypeError, AttributeError):
            values = {}
        if entry.topic in self._bays and values:
            return BayChange(entry.id, entry.topic, entry.unix_ms, values)
        log.warning(
            "a change of bay %r, kept by an earlier start, cannot be sent: no such bay, or damaged", entry.topic
        )
        return None


def _encoded(values: dict[str, Reading]) -> bytes:
    return json.dumps({name: [value, int(quality)] for name, (value, quality) in values.items()}).encode()
