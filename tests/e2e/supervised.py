"""What the plants of the MQTT tests share: a table of tasks that runs, and patience until something holds."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

from gateway.supervisor import Supervisor


class Supervised:
    """`supervisor` and `watched`, the task whose record explains a wait in vain, are set by who derives from it."""

    supervisor: Supervisor
    watched: str
    patience_s = 30.0

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        async with asyncio.TaskGroup() as group:
            supervised = group.create_task(self.supervisor.run())
            yield
            supervised.cancel()

    async def until(self, fact: Callable[[], Any], timeout_s: float | None = None) -> float:
        """Seconds until `fact` held; fails after `timeout_s`, or `patience_s`."""
        allowed_s = self.patience_s if timeout_s is None else timeout_s
        begun = time.monotonic()
        while not fact():
            assert time.monotonic() - begun < allowed_s, self.supervisor.records[self.watched]
            await asyncio.sleep(0.01)
        return time.monotonic() - begun
