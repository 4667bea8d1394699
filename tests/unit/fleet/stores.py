"""What every store of the fleet page must do, whatever keeps it; and a store of memory with faults."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

from gateway.errors import LinkError
from gateway.fleet.roster import GatewayChange, GatewayLife, Key, Known, Roster
from gateway.fleet.store import MAX_CHANGES_EACH, SHOWN_CHANGES, FleetStore, News, Past
from gateway.fleet.trends import TREND_PERIODS, Sample
from tests.unit.fleet.test_roster import KEY, TOPIC, alive, last_will


async def keeps_what_it_is_given(store: FleetStore) -> None:
    """On an empty store."""
    roster = alive()
    _, offline = roster.heard(TOPIC, last_will(), 7_000)
    samples = [Sample(KEY, "bay-1", period, 0.25, 0.75, None) for period in range(TREND_PERIODS + 2)]
    async with store.opened() as session:
        assert await session.read() == {}
        assert await session.past(KEY) == Past([], [])
        await session.keep(News(list(roster.known.values()), offline, [], samples[:1]))
    async with store.opened() as session:
        again = Roster(known=await session.read())
        assert again.known[KEY].last == roster.known[KEY].last
        assert again.life(KEY, 7_000) is GatewayLife.OFFLINE
        assert again.heard(TOPIC, last_will(), 9_000) == (KEY, []), "what was known is no change"
        assert await session.past(KEY) == Past(offline, samples[:1])
        worse = Sample(KEY, "bay-1", 0, 0.5, 0.8, 1.5)
        await session.keep(News(samples=[worse]))
        assert (await session.past(KEY)).samples == [Sample(KEY, "bay-1", 0, 0.5, 0.75, 1.5)]
        await session.keep(News(samples=samples[2:]))
        assert (await session.past(KEY)).samples == samples[2:], "two weeks are kept"
        many = [GatewayChange(n, KEY, "version", f"\0{n}'", str(n + 1)) for n in range(MAX_CHANGES_EACH + 5)]
        other = GatewayChange(1, ("north", "quiet"), "version", "", "1")
        await session.keep(News(changes=[other, *many]))
        newest = (await session.past(KEY)).changes
        assert [change.t_ms for change in newest] == [change.t_ms for change in many[: -SHOWN_CHANGES - 1 : -1]]
        assert (await session.past(other.key)).changes == [other]
        await session.keep(News(gone=[KEY]))
        assert await session.read() == {}
        assert (await session.past(KEY)).samples == []


@dataclass
class MemoryStore:
    """It fails or hangs where that is set."""

    known: dict[Key, Known] = field(default_factory=dict)
    changes: list[GatewayChange] = field(default_factory=list)
    writes: list[News] = field(default_factory=list)
    lost: bool = False
    hangs: bool = False

    @contextlib.asynccontextmanager
    async def opened(self) -> AsyncIterator["MemoryStore"]:
        await self._answers()
        yield self

    async def read(self) -> dict[Key, Known]:
        await self._answers()
        return self.known

    async def keep(self, news: News) -> None:
        await self._answers()
        self.writes.append(news)
        self.changes += news.changes

    async def past(self, key: Key) -> Past:
        await self._answers()
        return Past([change for change in reversed(self.changes) if change.key == key])

    async def _answers(self) -> None:
        if self.hangs:
            await asyncio.sleep(1e9)
        if self.lost:
            raise LinkError("lost")
