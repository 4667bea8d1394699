"""An event loop in which waiting costs nothing: when everything is blocked, time jumps to the next deadline."""

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from gateway import event_loop

P = ParamSpec("P")
T = TypeVar("T")


class _JumpingSelector(selectors.DefaultSelector):
    def __init__(self) -> None:
        super().__init__()
        self.now_s = 1000.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if not ready and timeout:
            self.now_s += timeout
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """`loop.time()` stands still while anything can run."""

    def __init__(self) -> None:
        self._jumping = _JumpingSelector()
        super().__init__(self._jumping)

    def time(self) -> float:
        return self._jumping.now_s

    def run_in_executor(self, executor: Executor | None, func: Callable[..., T], *args: Any) -> asyncio.Future[T]:  # type: ignore[override]
        """Without an executor (`asyncio.to_thread`, names looked up) at once: time would run away beside a thread."""
        return super().run_in_executor(AtOnce() if executor is None else executor, func, *args)


@dataclass
class LoopClock:
    """A gateway clock that reads the running loop's time."""

    def now_ns(self) -> int:
        return round(asyncio.get_running_loop().time() * 1e9)

    def wall_ns(self) -> int:
        return 1_700_000_000_000_000_000 + self.now_ns()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    def block(self, seconds: float) -> None:
        raise AssertionError("nothing may block the event loop")

    def timeout(self, seconds: float) -> asyncio.Timeout:
        return asyncio.timeout(seconds)


@dataclass
class HandClock(LoopClock):
    """Stands still until it is set."""

    t_ns: int = 10_000_000_000

    def now_ns(self) -> int:
        return self.t_ns


@dataclass
class BlockingClock:
    """For what blocks its thread, as a source does: moves only when it is waited on, or by hand; each wait is noted."""

    now: int
    waits: list[float] = field(default_factory=list)

    def now_ns(self) -> int:
        return self.now

    def wall_ns(self) -> int:
        return self.now

    async def sleep(self, seconds: float) -> None:
        raise AssertionError("a source blocks")

    def block(self, seconds: float) -> None:
        assert 0 < seconds < 60
        self.waits.append(seconds)
        self.now += max(1, round(seconds * 1e9))

    def timeout(self, seconds: float) -> asyncio.Timeout:
        raise AssertionError("a source blocks")


class AtOnce(Executor):
    """Virtual time would run away while a real thread works."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        done: Future[Any] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001 - as an executor does
            done.set_exception(error)
        return done


def run(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run to the end in virtual time."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(coroutine)


def in_virtual_time(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """An `async def` test as pytest runs it."""
    return synchronous(test, run)


def in_real_time(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """As above, for what has real threads."""
    return synchronous(test, asyncio.run)


def on_gateway_loop(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """As above, on the event loop of `gateway run`."""
    return synchronous(test, event_loop.run)


def synchronous(
    test: Callable[P, Coroutine[Any, Any, None]], runner: Callable[[Coroutine[Any, Any, None]], None]
) -> Callable[P, None]:
    """An `async def` test as pytest runs it, by `runner`."""

    @wraps(test)
    def called(*args: P.args, **kwargs: P.kwargs) -> None:
        runner(test(*args, **kwargs))

    return called
