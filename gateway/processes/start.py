"""Start of one child process: a fresh interpreter. Decides nothing.

It runs `gateway.processes.child`, does not import the parent's main module, and needs no helper process beside it.
"""

import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from gateway.errors import LinkError

# sys.path travels last: what the parent can import, the child can.
BOOT = "import sys; sys.path[:] = sys.argv.pop().split(chr(10)); from gateway.processes.child import main; main()"
ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",  # numpy's idle threads cost start-up time and memory
    # glibc gives large blocks back to the kernel with every frame, and takes page faults to get them again: at 720p
    # that doubled the time of the paper's pipeline. A process that does the same work for ever keeps its memory.
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": str(16 * 1024**3),
    "MALLOC_ARENA_MAX": "1",  # frames are allocated in one thread and freed in another
    "OPENCV_IO_MAX_IMAGE_PIXELS": str(1 << 27),  # decoded, 400 MB: a few bytes of a camera can claim gigabytes
    "OPENCV_LOG_LEVEL": "ERROR",
    "OPENCV_FFMPEG_LOGLEVEL": "-8",  # FFmpeg prints every hiccup of a stream; what matters is sent as a message
}
NOT_STARTED = 256  # no process has this exit code

Job = TypeVar("Job")


@dataclass(frozen=True, slots=True)
class Role(Generic[Job]):
    """What a child is for: `module` has `run(channel, job)` and the `CODEC` of messages to it; `name` is what `top`
    shows; `fds` it inherits."""

    module: str
    name: str
    job: Job
    fds: tuple[int, ...] = ()
    affinity: tuple[int, ...] | None = None

    @property
    def cpus(self) -> str:
        return ",".join(map(str, self.affinity or ()))


class Process(Protocol):
    """As `subprocess.Popen`: what has ended is reaped by `poll` or `wait`, once."""

    @property
    def pid(self) -> int: ...

    def poll(self) -> int | None: ...

    def wait(self, timeout: float | None = None) -> int: ...

    def terminate(self) -> None: ...

    def kill(self) -> None: ...


class ForkedProcess:
    """A child of this process that another one has forked (`template`). Its pid is not used again until it is reaped
    here."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._status: int | None = None

    def poll(self) -> int | None:
        if self._status is None:
            try:
                pid, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:  # reaped by somebody else: how it ended is not known
                self._status = NOT_STARTED
            else:
                self._status = os.waitstatus_to_exitcode(status) if pid else None
        return self._status

    def wait(self, timeout: float | None = None) -> int:
        """Raises TimeoutExpired."""
        if (status := self.poll()) is not None:
            return status
        pidfd = os.pidfd_open(self.pid)
        try:
            select.select([pidfd], [], [], timeout)
        finally:
            os.close(pidfd)
        if (status := self.poll()) is None:
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        return status

    def terminate(self) -> None:
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)


def spawned(role: Role[Job], theirs: socket.socket) -> "subprocess.Popen[bytes]":
    """A fresh interpreter with the role, which reads its job from the socket. Takes a few ms. Raises LinkError."""
    arguments = [role.module, role.name, str(os.getpid()), str(theirs.fileno()), role.cpus]
    with _without_ctrl_c():
        try:
            return subprocess.Popen(
                [sys.executable, "-c", BOOT, *arguments, "\n".join(sys.path)],
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(), *role.fds),
                env={**ENVIRONMENT, **os.environ},
            )
        except OSError as error:
            raise LinkError(f"cannot start process {role.name}: {error}") from error


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """A child inherits the blocked signal permanently: Ctrl-C reaches all processes of the terminal, only the parent
    decides."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
