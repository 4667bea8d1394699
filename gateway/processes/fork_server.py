"""The template's own side: a process without threads that forks itself into others (`template` is the main process's).

A forked process shares all memory that neither side writes: code, libraries' tables, Python's modules. It is forked
twice, and the process between ends at once: so it becomes a child of the main process, which is set to inherit orphans
(PR_SET_CHILD_SUBREAPER), is reaped by it and ended with it, and does not depend on the template any more.
"""

import fcntl
import gc
import os
import select
import socket
import sys
from typing import NoReturn

from gateway.errors import LinkError
from gateway.processes import child
from gateway.processes.channel import Channel
from gateway.processes.codec import Message

REPARENTED_S = 0.0002  # between two looks whether the process between has ended


class Fork(Message, frozen=True):
    """Become this role, in a new process. With it travel its channel and the descriptors of the role."""

    number: int  # of the request
    module: str
    name: str
    cpus: str
    fds: tuple[int, ...] = ()  # the numbers that the role's descriptors have in the main process


class Preloaded(Message, frozen=True):
    """Everything is imported: it takes requests."""


class Forked(Message, frozen=True):
    """The process is there, and waits for its job. `pid` 0: it could not be made."""

    number: int
    pid: int
    why: str = ""


def serve(channel: Channel[Preloaded | Forked, Fork]) -> NoReturn:
    """Until the main process has ended. Raises LinkError where a library has started threads: a fork would leave their
    locks held for ever."""
    if (threads := len(os.listdir("/proc/self/task"))) > 1:
        raise LinkError(f"{threads} threads are running, and a process with threads can't be forked")
    parent = os.getppid()
    gc.collect()
    gc.freeze()  # a collection in a forked process would write to, and so copy, every object
    channel.send(Preloaded())
    while True:
        request, fds = channel.receive_with_fds()
        try:
            channel.send(_forked(request, fds, parent, channel))
        finally:
            for fd in fds:
                os.close(fd)


def _forked(request: Fork, fds: list[int], parent: int, channel: Channel[Preloaded | Forked, Fork]) -> Forked:
    """Answers when the new process has the main process as its parent."""
    reading, writing = os.pipe()
    try:
        between = os.fork()
    except OSError as error:
        os.close(writing)
        os.close(reading)
        return Forked(request.number, 0, str(error))
    if not between:
        _fork_again(request, fds, parent, writing, channel.sock)
    os.close(writing)
    pid = int.from_bytes(os.read(reading, 4), "little")
    os.close(reading)
    os.waitpid(between, 0)
    return Forked(request.number, pid, "" if pid else "the machine has no room for another process")


def _fork_again(request: Fork, fds: list[int], parent: int, writing: int, templates: socket.socket) -> NoReturn:
    """In the process between; and, in the one that it forks, the role. Nothing of the template's runs after it."""
    code = 1
    try:
        between = os.getpid()
        pid = os.fork()
        if pid:
            os.write(writing, pid.to_bytes(4, "little"))
            code = 0
        else:
            templates.detach()  # its number may become another descriptor's
            code = _role(request, fds, between, parent)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _role(request: Fork, fds: list[int], between: int, parent: int) -> int:
    """The exit code."""
    while os.getppid() == between:
        select.select([], [], [], REPARENTED_S)
    sock = _descriptors(request.fds, fds)
    try:
        child.work(request.module, request.name, parent, sock, request.cpus)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except BaseException as error:  # noqa: BLE001 - reported as an interpreter does at its end
        sys.excepthook(type(error), error, error.__traceback__)
        return 1
    return 0


def _descriptors(numbers: tuple[int, ...], received: list[int]) -> socket.socket:
    """Give the role's descriptors the numbers that they have in the main process, and close all but these, stdin,
    stdout and stderr. Returns the channel's socket."""
    above = max(numbers, default=2) + 1
    channel, *others = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, above) for fd in received]
    for fd, number in zip(others, numbers, strict=True):
        os.dup2(fd, number, inheritable=False)
    kept = {0, 1, 2, channel, *numbers}
    for fd in {int(name) for name in os.listdir("/proc/self/fd")} - kept:
        try:
            os.close(fd)
        except OSError:  # the listing's own
            continue
    return socket.socket(fileno=channel)
