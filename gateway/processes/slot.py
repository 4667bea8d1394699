"""One child process at a time: start it, exchange messages, kill and reap it. Decides nothing.

A child is a fresh interpreter (spawned, never forked) that runs `gateway.processes.child`. It does not import the
parent's main module, and no helper process is needed beside it. It dies with its parent: the kernel sees to that, even
when the parent is killed without warning.
"""

import asyncio
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Self, TypeVar

from gateway.clock import Clock
from gateway.errors import LinkError
from gateway.processes.channel import Channel, Failed, Gone
from gateway.processes.codec import Codec

log = logging.getLogger(__name__)

GRACE_S = 0.3  # real time between SIGTERM and SIGKILL at the end
KILL_S = 0.3  # real time for the kernel to end a killed process
CRASHES = {signal.SIGSEGV, signal.SIGBUS, signal.SIGILL, signal.SIGFPE, signal.SIGABRT, signal.SIGSYS}
MAX_MESSAGES = 1000  # taken at once: more than its socket holds, and an end for one that never stops
# sys.path travels last: what the parent can import, the child can.
BOOT = "import sys; sys.path[:] = sys.argv.pop().split(chr(10)); from gateway.processes.child import main; main()"
ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",  # numpy's idle threads cost start-up time and memory
    # glibc gives large blocks back to the kernel with every frame, and takes page faults to get them again: at 720p
    # that doubled the time of the paper's pipeline. A process that does the same work for ever keeps its memory.
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": str(16 * 1024**3),
    "MALLOC_ARENA_MAX": "1",  # frames are allocated in one thread and freed in another
    "OPENCV_LOG_LEVEL": "ERROR",
    "OPENCV_FFMPEG_LOGLEVEL": "-8",  # FFmpeg prints every hiccup of a stream; what matters is sent as a message
}


Out = TypeVar("Out")  # messages to the child
In = TypeVar("In")  # and from it


@dataclass(frozen=True, slots=True)
class Role(Generic[Out]):
    """What a child is for: `module` has `run(channel, job)` and the `CODEC` of messages to it; `name` is what `top`
    shows; `fds` it inherits."""

    module: str
    name: str
    job: Out
    fds: tuple[int, ...] = ()
    affinity: tuple[int, ...] | None = None


@dataclass(slots=True)
class Child(Generic[Out, In]):
    """One running process."""

    process: subprocess.Popen[bytes]
    channel: Channel[Out, In | Failed]
    pidfd: int


class ProcessSlot(Generic[Out, In]):
    """A place for one process at a time. Use as `async with`: at the end no process is left. For one event loop.

    `on_arrival` is called on the event loop as soon as something has arrived; it must take it with `messages`. Without
    it, `wait` returns. Taken in the event loop's own call, a result does not wait for a task to be scheduled.
    `codec` reads what the child sends; a child that sends anything else is `Failed`, and killed.
    """

    def __init__(self, label: str, clock: Clock, codec: Codec, on_arrival: Callable[[], None] | None = None) -> None:
        self._codec = codec
        self._label = label
        self._clock = clock
        self._child: Child[Out, In] | None = None
        self._news = asyncio.Event()
        self._on_arrival = on_arrival or self._news.set
        self._ended = False  # the event loop has seen the process end

    def start(self, role: Role[Out]) -> None:
        """Start a process, where there is none, and send it its job. Takes a few ms. Raises LinkError."""
        channel, theirs = Channel[Out, In | Failed].pair(self._codec)
        cpus = ",".join(map(str, role.affinity or ()))
        arguments = [role.module, role.name, str(os.getpid()), str(theirs.fileno()), cpus]
        with theirs, _without_ctrl_c():
            try:
                process = subprocess.Popen(
                    [sys.executable, "-c", BOOT, *arguments, "\n".join(sys.path)],
                    stdin=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(), *role.fds),
                    env={**ENVIRONMENT, **os.environ},
                )
            except OSError as error:
                channel.close()
                raise LinkError(f"cannot start process {role.name}: {error}") from error
        self._watch(Child(process, channel, os.pidfd_open(process.pid)))
        self.send(role.job)

    def send(self, message: Out) -> None:
        """Never waits. A child that does not take its messages is killed; without one nothing is sent."""
        if self._child is not None and not self._child.channel.offer(message):
            self._child.process.kill()

    def kill(self) -> None:
        """At once; `messages` reports when the process has ended."""
        if self._child is not None:
            self._child.process.kill()

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
        status = child.process.poll() if polled else None  # before reading, so that the last messages are not missed
        limit = MAX_MESSAGES if status is not None else most if polled else 1
        arrived: list[In | Failed | Gone] = [*child.channel.received(limit)]
        if status is not None:
            self._forget(child)
            arrived.append(Gone(_how(status), crashed=-status in CRASHES))
        elif child.channel.ended:
            asyncio.get_running_loop().remove_reader(child.channel.sock)
            child.process.kill()  # closed, or no use any more: whatever it still does
        return arrived

    async def wait(self, seconds: float | None) -> None:
        """Until something arrives, at most so long (in seconds of the slot's clock)."""
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
        loop = asyncio.get_running_loop()
        loop.add_reader(child.channel.sock, self._arrived, False)
        loop.add_reader(child.pidfd, self._arrived, True)

    def _arrived(self, ended: bool) -> None:
        self._ended |= ended
        self._on_arrival()

    def _forget(self, child: Child[Out, In]) -> None:
        self._child = None
        loop = asyncio.get_running_loop()
        loop.remove_reader(child.channel.sock)
        loop.remove_reader(child.pidfd)
        child.channel.close()
        os.close(child.pidfd)


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """A child inherits the blocked signal permanently: Ctrl-C reaches all processes of the terminal, only the parent
    decides."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _how(status: int) -> str:
    if status >= 0:
        return f"ended with exit code {status}"
    try:
        return f"was killed by {signal.Signals(-status).name}"
    except ValueError:
        return f"was killed by signal {-status}"
