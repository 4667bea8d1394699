"""The table of tasks, and the one place that starts them, restarts them and catches broadly.

A LinkError or ProtocolError is normal in a plant: the task is restarted after a jittered exponential backoff, without
limit. Any other exception is a bug: it is logged with its traceback, and the task is restarted, too. A `vital` task
(fusion) may crash only `max_crashes` times within `window_s`; then the gateway gives up, because a control path that
keeps crashing must not look alive. Any other task may crash any number of times without affecting the rest: what it no
longer delivers becomes stale. A ConfigError ends the gateway at once: only the operator can correct it.
"""

import asyncio
import logging
import random
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field

from gateway.clock import Clock
from gateway.config import Reconnect
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError, GatewayError, LinkError, ProtocolError

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Task:
    """One row of the table. `factory` is called anew for every start; a normal return ends the task."""

    name: str
    factory: Callable[[], Awaitable[None]]
    backoff: Reconnect = field(default_factory=Reconnect)
    vital: bool = False
    max_crashes: int = 5  # of a vital task
    window_s: float = 60.0


class CrashLoopError(GatewayError):
    """A task crashed more often than its row allows."""


@dataclass(slots=True)
class TaskRecord:
    """State of one task; for health pages and tests."""

    starts: int = 0
    link_errors: int = 0
    crashes: int = 0
    running: bool = False
    last_error: str = ""


class Supervisor:
    """Runs a table of tasks until cancelled or until one of them must not be restarted any more."""

    def __init__(
        self,
        tasks: Sequence[Task],
        clock: Clock,
        rng: random.Random | None = None,
        records: dict[str, TaskRecord] | None = None,
    ) -> None:
        """`records`: those of several tables, to which those of this one are added."""
        names = [task.name for task in tasks]
        if len(set(names)) != len(names):
            raise ValueError(f"task names must differ: {names}")
        self._tasks = tuple(tasks)
        self._clock = clock
        self._rng = rng or random.Random()
        self.records = {} if records is None else records
        self.records.update((name, TaskRecord()) for name in names)

    async def run(self) -> None:
        """Raises ConfigError or CrashLoopError (in an ExceptionGroup) when a task can't be restarted."""
        async with asyncio.TaskGroup() as group:
            for task in self._tasks:
                group.create_task(self._supervise(task), name=f"supervise {task.name}")

    async def _supervise(self, task: Task) -> None:
        record = self.records[task.name]
        crashes: deque[int] = deque()
        attempt = 0
        while True:
            started_ns = self._clock.now_ns()
            failure = await self._run_once(task, record)
            if failure is None:
                return
            now_ns = self._clock.now_ns()
            if now_ns - started_ns > task.backoff.max_s * NS_PER_S:
                attempt = 0  # it had run without failure for a while
            if isinstance(failure, LinkError | ProtocolError):
                record.link_errors += 1
                record.last_error = str(failure)
                if attempt == 0:  # only the first failure of a series is a warning
                    log.warning("%s: %s; trying again", task.name, failure, extra={"fields": {"task": task.name}})
                else:
                    log.debug("%s: %s", task.name, failure)
            else:
                record.crashes += 1
                record.last_error = repr(failure)
                if task.vital or attempt == 0:
                    log.error("%s crashed", task.name, exc_info=failure, extra={"fields": {"task": task.name}})
                else:
                    log.error("%s crashed again: %r", task.name, failure)
                crashes.append(now_ns)
                while now_ns - crashes[0] > task.window_s * NS_PER_S:
                    crashes.popleft()
                if task.vital and len(crashes) > task.max_crashes:
                    raise CrashLoopError(
                        f"{task.name} crashed {len(crashes)} times in {task.window_s:g} s"
                    ) from failure
            attempt += 1
            await self._clock.sleep(delay_s(task.backoff, attempt, self._rng))

    async def _run_once(self, task: Task, record: TaskRecord) -> BaseException | None:
        """Run one start to its end: None, or what ended it. Raises ConfigError, and CancelledError when cancelled."""
        record.starts += 1
        record.running = True
        try:
            # In a separate asyncio task: in Python before 3.13 a task group whose children fail at the same time may
            # leave its task counted as cancelled for ever, and here that count must mean that the supervisor ends.
            await asyncio.create_task(_start(task), name=task.name)  # noqa: TID251
        except ConfigError:
            raise
        except asyncio.CancelledError as error:
            if _cancel_requested():
                raise
            return error  # not requested: passed on, it would end the task silently
        except Exception as error:
            if _cancel_requested():  # failed while it cleaned up; a restart would keep the gateway from ending
                log.warning("%s: while ending: %r", task.name, error)
                raise asyncio.CancelledError from error
            return error
        finally:
            record.running = False
        return None


async def _start(task: Task) -> None:
    await task.factory()


def _cancel_requested() -> bool:
    """Has the running task been cancelled?"""
    current = asyncio.current_task()
    return current is not None and current.cancelling() > 0


def delay_s(backoff: Reconnect, attempt: int, rng: random.Random) -> float:
    """Exponential backoff with full jitter above the minimum: min <= delay <= min(max, min * 2^attempt)."""
    ceiling = min(backoff.max_s, backoff.min_s * 2.0 ** min(attempt, 32))
    return rng.uniform(backoff.min_s, ceiling) if ceiling > backoff.min_s else ceiling
