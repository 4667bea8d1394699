"""The bench: one thread, the newest wish of everybody wins, nothing piles up. In real time, with real threads."""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from gateway.web.tuning.trial import EndedError
from gateway.web.tuning.trial_thread import MAX_WAITING, BusyError, TrialThread

PATIENCE_S = 60.0


def held(open_: threading.Event, begun: threading.Event | None = None) -> Callable[[Callable[[], bool]], str]:
    """Work that goes on until `open_` is set, or nobody wants it any more."""

    def work(wanted: Callable[[], bool]) -> str:
        if begun is not None:
            begun.set()
        while not open_.wait(0.005):
            if not wanted():
                raise EndedError("given up")
        return "done"

    return work


async def until(event: threading.Event) -> None:
    assert await asyncio.to_thread(event.wait, PATIENCE_S)


def test_the_newest_wish_of_one_visitor_takes_back_the_older_ones() -> None:
    async def scene() -> None:
        bench, gate, begun = TrialThread(), threading.Event(), threading.Event()
        try:
            async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group:
                first = group.create_task(ended(bench.work("a", held(gate, begun))))
                await until(begun)
                second = group.create_task(ended(bench.work("a", held(gate))))
                await asyncio.sleep(0)
                third = group.create_task(bench.work("a", lambda wanted: wanted()))
                assert await third is True
                assert [await first, await second] == ["ended", "ended"]
            assert (bench.done, bench.withdrawn) == (1, 2)
        finally:
            gate.set()
            bench.close()

    asyncio.run(scene())


async def ended(work: "asyncio.Future[str] | object") -> str:
    try:
        return str(await work)  # type: ignore[misc]  # any awaitable
    except EndedError:
        return "ended"


def test_visitors_wait_for_each_other_and_one_thread_works() -> None:
    async def scene() -> None:
        bench, names = TrialThread(), set()
        running, most = 0, 0

        def work(_: Callable[[], bool]) -> None:
            nonlocal running, most
            running += 1
            most = max(most, running)
            names.add(threading.current_thread().name)
            running -= 1

        try:
            async with asyncio.timeout(PATIENCE_S):
                await asyncio.gather(*(bench.work(f"caller {n}", work) for n in range(MAX_WAITING)))
            assert (most, len(names), bench.done) == (1, 1, MAX_WAITING)
        finally:
            bench.close()

    asyncio.run(scene())


def test_too_many_visitors_are_told_so() -> None:
    async def scene() -> None:
        bench, gate, begun = TrialThread(), threading.Event(), threading.Event()
        try:
            async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group:
                waiting = [group.create_task(bench.work(f"{n}", held(gate, begun))) for n in range(MAX_WAITING)]
                await until(begun)
                with pytest.raises(BusyError):
                    await bench.work("one more", lambda _: None)
                gate.set()
                assert {await task for task in waiting} == {"done"}
                assert await bench.work("one more", lambda _: 5) == 5
        finally:
            bench.close()

    asyncio.run(scene())


def test_who_goes_away_leaves_no_work_behind() -> None:
    async def scene() -> None:
        bench, gate, begun = TrialThread(), threading.Event(), threading.Event()
        try:
            async with asyncio.timeout(PATIENCE_S):
                work = asyncio.ensure_future(bench.work("a", held(gate, begun)))
                await until(begun)
                work.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await work
                assert await bench.work("b", lambda _: "next") == "next"
        finally:
            gate.set()
            bench.close()

    asyncio.run(scene())


def test_a_wish_is_taken_back_without_a_newer_one() -> None:
    async def scene() -> None:
        bench, gate, begun = TrialThread(), threading.Event(), threading.Event()
        try:
            async with asyncio.timeout(PATIENCE_S):
                work = asyncio.ensure_future(ended(bench.work("a", held(gate, begun))))
                await until(begun)
                bench.withdraw("b")
                bench.withdraw("a")
                assert await work == "ended"
        finally:
            gate.set()
            bench.close()

    asyncio.run(scene())


def test_an_error_of_the_work_reaches_who_asked_and_the_place_is_free_again() -> None:
    async def scene() -> None:
        bench = TrialThread()

        def fails(_: Callable[[], bool]) -> None:
            raise ValueError("a bug")

        try:
            for _ in range(3):
                with pytest.raises(ValueError, match="a bug"):
                    await bench.work("a", fails)
            assert await bench.work("a", lambda _: 1) == 1
        finally:
            bench.close()

    asyncio.run(scene())


def test_closing_takes_back_what_runs() -> None:
    async def scene() -> None:
        thread = ThreadPoolExecutor(1)
        bench, gate, begun = TrialThread(thread), threading.Event(), threading.Event()
        work = asyncio.ensure_future(ended(bench.work("a", held(gate, begun))))
        await until(begun)
        bench.close()  # returns, although the gate is never opened
        assert await work == "ended"

    asyncio.run(scene())
