"""The main process's side of a template: a process that has imported what its roles need, and is forked into them.

A forked process shares the template's memory and starts within milliseconds. It is a child of this process, as a
spawned one is: watched, ended and reaped in the same way. A template that ends or hangs affects no process that it has
forked; it is replaced, and meanwhile, or where none can be started, processes are spawned.
"""

import asyncio
import ctypes
import logging
import os
import signal
import socket
import subprocess
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from gateway.clock import SystemClock
from gateway.errors import LinkError
from gateway.processes.channel import Failed, Gone
from gateway.processes.codec import Codec
from gateway.processes.deadlines import StartDeadline
from gateway.processes.fork_server import Fork, Forked, Preloaded
from gateway.processes.slot import ProcessSlot
from gateway.processes.start import ForkedProcess, Process, Role, spawned

log = logging.getLogger(__name__)

PR_SET_CHILD_SUBREAPER = 36  # linux/prctl.h
READY_S = 30.0  # real time; what has waited this long for a template is spawned; a first start may take no longer
ANSWER_S = 2.0  # a template that has not answered a request by then is replaced; a fork is a start, too
KILL_S = 0.3  # for a killed process to end
REAP_S = 0.05  # between two looks whether it has

Answer = Callable[[Process | None], bool]


@dataclass(slots=True)
class _Request:
    role: Role[Any]
    theirs: socket.socket
    answer: Answer
    due_s: float = 0.0  # of the answer, by the event loop's time; once it was sent


class ProcessTemplate:
    """A row of the task table. `start` may be called before `run` and between two runs. For one event loop."""

    def __init__(self, role: Role[Any]) -> None:
        self._role = role
        self._slot: ProcessSlot[Any, Any] | None = None
        self._starting = True  # requests wait for it
        self._ready = False
        self._waiting: list[_Request] = []
        self._sent: dict[int, _Request] = {}
        self._number = 0
        self._forked: list[ForkedProcess] = []  # not reaped yet
        self._unwanted: list[Process] = []  # killed, to be reaped
        self._start_deadline, self._answer_deadline = StartDeadline(READY_S), StartDeadline(ANSWER_S)

    def start(self, role: Role[Any], theirs: socket.socket, answer: Answer) -> None:
        """A process with this role and the other end of its channel, which is closed here. `answer` gets the process,
        at once or later on the event loop; or None: it could not be made. It returns False where the process is not
        wanted any more. Raises LinkError, when no answer follows."""
        request = _Request(role, theirs, answer)
        if self._ready:
            self._send(request)
        elif self._starting:
            self._waiting.append(request)
        else:
            with theirs:
                process = spawned(role, theirs)
            self._report(request, process)

    async def run(self) -> None:
        """Until cancelled. Raises LinkError when the template ends, can't be used or does not answer."""
        _inherit_orphans(True)
        self._starting = True
        try:
            async with ProcessSlot[Any, Any](self._role.name, SystemClock(), Codec(_FROM_TEMPLATE)) as self._slot:
                await self._serve(self._slot)
        except LinkError:
            self._spawn_waiting()
            raise
        finally:
            self._ready = self._starting = False
            self._slot = None
            _end_strays(self._role.name, {process.pid for process in self._forked if process.poll() is None})
            _inherit_orphans(False)
            for process in self._unwanted:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(KILL_S)
            self._unwanted = []
            unanswered = [*self._sent.values(), *self._waiting]
            self._sent, self._waiting = {}, []
            for request in unanswered:
                request.theirs.close()
                request.answer(None)

    async def _serve(self, slot: ProcessSlot[Any, Any]) -> None:
        slot.start(self._role)
        begun_s = ready_s = _now_s()
        while True:
            for message in slot.messages():
                match message:
                    case Preloaded():
                        self._ready, ready_s, waiting = True, _now_s(), self._waiting
                        self._waiting = []
                        for request in waiting:
                            self._send(request)
                    case Forked(number, pid, why):
                        self._forked_one(number, pid, why)
                        for deadline in (self._start_deadline, self._answer_deadline):
                            deadline.ran(_now_s() - ready_s)
                    case Failed(why):
                        raise LinkError(why)
                    case Gone(how):
                        raise LinkError(f"the template {how}")
            self._unwanted = [process for process in self._unwanted if process.poll() is None]
            now_s = _now_s()
            if not self._ready and now_s - begun_s >= (allowed_s := self._start_deadline.seconds):
                self._start_deadline.missed()
                raise LinkError(f"the template was not ready within {allowed_s:g} s")
            if not self._ready and self._starting and now_s - begun_s >= READY_S:
                self._starting = False
                self._spawn_waiting()
            if any(now_s >= request.due_s for request in self._sent.values()):
                allowed_s = self._answer_deadline.seconds
                self._answer_deadline.missed()
                raise LinkError(f"the template has not answered for {allowed_s:g} s")
            await slot.wait(self._left_s(now_s, begun_s))

    def _left_s(self, now_s: float, begun_s: float) -> float | None:
        due_s = [request.due_s for request in self._sent.values()]
        if not self._ready:
            due_s.append(begun_s + (READY_S if self._starting else self._start_deadline.seconds))
        if self._unwanted:
            due_s.append(now_s + REAP_S)
        return max(0.0, min(due_s) - now_s) if due_s else None

    def _send(self, request: _Request) -> None:
        self._number += 1
        role = request.role
        message = Fork(self._number, role.module, role.name, role.cpus, role.fds)
        assert self._slot is not None
        request.due_s = _now_s() + self._answer_deadline.seconds
        self._sent[self._number] = request
        self._slot.send(message, (request.theirs.fileno(), *role.fds))
        self._slot.wake()

    def _forked_one(self, number: int, pid: int, why: str) -> None:
        process = ForkedProcess(pid) if pid else None
        if process is None:
            log.warning("%s: cannot be forked: %s", self._role.name, why)
        else:
            self._forked = [known for known in self._forked if known.poll() is None]
            self._forked.append(process)
        if (request := self._sent.pop(number, None)) is not None:
            request.theirs.close()
            self._report(request, process)

    def _report(self, request: _Request, process: Process | None) -> None:
        if not request.answer(process) and process is not None:
            process.kill()
            self._unwanted.append(process)

    def _spawn_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for request in waiting:
            process: Process | None = None
            with request.theirs:
                try:
                    process = spawned(request.role, request.theirs)
                except LinkError as error:
                    log.warning("%s", error)
            self._report(request, process)


def _now_s() -> float:
    return asyncio.get_running_loop().time()


_FROM_TEMPLATE = Preloaded | Forked | Failed


def _inherit_orphans(on: bool) -> None:
    """Raises LinkError."""
    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, int(on), 0, 0, 0):
        raise LinkError(f"PR_SET_CHILD_SUBREAPER: {os.strerror(ctypes.get_errno())}")


def _end_strays(name: str, known: set[int]) -> None:
    """Kill and reap what the template had forked but not reported when it ended: these have no job, and so still its
    name."""
    for _ in range(10):  # one that is killed may just have forked another
        strays = [pid for pid, own_name in _children() if own_name == name and pid not in known]
        if not strays:
            return
        for pid in strays:
            with suppress(ProcessLookupError, subprocess.TimeoutExpired):
                os.kill(pid, signal.SIGKILL)
                ForkedProcess(pid).wait(KILL_S)


def _children() -> list[tuple[int, str]]:
    import psutil  # noqa: PLC0415 - rarely needed, and half a megabyte

    found = []
    for process in psutil.Process().children():
        with suppress(psutil.Error):
            found.append((process.pid, process.name()))
    return found
