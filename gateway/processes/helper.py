"""What every helper process does: it takes the web process's questions, and forks a process for each answer. IO.

The helper itself touches no file and no device, so it can always be ended, and so can the gateway. What an answer needs
of memory is given back with its process, which ends when nobody waits for it any more, and beyond its limits of time
and memory. A helper ends when nothing was asked for IDLE_S. Its rights, its questions and their limits are its own:
`records.reader_process`, `doctor.device_process`, `web.testsets.process`.
"""

import os
import resource
import select
import signal
import socket
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from gateway.clock import machine_ns
from gateway.durations import NS_PER_S
from gateway.errors import GatewayError
from gateway.processes.answers import AnswerKind, NothingError, QuestionRefusedError, write_piece
from gateway.processes.channel import Channel
from gateway.processes.child import die_with, shown
from gateway.processes.codec import Codec

IDLE_S = 60.0
TURN_S = 0.5  # between two looks at time limits
ENDED_S = 2.0  # for a process that was killed
ENDED_WITHOUT_ASKER = 3  # exit code

Send = Callable[[bytes], None]  # a piece of the answer; raises OSError where nobody reads


@dataclass(frozen=True, slots=True)
class QuestionKind:
    """How a question is answered. `answer`: from the question and the descriptors that came with it, but for the
    pipe's. `limit_bytes`: of memory for data, beyond what the helper has. `one_device`: it holds a device, and is ended
    by the next such question. `to_its_end`: also where nobody waits for it any more."""

    answer: Callable[[Any, Sequence[int], Send], None]
    limit_s: float
    limit_bytes: int
    one_device: bool = False
    to_its_end: bool = False


@dataclass(slots=True)
class _Forked:
    pid: int
    pidfd: int
    kind: QuestionKind
    until_ns: int


@dataclass(slots=True)
class Helper:
    """`kinds`: by the questions' types. `at_once`: so many are answered at the same time, the others wait in their
    socket; a process that can't be killed keeps its place."""

    kinds: Mapping[type, QuestionKind]
    at_once: int = 1
    running: list[_Forked] = field(default_factory=list)

    def serve(self, channel: Channel[Any, Any], fd: int, codec: Codec) -> NoReturn:
        """Until nothing is asked any more, or the main process has ended. `channel`: to that one. `fd`: of the socket
        for questions, which `codec` reads."""
        questions: Channel[object, Any] = Channel(socket.socket(fileno=fd), codec)
        main = channel.sock.fileno()
        while True:
            watched = [main, *(each.pidfd for each in self.running)]
            if len(self.running) < self.at_once:
                watched.append(fd)
            readable, _, _ = select.select(watched, [], [], TURN_S if self.running else IDLE_S)
            if main in readable or not (readable or self.running):
                sys.exit(0)
            self.reap()
            if fd in readable:
                self.take(questions)

    def take(self, questions: Channel[object, Any]) -> None:
        """One whose asker is gone is not begun: its asker was told so, and may have asked once more."""
        question, fds = questions.receive_with_fds()
        try:
            if fds and not _abandoned(fds[0], 0):
                self._begin(self.kinds[type(question)], question, fds)
        finally:
            for fd in fds:
                os.close(fd)

    def reap(self) -> None:
        """Ends those beyond their limit; never waits for any."""
        now_ns = machine_ns()
        for each in list(self.running):
            if late := now_ns > each.until_ns:
                _kill(each)
            if os.waitpid(each.pid, os.WNOHANG)[0]:
                os.close(each.pidfd)
                self.running.remove(each)
                if late:
                    print(f"an answer took more than {each.kind.limit_s:g} s, and was given up", file=sys.stderr)

    def _begin(self, kind: QuestionKind, question: Any, fds: list[int]) -> None:
        """The process before, whose device may still be open, is ended, and the new one waits for that."""
        ended = [each for each in self.running if each.kind.one_device and not each.kind.to_its_end]
        before = ended if kind.one_device else []
        for each in before:
            _kill(each)
        parent, until_ns = os.getpid(), machine_ns() + round(kind.limit_s * NS_PER_S)
        pid = os.fork()
        if not pid:
            die_with(parent)
            _work(kind, question, fds, [each.pidfd for each in before])
        self.running.append(_Forked(pid, os.pidfd_open(pid), kind, until_ns))


def _kill(forked: _Forked) -> None:
    with suppress(PermissionError):  # refused to a helper with reduced rights: there the process's own alarm ends it
        os.kill(forked.pid, signal.SIGKILL)


def _abandoned(pipe: int, wait_ms: int | None) -> bool:
    """Is its other end closed, at once or later? None: waits until it is."""
    watch = select.poll()
    watch.register(pipe, 0)  # only that
    return bool(watch.poll(wait_ms))


def _work(kind: QuestionKind, question: Any, fds: list[int], before: Sequence[int]) -> NoReturn:
    """In the forked process."""
    code = 1
    pipe, *others = fds
    try:
        signal.setitimer(signal.ITIMER_REAL, kind.limit_s)
        for pidfd in before:
            select.select([pidfd], [], [], ENDED_S)  # a driver that hangs keeps its device for good
        limit = _data_bytes() + kind.limit_bytes
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
        if not kind.to_its_end:
            threading.Thread(target=_end_without_asker, args=(pipe,), daemon=True).start()
        give_answer(kind, question, others, pipe)
        code = 0
    except BrokenPipeError:
        pass  # nobody reads it any more
    except BaseException as error:  # noqa: BLE001 - nothing of the parent's may run here
        sys.excepthook(type(error), error, error.__traceback__)
    finally:
        sys.stderr.flush()
        os._exit(code)


def give_answer(kind: QuestionKind, question: Any, fds: Sequence[int], pipe: int) -> None:
    """Also why there is none. Raises OSError where nobody reads."""
    try:
        kind.answer(question, fds, partial(write_piece, pipe, AnswerKind.ANSWER))
    except NothingError as error:
        _tell(pipe, AnswerKind.NOTHING, str(error))
    except QuestionRefusedError as error:
        _tell(pipe, AnswerKind.REFUSED, str(error))
    except (GatewayError, OSError) as error:
        _tell(pipe, AnswerKind.FAULT, str(error) or type(error).__name__)
    except MemoryError:
        _tell(pipe, AnswerKind.FAULT, "it needs too much memory")


def _tell(pipe: int, kind: AnswerKind, text: str) -> None:
    write_piece(pipe, kind, shown(text).encode())


def _end_without_asker(pipe: int) -> None:
    """This process ends at once, whatever it does, when nobody reads any more."""
    _abandoned(pipe, None)
    os._exit(ENDED_WITHOUT_ASKER)


def _data_bytes() -> int:
    """What RLIMIT_DATA counts."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
    return pages * resource.getpagesize()
