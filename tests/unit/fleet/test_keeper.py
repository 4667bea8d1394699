"""What is heard, on its way to a store that is lost, hangs and comes back. In virtual time."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest

from gateway.errors import LinkError
from gateway.fleet.keeper import ANSWER_S, KEEP_S, MAX_WAITING, MAX_WAITING_EACH, UNCHANGED_EVERY, Keeper
from gateway.fleet.roster import GatewayLife, Key, Roster
from gateway.fleet.store import News, Past
from gateway.fleet.trends import PERIOD_MS
from tests.unit.fleet.stores import MemoryStore
from tests.unit.fleet.test_roster import KEY, alive, last_will, status
from tests.virtual_time import LoopClock, in_virtual_time

OTHER = "south", "bay-2"


class Page:
    """A roster, its keeper and a store, with the supervisor's part in small."""

    def __init__(self, store: MemoryStore | None = None) -> None:
        self.clock, self.store, self.roster = LoopClock(), store or MemoryStore(), Roster()
        self.keeper = Keeper(self.roster, self.store, self.clock, self.now_ms)
        self.statuses = 0

    def now_ms(self) -> int:
        return PERIOD_MS + self.clock.now_ns() // 1_000_000

    def hear(self, key: Key = KEY, payload: bytes | None = None, *, retained: bool = False, **changes: object) -> None:
        self.statuses += 1
        site, instance = key
        found = payload if payload is not None else status(self.statuses, site=site, instance=instance, **changes)
        heard, changed = self.roster.heard(f"loading/{site}/{instance}/status", found, self.now_ms(), retained=retained)
        assert heard == key
        self.keeper.heard(heard, changed, self.now_ms(), retained=retained)

    @contextlib.asynccontextmanager
    async def kept(self) -> AsyncIterator[None]:
        async with asyncio.TaskGroup() as group:
            task = group.create_task(self._supervised())
            yield
            await self.keeper.close()
            task.cancel()

    async def _supervised(self) -> None:
        while True:
            with contextlib.suppress(LinkError):
                return await self.keeper.keep()
            await asyncio.sleep(1)


def whats(past: Past) -> list[tuple[str, str, str]]:
    return [(change.what, change.was, change.now) for change in past.changes]


@in_virtual_time
async def test_what_changes_is_written_soon_and_what_does_not_once_a_minute() -> None:
    page = Page()
    page.hear()
    async with page.kept():
        await asyncio.sleep(1.5 * KEEP_S)
        assert [[known.status.timestamp_ms for known in news.known] for news in page.store.writes] == [[1]]
        page.hear()
        page.hear()
        await asyncio.sleep(2 * KEEP_S)
        assert len(page.store.writes) == 1
        await asyncio.sleep(UNCHANGED_EVERY * KEEP_S)
        assert [[known.status.timestamp_ms for known in news.known] for news in page.store.writes[1:]] == [[3]]
        page.hear(version="0.3.0")
        await asyncio.sleep(2 * KEEP_S)
        assert whats(Past(page.store.writes[2].changes)) == [("version", "0.2.0", "0.3.0")]


@in_virtual_time
async def test_a_store_that_is_lost_costs_nothing_of_what_fits() -> None:
    page = Page(MemoryStore(lost=True))
    async with page.kept():
        page.hear()
        page.hear(version="0.3.0")
        await asyncio.sleep(600)
        assert await page.keeper.past(KEY) is None
        assert whats(page.keeper.newest(KEY, None)) == [("version", "0.2.0", "0.3.0")]
        page.store.lost = False
        await asyncio.sleep(10)
        assert (page.keeper.waiting, page.keeper.dropped) == (0, 0)
        past = await page.keeper.past(KEY)
        assert past is not None
        assert whats(page.keeper.newest(KEY, past)) == [("version", "0.2.0", "0.3.0")]
        page.store.lost = True
        page.hear(version="0.4.0")
        await asyncio.sleep(10)
        page.hear(version="0.5.0")
        page.store.lost = False
        await asyncio.sleep(10)
    assert [change.now for change in page.store.changes] == ["0.3.0", "0.4.0", "0.5.0"]


