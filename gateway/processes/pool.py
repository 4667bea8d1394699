"""A few child processes: start them, exchange messages, kill and reap them. Decides nothing.

Every child is a fresh interpreter (spawned, never forked) that runs `gateway.processes.child`. It does not import the
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
from contextlib import contextmanager
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
MAX_MESSAGES = 1000  # of one child, taken at once: more than its socket holds, and an end for one that never stops
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


Out = TypeVar("Out")  # messages to the children
In = TypeVar("In")  # and from them


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


class Pool(Generic[Out, In]):
    """Use as `async with`: at the end no process is left. Not for more than one event loop.

    `on_arrival` is called on the event loop as soon as something has arrived; it must take it with `messages`. Without
    it, `wait` returns. Taken in the event loop's own call, a result does not wait for a task to be scheduled.
    `codec` reads what the children send; a child that sends anything else is `Failed`, and killed.
    """

    def __init__(self, label: str, clock: Clock, codec: Codec, on_arrival: Callable[[], None] | None = None) -> None:
        self._codec = codec
        self._label = label
        self._clock = clock
        self._children: dict[int, Child[Out, In]] = {}
        self._news = asyncio.Event()
        self._on_arrival = on_arrival or self._news.set
        self._readable: set[int] = set()  # whose sockets can be read
        self._ended: set[int] = set()  # whose processes have ended

    def start(self, token: int, role: Role[Out]) -> None:
        """Start a process and send it its job. Takes a few ms. Raises LinkError."""
        channel, theirs = Channel[Out, In | Failed].pair(self._codec)
        cpus = ",".join(map(str, role.affinity or ()))
        words = [role.module, role.name, str(os.getpid()), str(theirs.fileno()), cpus]
        with theirs, _without_ctrl_c():
            try:
                process = subprocess.Popen(
                    [sys.executable, "-c", BOOT, *words, "\n".join(sys.path)],
                    stdin=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(), *role.fds),
                    env={**ENVIRONMENT, **os.environ},
                )
            except OSError as error:
                channel.close()
                raise LinkError(f"cannot start process {role.name}: {error}") from error
        child = Child(process, channel, os.pidfd_open(process.pid))
        self._children[token] = child
        loop = asyncio.get_running_loop()
        loop.add_reader(channel.sock, self._arrived, self._readable, token)
        loop.add_reader(child.pidfd, self._arrived, self._ended, token)
        self.send(token, role.job)

    def send(self, token: int, message: Out) -> None:
        """Never waits. A child that does not take its messages is killed; one that has ended is ignored."""
        child = self._children.get(token)
        if child is not None and not child.channel.offer(message):
            child.process.kill()

    def kill(self, token: int) -> None:
        """At once; `messages` reports when the process has ended."""
        if (child := self._children.get(token)) is not None:
            child.process.kill()

    def wake(self) -> None:
        """Let `wait` return."""
        self._news.set()

    def _arrived(self, where: set[int], token: int) -> None:
        where.add(token)
        self._on_arrival()

    def messages(self, *, every: bool = True, most: int = MAX_MESSAGES) -> Iterator[tuple[int, In | Failed | Gone]]:
        """All that has arrived; `Gone` is the last message of each process, once. Never waits.

        Without `every` only from those that the event loop has seen send or end, and only the oldest of each that
        has not ended: it will see the others, too. That spares some system calls. Of one that sends faster than it is
        read no more than `most` are taken at once; the event loop sees the rest.
        """
        ended, active = set(self._ended), self._readable | self._ended
        self._readable.clear()  # not replaced: the event loop's readers hold these very sets
        self._ended.clear()
        found: list[tuple[int, Child[Out, In], int | None, list[In | Failed]]] = []
        for token, child in self._children.items():
            if not every and token not in active:
                continue
            polled = every or token in ended
            # Before reading, so that the last messages are not missed.
            status = child.process.poll() if polled else None
            limit = MAX_MESSAGES if status is not None else most if polled else 1
            found.append((token, child, status, child.channel.received(limit)))
        for token, child, status, arrived in found:
            for message in arrived:
                yield token, message
            if status is not None:
                self._forget(token)
                yield token, Gone(_how(status), crashed=-status in CRASHES)
            elif child.channel.ended:
                asyncio.get_running_loop().remove_reader(child.channel.sock)
                child.process.kill()  # closed, or no use any more: whatever it still does

    async def wait(self, seconds: float | None) -> None:
        """Until something arrives, at most so long (in seconds of the pool's clock)."""
        if seconds is None:
            await self._news.wait()
        else:
            try:
                async with self._clock.timeout(seconds):
                    await self._news.wait()
            except TimeoutError:
                pass
        self._news.clear()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """SIGTERM, a short grace, SIGKILL; every process is reaped."""
        self._on_arrival = self._news.set
        try:
            for child in self._children.values():
                child.process.terminate()
            async with asyncio.timeout(GRACE_S):
                while self._children:
                    for _ in self.messages():
                        pass
                    if self._children:
                        await self.wait(None)
        except TimeoutError:
            pass
        finally:
            for child in self._children.values():
                child.process.kill()
            for token, child in list(self._children.items()):
                try:
                    child.process.wait(KILL_S)
                except subprocess.TimeoutExpired:
                    log.error("%s: process %d cannot be killed", self._label, child.process.pid)
                self._forget(token)

    def _forget(self, token: int) -> None:
        child = self._children.pop(token)
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
