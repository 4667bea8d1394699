"""What is heard, on its way to the store, and what the store knows of a gateway. IO by the store only.

A store that is lost or hangs holds nothing up: the newest is shown from memory, and changes wait, bounded.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterable, Sequence

from gateway.clock import Clock
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.fleet.roster import MAX_GATEWAYS, GatewayChange, Key, Roster
from gateway.fleet.store import SHOWN_CHANGES, FleetStore, News, Past, StoreSession
from gateway.fleet.trends import Trends

log = logging.getLogger(__name__)

KEEP_S = 2.0  # between two writes
UNCHANGED_EVERY = 30  # of them also have what is as before: its newest status, and the worst of dust and wear
AT_ONCE, BYTES_AT_ONCE = 500, 2_000_000  # gateways, and their statuses, with one write
MAX_WAITING = 10_000  # changes that are not written yet
MAX_WAITING_EACH = 200  # of a gateway: one that changes without end takes no room from the others
ANSWER_S = 1.0  # how long a viewer waits for the store
CLOSE_S = 5.0


class Keeper:
    """Between a roster and its store. `now_ms`: Unix time."""

    def __init__(self, roster: Roster, store: FleetStore, clock: Clock, now_ms: Callable[[], int]) -> None:
        self.dropped = 0  # changes
        self.connected = False
        self._roster = roster
        self._store = store
        self._clock = clock
        self._now_ms = now_ms
        self._trends = Trends()
        self._recalled = False
        self._changed: dict[Key, None] = {}  # to be written soon
        self._unchanged: dict[Key, None] = {}  # to be written with the others of a minute
        self._changes: list[GatewayChange] = []
        self._each: dict[Key, int] = {}  # of these, by gateway
        self._asked: dict[Key, asyncio.Future[Past]] = {}
        self._woken = asyncio.Event()
        self._closing = False
        self._ended = asyncio.Event()
        self._ended.set()

    @property
    def waiting(self) -> int:
        """Changes that are not written yet."""
        return len(self._changes)

    def heard(self, key: Key, changes: Sequence[GatewayChange], now_ms: int, *, retained: bool = False) -> None:
        """What the roster has taken."""
        one = self._roster.known.get(key)
        if one is None:
            self._trends.gone(key)
        elif one.heard_ms == now_ms and not retained and one.last is not None:
            self._trends.heard(key, one.last.health, now_ms)
        new = one is None or (key not in self._unchanged and one.heard_ms is None)
        (self._changed if changes or new else self._unchanged)[key] = None
        while len(self._changed) > 2 * MAX_GATEWAYS:  # many that were cleared while nothing could be written
            del self._changed[next(iter(self._changed))]
        self._wait(key, changes)

    def _wait(self, key: Key, changes: Sequence[GatewayChange]) -> None:
        room = min(MAX_WAITING - len(self._changes), MAX_WAITING_EACH - self._each.get(key, 0))
        taken = changes[: max(0, room)]
        self.dropped += len(changes) - len(taken)
        self._changes += taken
        if taken:
            self._each[key] = self._each.get(key, 0) + len(taken)

    async def recall(self, session: StoreSession) -> None:
        """What was kept becomes part of the roster, once."""
        gone = {key for key in self._changed if key not in self._roster.known}
        for change in self._roster.recall(await session.read(), gone, self._now_ms()):
            self._wait(change.key, [change])
        self._recalled = True

    async def keep(self) -> None:
        """Writes what is new, and answers what is asked, until it is closed. Raises LinkError."""
        self._ended.clear()
        try:
            async with self._store.opened() as session:
                if not self._recalled:
                    await self.recall(session)
                self.connected = True
                await self._serve(session)
                await self._write(session, everything=True)
        finally:
            self.connected = False
            self._ended.set()

    async def _serve(self, session: StoreSession) -> None:
        """Until it is closed."""
        writes, written_ns = 0, self._clock.now_ns()
        while not self._closing:
            rest_s = KEEP_S - (self._clock.now_ns() - written_ns) / NS_PER_S
            if rest_s > 0:
                with contextlib.suppress(TimeoutError):
                    async with self._clock.timeout(rest_s):
                        await self._woken.wait()
                self._woken.clear()
                await self._answer(session)
                continue
            writes, written_ns = writes + 1, self._clock.now_ns()
            await self._write(session, everything=writes % UNCHANGED_EVERY == 0)

    async def _write(self, session: StoreSession, *, everything: bool) -> None:
        for keys in self._parts(self._changed | self._unchanged if everything else self._changed):
            news = self._taken(keys)
            try:
                await session.keep(news)
            except BaseException:
                self._put_back(keys, news.changes)
                raise
            await self._answer(session)

    def _parts(self, keys: Iterable[Key]) -> list[list[Key]]:
        parts: list[list[Key]] = []
        room = 0
        for key in keys:
            size = BYTES_AT_ONCE // AT_ONCE + len(self._roster.known[key].text if key in self._roster.known else b"")
            if size > room:
                parts.append([])
                room = BYTES_AT_ONCE
            parts[-1].append(key)
            room -= size
        return parts

    def _taken(self, keys: Sequence[Key]) -> News:
        found = {key: self._roster.known.get(key) for key in keys}
        for key in keys:
            self._changed.pop(key, None)
            self._unchanged.pop(key, None)
        changes = [change for change in self._changes if change.key in found]
        self._changes = [change for change in self._changes if change.key not in found]
        for key in keys:
            self._each.pop(key, None)
        return News(
            [one for one in found.values() if one is not None and one.text],
            changes,
            [key for key, one in found.items() if one is None],
            [sample for key in keys for sample in self._trends.of(key)],
        )

    def _put_back(self, keys: Sequence[Key], changes: Sequence[GatewayChange]) -> None:
        self._changed = dict.fromkeys(keys) | self._changed
        later, self._changes, self._each = self._changes, [], {}
        for change in [*changes, *later]:
            self._wait(change.key, [change])

    async def _answer(self, session: StoreSession) -> None:
        while self._asked:
            key, future = self._asked.popitem()
            past = await session.past(key)
            if not future.done():
                future.set_result(past)

    async def past(self, key: Key) -> Past | None:
        """What is kept of it, with what waits, the newest first. None: the store does not answer."""
        if not self.connected:
            return None
        future = self._asked.setdefault(key, asyncio.get_running_loop().create_future())
        self._woken.set()
        with contextlib.suppress(TimeoutError):
            async with self._clock.timeout(ANSWER_S):
                return await asyncio.shield(future)
        return None

    def newest(self, key: Key, past: Past | None) -> Past:
        """With what is not written yet."""
        kept = past or Past()
        waiting = [change for change in reversed(self._changes) if change.key == key]
        now = {(one.bay, one.period): one for one in self._trends.of(key)}
        for one in kept.samples:
            place = one.bay, one.period
            now[place] = one.worse(now[place]) if place in now else one
        changes = [*waiting, *kept.changes][:SHOWN_CHANGES]
        return Past(changes, [now[place] for place in sorted(now)])

    async def close(self) -> None:
        """Writes the rest, where that does not take long."""
        self._closing = True
        self._woken.set()
        try:
            async with self._clock.timeout(CLOSE_S):
                if not self._ended.is_set():
                    await self._ended.wait()
                else:
                    async with self._store.opened() as session:
                        await self._write(session, everything=True)
        except (TimeoutError, LinkError) as error:
            log.warning("database: %s; %d changes are not kept", str(error) or "no answer", len(self._changes))
