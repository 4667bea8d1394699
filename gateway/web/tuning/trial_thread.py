"""The one thread on which pictures are worked on for technicians: the newest request wins, and nothing queues up.

Every caller has one place in the queue. A new request withdraws an older one of the same caller that waits or runs: the
older one ends as soon as it notices, and its caller gets EndedError.
"""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import TypeVar

from gateway.errors import GatewayError
from gateway.web.tuning.trial import EndedError

MAX_WAITING = 8  # visitors

T = TypeVar("T")


class TrialsBusyError(GatewayError):
    """Too many people are trying settings."""


class TrialThread:
    """One event loop, one thread: `thread`, or its own."""

    def __init__(self, thread: Executor | None = None) -> None:
        self._thread = thread or ThreadPoolExecutor(1, thread_name_prefix="tuning")
        self._turn = asyncio.Lock()
        self._withdrawn: dict[str, threading.Event] = {}  # of each caller's newest request

    async def work(self, who: str, what: Callable[[Callable[[], bool]], T]) -> T:
        """Do `what` on the thread; its argument is a function that it calls now and then: is this still wanted?

        Raises EndedError when `who` requested something newer meanwhile, TrialsBusyError when too many others wait.
        """
        self.withdraw(who)
        if len(self._withdrawn) >= MAX_WAITING:
            raise TrialsBusyError("too many people are trying settings just now; try again in a moment")
        withdrawn = self._withdrawn[who] = threading.Event()

        def wanted() -> bool:
            return not withdrawn.is_set()

        try:
            async with self._turn:
                if not wanted():
                    raise EndedError("given up for a newer one")
                # If the waiting is cancelled, the thread gets to know below that it is not wanted; the next queues
                # behind it.
                result = await asyncio.get_running_loop().run_in_executor(self._thread, what, wanted)
            if not wanted():
                raise EndedError("given up for a newer one")
            return result
        finally:
            withdrawn.set()
            if self._withdrawn.get(who) is withdrawn:
                del self._withdrawn[who]

    def withdraw(self, who: str) -> None:
        """Take back what `who` has waiting or running, if anything."""
        if who in self._withdrawn:
            self._withdrawn.pop(who).set()

    def close(self) -> None:
        """Takes back what runs or waits, and ends the thread, which may take as long as one run on a picture."""
        for withdrawn in self._withdrawn.values():
            withdrawn.set()
        self._thread.shutdown(wait=True, cancel_futures=True)
