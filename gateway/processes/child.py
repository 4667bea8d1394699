"""The first lines of every child process: tie its life to the parent's, then do the job that the parent sends.

Started by `start.spawned` as a fresh interpreter with the arguments MODULE NAME PARENT_PID SOCKET_FD CPUS, or forked by
`fork_server`. MODULE is the one whose `run(channel, job)` does the work; only what it imports is loaded. Its `CODEC`
defines which messages it may be sent, its job among them. NAME is what `top` shows.
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
from gateway.logs.setup import setup_child
from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import Codec

PR_SET_PDEATHSIG, PR_SET_NAME = 1, 15  # linux/prctl.h
MAX_CHARACTERS = 500
AFTER_PAGES = 15  # after the camera, the PLC and the pages


def main() -> None:
    name_of_module, name, parent, fd, cpus = sys.argv[1:]
    _name(name)
    work(name_of_module, name, int(parent), socket.socket(fileno=int(fd)), cpus)


def work(name_of_module: str, name: str, parent: int, sock: socket.socket, cpus: str) -> None:
    """In the new process, until its work is done."""
    die_with(parent)
    setup_child()
    channel: Channel[Any, Any] = Channel(sock, Codec(Failed))
    _report_exceptions(channel)
    if cpus:
        try:
            os.sched_setaffinity(0, {int(cpu) for cpu in cpus.split(",")})
        except OSError as error:
            channel.send(Failed(f"cannot run on the CPUs of `affinity`, {cpus}: {error.strerror}"))
            sys.exit(1)
    try:
        module = import_module(name_of_module)
        channel.codec = module.CODEC
        job = channel.receive()
        _name(name)  # now: a forked process that still has its template's name has no job
        module.run(channel, job)
    except GatewayError as error:
        channel.send(Failed(shown(str(error)), config=isinstance(error, ConfigError)))
        sys.exit(1)


def lower_priority(nice: int = AFTER_PAGES) -> None:
    """Of this process, for good. A plant may give the gateway a real-time policy, which the children inherit and which
    ignores `nice`."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(nice)


def die_with(parent: int) -> None:
    """The kernel kills this process when the parent dies, even when the parent is killed without warning."""
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:  # it died before the line above
        os._exit(1)


def _name(name: str) -> None:
    """What `top` and `ps -o comm` show; the kernel keeps 15 characters."""
    ctypes.CDLL(None).prctl(PR_SET_NAME, name.encode()[:15], 0, 0, 0)


def shown(text: str) -> str:
    """Text fit for a message and a log: a path in it need not be UTF-8, a driver's text may have many lines."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[:MAX_CHARACTERS])


def _report_exceptions(channel: Channel[Any, Any]) -> None:
    """An unexpected exception is reported to the parent, too, after its traceback has gone to stderr."""

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        sys.__excepthook__(kind, error, trace)  # first: the parent ends this process when it reads it
        sys.stderr.flush()
        channel.send(Failed(shown(f"{kind.__name__}: {error}")))

    sys.excepthook = hook
