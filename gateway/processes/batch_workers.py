"""Who does the tasks of `batch`: processes of this machine, or the workers of a Dask scheduler. IO."""

import select
import sys
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import import_module
from subprocess import Popen
from typing import Any

from gateway import __version__
from gateway.errors import ConfigError, LinkError
from gateway.processes.batch import BatchTask, TaskDone, answer_elsewhere
from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import Codec
from gateway.processes.start import Role, spawned

ANSWERS = Codec(TaskDone | Failed)
MOST_DEATHS = 3  # of the processes that did one task: it ends them


@dataclass(slots=True)
class _Busy:
    number: int
    task: BatchTask
    process: "Popen[bytes]"
    channel: Channel[BatchTask, TaskDone | Failed]

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self.channel.close()


@dataclass(slots=True)
class LocalWorkers:
    """So many processes of this machine, at most. `module`: of the tasks; `run` in it is for `processes.child`."""

    module: str
    count: int
    _waiting: deque[tuple[int, BatchTask]] = field(default_factory=deque)
    _busy: list[_Busy] = field(default_factory=list)
    _idle: list[_Busy] = field(default_factory=list)
    _deaths: Counter[tuple[int, str]] = field(default_factory=Counter)

    def submit(self, number: int, task: BatchTask) -> None:
        self._waiting.append((number, task))

    def done(self) -> Iterator[tuple[int, str]]:
        while self._give():
            ready, _, _ = select.select([worker.channel.sock for worker in self._busy], [], [])
            for worker in [worker for worker in self._busy if worker.channel.sock in ready]:
                for message in worker.channel.received(1):
                    if isinstance(message, Failed):
                        raise ConfigError(message.why) if message.config else LinkError(message.why)
                    self._busy.remove(worker)
                    self._idle.append(worker)
                    yield worker.number, message.result
                if worker.channel.ended:
                    self._lost(worker)

    def close(self) -> None:
        for worker in (*self._busy, *self._idle):
            worker.end()

    def _give(self) -> bool:
        """Work to all that have none. False: all is done."""
        while self._waiting and (self._idle or len(self._busy) < self.count):
            number, task = self._waiting.popleft()
            worker = self._idle.pop() if self._idle else self._begun(number, task)
            worker.number, worker.task = number, task
            worker.channel.offer(task)  # one that has just died is noticed by its closed channel
            self._busy.append(worker)
        return bool(self._busy)

    def _begun(self, number: int, task: BatchTask) -> _Busy:
        channel, theirs = Channel[BatchTask, TaskDone | Failed].pair(ANSWERS)
        with theirs:
            return _Busy(number, task, spawned(Role(self.module, "gw-batch", task), theirs), channel)

    def _lost(self, worker: _Busy) -> None:
        """Its process has died, as by the system where memory is short: another one does its task."""
        self._busy.remove(worker)
        worker.end()
        self._deaths[worker.number, worker.task.after] += 1
        if self._deaths[worker.number, worker.task.after] == MOST_DEATHS:
            raise LinkError(f"{MOST_DEATHS} processes have died at the same task: {worker.task}")
        print("a process has died; another one does its task", file=sys.stderr)
        self._waiting.appendleft((worker.number, worker.task))


class DaskWorkers:
    """Those of a Dask scheduler, which must see the same files under the same paths, with the same version. They are
    sent the name of a module and a task's bytes (docs/decisions/0042-batch.md). Raises ConfigError, LinkError."""

    def __init__(self, module: str, address: str) -> None:
        try:
            dask: Any = import_module("distributed")
        except ImportError:
            raise ConfigError("--dask needs the extra `dask`: pip install 'plc-loading-gateway[dask]'") from None
        self._module = module
        try:
            self._client = dask.Client(address, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise LinkError(f"--dask {address}: {error}") from error
        self._killed: type[Exception] = dask.scheduler.KilledWorker
        self._futures = dask.as_completed(loop=self._client.loop)
        self._numbers: dict[str, int] = {}
        self.count: int = max(1, sum(self._client.nthreads().values()))

    def submit(self, number: int, task: BatchTask) -> None:
        future = self._client.submit(answer_elsewhere, self._module, Codec.packed(task), __version__, pure=False)
        self._numbers[future.key] = number
        self._futures.add(future)

    def done(self) -> Iterator[tuple[int, str]]:
        for future in self._futures:
            try:
                yield self._numbers.pop(future.key), future.result()
            except self._killed as error:
                raise LinkError(f"workers have died at the same task: {error}") from error

    def close(self) -> None:
        self._client.close()
