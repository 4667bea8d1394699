"""One thread; everybody's newest request wins, and nothing piles up. In real time, with real threads."""

import asyncio
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager

import pytest

from gateway.web.tuning.trial import EndedError
from gateway.web.tuning.trial_thread import MAX_WAITING, TrialsBusyError, TrialThread
from tests.virtual_time import in_real_time

PATIENCE_S = 60.0
Wanted = Callable[[], bool]


class Scene:
    """A thread, and work that goes on until the gate is opened, or nobody wants it any more."""

    def __init__(self) -> None:
        self.thread = TrialThread()
        self.gate, self._begun = threading.Event(), threading.Event()

    def held(self, wanted: Wanted) -> str:
        self._begun.set()
        while not self.gate.wait(0.005):
            if not wanted():
                raise EndedError("given up")
        return "done"

    async def begun(self) -> None:
        assert await asyncio.to_thread(self._begun.wait, PATIENCE_S)


@asynccontextmanager
async def scene() -> AsyncIterator[Scene]:
    made = Scene()
    try:
        async with asyncio.timeout(PATIENCE_S):
            yield made
    finally:
        made.gate.set()
        made.thread.close()


async def ended(work: Awaitable[str]) -> str:
    try:
        return await work
    except EndedError:
        return "ended"


@in_real_time
async def test_the_newest_request_of_one_visitor_takes_back_the_older_ones() -> None:
    async with scene() as made, asyncio.TaskGroup() as group:
        first = group.create_task(ended(made.thread.work("a", made.held)))
        await made.begun()
        second = group.create_task(ended(made.thread.work("a", made.held)))
        await asyncio.sleep(0)
        third = group.create_task(made.thread.work("a", lambda wanted: wanted()))
        assert await third is True
        assert [await first, await second] == ["ended", "ended"]


@in_real_time
async def test_visitors_wait_for_each_other_and_one_thread_works() -> None:
    names = set()
    running, most = 0, 0

    def work(_: Wanted) -> None:
        nonlocal running, most
        running += 1
        most = max(most, running)
        names.add(threading.current_thread().name)
        running -= 1

    async with scene() as made:
        done = await asyncio.gather(*(made.thread.work(f"caller {n}", work) for n in range(MAX_WAITING)))
        assert (most, len(names), len(done)) == (1, 1, MAX_WAITING)


@in_real_time
async def test_too_many_visitors_are_refused() -> None:
    async with scene() as made, asyncio.TaskGroup() as group:
        waiting = [group.create_task(made.thread.work(f"{n}", made.held)) for n in range(MAX_WAITING)]
        await made.begun()
        with pytest.raises(TrialsBusyError):
            await made.thread.work("one more", lambda _: None)
        made.gate.set()
        assert {await task for task in waiting} == {"done"}
        assert await made.thread.work("one more", lambda _: 5) == 5


@in_real_time
async def test_a_cancelled_request_leaves_no_work_behind() -> None:
    async with scene() as made:
        work = asyncio.ensure_future(made.thread.work("a", made.held))
        await made.begun()
        work.cancel()
        with pytest.raises(asyncio.CancelledError):
            await work
        assert await made.thread.work("b", lambda _: "next") == "next"


@in_real_time
async def test_a_request_is_taken_back_without_a_newer_one() -> None:
    async with scene() as made:
        work = asyncio.ensure_future(ended(made.thread.work("a", made.held)))
        await made.begun()
        made.thread.withdraw("b")
        made.thread.withdraw("a")
        assert await work == "ended"


@in_real_time
async def test_an_error_of_the_work_reaches_its_caller_and_frees_the_place() -> None:
    def fails(_: Wanted) -> None:
        raise ValueError("a bug")

    async with scene() as made:
        for _ in range(3):
            with pytest.raises(ValueError, match="a bug"):
                await made.thread.work("a", fails)
        assert await made.thread.work("a", lambda _: 1) == 1


@in_real_time
async def test_closing_takes_back_what_runs() -> None:
    made = Scene()
    made.thread = TrialThread(ThreadPoolExecutor(1))
    work = asyncio.ensure_future(ended(made.thread.work("a", made.held)))
    await made.begun()
    made.thread.close()  # returns, although the gate is never opened
    assert await work == "ended"
