"""One child process at a time: start it, exchange messages, kill and reap it. Decides nothing.

A child is a fresh interpreter, or forked from a template without threads (`template`); it runs
`gateway.processes.child`. It dies with its parent: the kernel sees to that, even when the parent is killed without
warning.
"""

import asyncio
import logging
import os
import signal
import socket
import subprocess
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from functools import partial
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from gateway.clock import Clock
from gateway.core import details
from gateway.errors import LinkError
from gateway.processes.channel import Channel, Failed, Gone
from gateway.processes.codec import Codec
from gateway.processes.start import NOT_STARTED, Process, Role, spawned

log = logging.getLogger(__name__)

GRACE_S = 0.3  # real time between SIGTERM and SIGKILL at the end
KILL_S = 0.3  # real time for the kernel to end a killed process
CRASHES = {signal.SIGSEGV, signal.SIGBUS, signal.SIGILL, signal.SIGFPE, signal.SIGABRT, signal.SIGSYS}
MAX_MESSAGES = 1000  # taken at once: more than its socket holds, and an end for one that never stops


Out = TypeVar("Out")  # messages to the child
In = TypeVar("In")  # and from it


@dataclass(slots=True)
class Child(Generic[Out, In]):
    """One process: running, or asked for."""

    process: Process | None  # None: the template has not answered yet
    channel: Channel[Out, In | Failed]
    pidfd: int = -1
    given_up: bool = False  # before there was a process
    unsent: list[tuple[Out, Sequence[int]]] = field(default_factory=list)  # until there is a process

    def status(self) -> int | None:
        """Exit code; None: it runs, or is about to."""
        if self.process is None:
            return NOT_STARTED if self.given_up else None
        return self.process.poll()


class Template(Protocol):
    """Starts a process by forking: see `template.ProcessTemplate`."""

    def start(self, role: Role[Any], theirs: socket.socket, answer: Callable[[Process | None], bool]) -> None: ...


