"""The first lines of every child process: tie its life to the parent's, then do the job that the parent sends.

Started by `pool` as a fresh interpreter with the arguments ROLE BAY PARENT_PID SOCKET_FD CPUS. ROLE names the module of
this package whose `run(link, job)` does the work; only what that module imports is loaded.
"""

import ctypes
import os
import signal
import socket
import sys
from importlib import import_module
from types import TracebackType
from typing import Any

from gateway.errors import ConfigError, GatewayError
from gateway.vision.jobs import Failed
from gateway.vision.link import Link

PR_SET_PDEATHSIG, PR_SET_NAME = 1, 15  # linux/prctl.h
MAX_WORDS = 500


def main() -> None:
    role, bay, parent, fd, cpus = sys.argv[1:]
    _die_with(int(parent))
    _name(f"gw-{role}-{bay}")
    link: Link[Any, Any] = Link(socket.socket(fileno=int(fd)))
    _leave_last_words(link)
    if cpus:
        try:
            os.sched_setaffinity(0, {int(cpu) for cpu in cpus.split(",")})
        except OSError as error:
            link.send(Failed(f"cannot run on the CPUs of `affinity`, {cpus}: {error.strerror}"))
            sys.exit(1)
    try:
        import_module(f"gateway.vision.{role}").run(link, link.receive())
    except GatewayError as error:
        link.send(Failed(str(error)[:MAX_WORDS], config=isinstance(error, ConfigError)))
        sys.exit(1)


def _die_with(parent: int) -> None:
    """The kernel kills this process when the parent dies, even when the parent is killed without warning."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:  # it died before the line above
        os._exit(1)


def _name(name: str) -> None:
    """What `top` and `ps -o comm` show; the kernel keeps 15 characters."""
    ctypes.CDLL(None).prctl(PR_SET_NAME, name.encode()[:15], 0, 0, 0)


def _leave_last_words(link: Link[Any, Any]) -> None:
    """An unexpected exception is told to the parent, too, after its traceback has gone to stderr."""

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        sys.__excepthook__(kind, error, trace)  # first: the parent ends this process when it hears of it
        sys.stderr.flush()
        link.send(Failed(f"{kind.__name__}: {error}"[:MAX_WORDS]))

    sys.excepthook = hook
