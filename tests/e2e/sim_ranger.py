"""A simulated ranger on a pty, in a thread of the test."""

import asyncio
import threading
from types import TracebackType
from typing import Self

from gateway.clock import SystemClock
from gateway.sim.ranger import SimulatedRanger
from gateway.sim.ranger_board import RangerFault


class Ranger:
    """A context manager: a simulated HC-SR04 whose distance and faults are set by hand."""

    def __init__(self) -> None:
        self.distance_mm = 500.0
        self.port = ""
        self.forced: dict[RangerFault, float] = {}
        self._ready = threading.Event()
        self._end = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        assert self._ready.wait(10)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join(10)

    async def _run(self) -> None:
        async with SimulatedRanger(lambda _: self.distance_mm, SystemClock()) as board:
            self.port = board.port
            self.forced = board.forced
            self._ready.set()
            async with asyncio.TaskGroup() as group:
                work = group.create_task(board.run())
                await asyncio.to_thread(self._end.wait)
                work.cancel()