class ProcessSlot(Generic[Out, In]):
    """A place for one process at a time. Use as `async with`: at the end no process is left. For one event loop.

    `on_arrival` is called on the event loop as soon as something has arrived; it must take it with `messages`. Without
    it, `wait` returns. Taken in the event loop's own call, a result does not wait for a task to be scheduled.
    `codec` reads what the child sends; a child that sends anything else is `Failed`, and killed. `template`: processes
    are forked from it; None: each is a fresh interpreter.
    """

    def __init__(
        self,
        label: str,
        clock: Clock,
        codec: Codec,
        on_arrival: Callable[[], None] | None = None,
        template: Template | None = None,
    ) -> None:
        self._codec = codec
        self._label = label
        self._clock = clock
        self._template = template
        self._child: Child[Out, In] | None = None
        self._news = asyncio.Event()
        self._on_arrival = on_arrival or self._news.set
        self._ended = False  # the event loop has seen the process end

    def start(self, role: Role[Out]) -> None:
        """Start a process, where there is none, and send it its job. Takes a few ms. Raises LinkError."""
        channel, theirs = Channel[Out, In | Failed].pair(self._codec)
        child = Child[Out, In](None, channel)
        self._watch(child)
        try:
            if self._template is not None:
                self._template.start(role, theirs, partial(self._begun, child, role.job))
                return
            with theirs:
                process = spawned(role, theirs)
        except LinkError:
            self._forget(child)
            raise
        self._begun(child, role.job, process)

    @property
    def made(self) -> bool:
        """Whether there is a process: its template may still have to make it."""
        return self._child is not None and self._child.process is not None

    def send(self, message: Out, fds: Sequence[int] = ()) -> None:
        """Never waits. A child that does not take its messages is killed; without one nothing is sent. One that the
        template has still to make gets its messages after its job."""
        if (child := self._child) is None:
            return
        if child.process is None:
            child.unsent.append((message, fds))
        elif not child.channel.offer(message, fds):
            child.process.kill()

    def kill(self) -> None:
        """At once; `messages` reports when the process has ended."""
        if (child := self._child) is None:
            return
        if child.process is not None:
            child.process.kill()
        else:
            self._give_up(child)

    def wake(self) -> None:
        """Let `wait` return."""
        self._news.set()

    def messages(self, *, every: bool = True, most: int = MAX_MESSAGES) -> list[In | Failed | Gone]:
        """All that has arrived; `Gone` is the last message of a process, once. Never waits.

        Without `every`, for `on_arrival`: only the oldest, unless the process has ended; the event loop calls again for
        the others. That spares some system calls. Of a child that sends faster than it is read no more than `most` are
        taken at once.
        """
        child = self._child
        if child is None:
            return []
        polled, self._ended = every or self._ended, False
        status = child.status() if polled else None  # before reading, so that the last messages are not missed
        limit = MAX_MESSAGES if status is not None else most if polled else 1
        arrived: list[In | Failed | Gone] = [*child.channel.received(limit)]
        if status is not None:
            self._forget(child)
            arrived.append(Gone(_how(status), crashed=-status in CRASHES))
        elif child.channel.ended:
            asyncio.get_running_loop().remove_reader(child.channel.sock)
            self.kill()  # closed, or no use any more: whatever it still does
        return arrived

    async def wait(self, seconds: float | None) -> None:
        """Until something arrives, at most this long (in seconds of the slot's clock)."""
        with suppress(TimeoutError):
            async with self._clock.timeout(seconds) if seconds is not None else nullcontext():
                await self._news.wait()
        self._news.clear()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """SIGTERM, a short grace, SIGKILL; the process is reaped."""
        if (child := self._child) is None:
            return
        if child.process is None:  # what the template may still make has no job
            self._forget(child)
            return
        self._on_arrival = self._news.set
        try:
            child.process.terminate()
            with suppress(TimeoutError):
                async with asyncio.timeout(GRACE_S):
                    self.messages()
                    while self._child is not None:
                        await self.wait(None)
                        self.messages()
        finally:
            if self._child is not None:
                child.process.kill()
                try:
                    child.process.wait(KILL_S)
                except subprocess.TimeoutExpired:
                    log.error("%s: process %d cannot be killed", self._label, child.process.pid)
                self._forget(child)

    def _watch(self, child: Child[Out, In]) -> None:
        self._child, self._ended = child, False
        asyncio.get_running_loop().add_reader(child.channel.sock, self._arrived, False)

    def _begun(self, child: Child[Out, In], job: Out, process: Process | None) -> bool:
        """There is a process: it gets its job. None: there will be none. False: it is not wanted any more."""
        if self._child is not child or child.given_up:
            return False
        if process is None:
            self._give_up(child)
            return True
        child.process = process
        child.pidfd = os.pidfd_open(process.pid)
        asyncio.get_running_loop().add_reader(child.pidfd, self._arrived, True)
        self.send(job)
        for message, fds in child.unsent:
            self.send(message, fds)
        child.unsent.clear()
        return True

    def _give_up(self, child: Child[Out, In]) -> None:
        child.given_up = True
        self._arrived(True)

    def _arrived(self, ended: bool) -> None:
        self._ended |= ended
        self._on_arrival()

    def _forget(self, child: Child[Out, In]) -> None:
        self._child = None
        loop = asyncio.get_running_loop()
        loop.remove_reader(child.channel.sock)
        child.channel.close()
        if child.pidfd >= 0:
            loop.remove_reader(child.pidfd)
            os.close(child.pidfd)


def _how(status: int) -> str:
    if status == NOT_STARTED:
        return details.COULD_NOT_START()
    if status >= 0:
        return details.EXIT_CODE(status)
    try:
        return details.KILLED_BY(signal.Signals(-status).name)
    except ValueError:
        return details.KILLED_BY(f"signal {-status}")