@in_virtual_time
async def test_a_store_that_hangs_holds_no_viewer_up() -> None:
    page = Page()
    async with page.kept():
        await asyncio.sleep(1)
        page.store.hangs = True
        asked_ns = page.clock.now_ns()
        assert await page.keeper.past(KEY) is None
        assert (page.clock.now_ns() - asked_ns) / 1e9 == pytest.approx(ANSWER_S)
        page.hear()
        assert page.roster.known[KEY].status.timestamp_ms == 1


@in_virtual_time
async def test_viewers_that_ask_without_end_hold_no_write_up() -> None:
    page = Page()
    async with page.kept():
        page.hear()
        for _ in range(30):
            await asyncio.sleep(KEEP_S / 10)
            assert await page.keeper.past(KEY) == Past([])
        assert len(page.store.writes) == 1


@in_virtual_time
async def test_what_waits_is_bounded_and_counted_and_one_gateway_takes_no_room_from_others() -> None:
    page = Page(MemoryStore(lost=True))
    for n in range(MAX_WAITING_EACH + 10):
        page.hear(version=str(n))
    assert (page.keeper.waiting, page.keeper.dropped) == (MAX_WAITING_EACH, 9)
    page.hear(OTHER)
    page.hear(OTHER, version="0.3.0")
    assert (page.keeper.waiting, page.keeper.dropped) == (MAX_WAITING_EACH + 1, 9)
    for n in range(MAX_WAITING // MAX_WAITING_EACH):
        for m in range(MAX_WAITING_EACH + 1):
            page.hear(("west", f"bay-{n}"), version=str(m))
    assert (page.keeper.waiting, page.keeper.dropped) == (MAX_WAITING, 9 + MAX_WAITING_EACH + 1)


@in_virtual_time
async def test_what_was_kept_is_recalled_when_the_store_comes_back() -> None:
    """One was not heard meanwhile, one with another version, one only by its last will, and one was cleared."""
    before = alive().known[KEY]
    names = "north", "will"
    kept = {KEY: before, OTHER: alive().known[KEY], ("north", "cleared"): before}
    will = alive(site="north").known[KEY]
    page = Page(MemoryStore(kept | {names: will}, lost=True))
    page.hear(KEY, version="0.3.0")
    page.hear(("north", "cleared"))
    page.hear(("north", "cleared"), b"")
    page.hear(names, last_will().replace(b'"bay-1"', b'"will"'))
    async with page.kept():
        await asyncio.sleep(5)
        page.store.lost = False
        await asyncio.sleep(10)
    assert page.roster.life(OTHER, page.now_ms()) is GatewayLife.SILENT
    assert ("north", "cleared") not in page.roster
    assert page.roster.known[names].last == will.last
    assert page.roster.life(names, page.now_ms()) is GatewayLife.OFFLINE
    assert sorted((change.key[1], change.what, change.now) for change in page.store.changes) == [
        ("bay-1", "version", "0.3.0"),
        ("cleared", "status", "cleared at the broker"),
        ("will", "status", "offline"),
    ]


@in_virtual_time
async def test_the_worst_of_a_period_is_its_sample() -> None:
    page = Page()
    bay = {"bay": "bay-1", "marker": {"visible": 0.9, "contrast": 1.2}}
    page.hear(health=[bay | {"veil": 0.9}], retained=True)
    for veil, visible in ((0.2, 0.9), (0.4, 0.8), (None, 0.85)):
        page.hear(health=[bay | {"veil": veil, "marker": {"visible": visible}}])
    (sample,) = page.keeper.newest(KEY, None).samples
    assert (sample.bay, sample.period, sample.veil, sample.visible, sample.contrast) == ("bay-1", 1, 0.4, 0.8, None)
    async with page.kept():
        await asyncio.sleep(PERIOD_MS / 1000)
        page.hear(health=[bay | {"veil": 0.1}])
        assert [one.veil for one in page.keeper.newest(KEY, None).samples] == [0.1]
    written = [sample for news in page.store.writes for sample in news.samples]
    assert {(one.period, one.veil) for one in written} == {(1, 0.4), (2, 0.1)}


@in_virtual_time
async def test_at_the_end_all_is_written() -> None:
    page = Page()
    async with page.kept():
        page.hear()
        page.hear(version="0.3.0")
    assert [change.now for change in page.store.changes] == ["0.3.0"]
    assert isinstance(page.store.writes[-1], News)
