"""The reader process: answers from the recordings themselves, one at a time, each in a process forked for it. IO.

What an answer needs of memory is given back with its process, and it ends when nobody waits for it any more, after
LIMIT_S, or beyond LIMIT_BYTES. It reads for a process that any network client may send requests to, so it has no more
rights than that one. It ends when nothing was asked for IDLE_S.
"""

import os
import resource
import select
import signal
import socket
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from gateway.errors import ConfigError, GatewayError
from gateway.processes import sandbox
from gateway.processes.channel import Channel, Failed
from gateway.processes.child import die_with, shown
from gateway.processes.codec import Codec
from gateway.processes.forked import end_without_asker, write_all
from gateway.records.questions import QUESTIONS, AnswerKind, Question, ReaderSetup

CODEC = Codec(ReaderSetup)
NICE = 15  # after the camera, the PLC and the pages; as the recorder
IDLE_S = 60.0
LIMIT_S = 100.0
LIMIT_BYTES = 700_000_000  # an answer keeps six segments in memory, 60 MB each


def run(channel: Channel[Failed, ReaderSetup], job: ReaderSetup) -> None:
    """Until nothing is asked any more, or the main process has ended."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICE)
    for line in sandbox.enter(job.run_as):
        print(f"records: the reader keeps a right that it does not need: {line}", file=sys.stderr)
    questions: Channel[object, Question] = Channel(socket.socket(fileno=job.questions), QUESTIONS)
    answers: ModuleType | None = None
    while True:
        readable, _, _ = select.select([questions.sock, channel.sock], [], [], IDLE_S)
        if questions.sock not in readable:
            sys.exit(0)
        question, fds = questions.receive_with_fds()
        answers = answers or import_module("gateway.records.answers")
        try:
            if len(fds) == 1:
                _answered(answers, Path(job.folder), question, fds[0])
        finally:
            for fd in fds:
                os.close(fd)


def _answered(answers: ModuleType, folder: Path, question: Question, fd: int) -> None:
    """When this returns, the process that was forked has ended."""
    parent = os.getpid()
    pid = os.fork()
    if not pid:
        die_with(parent)
        _work(answers, folder, question, fd)
    os.waitpid(pid, 0)


def _work(answers: ModuleType, folder: Path, question: Question, fd: int) -> NoReturn:
    """In the forked process."""
    code = 1
    try:
        signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
        limit = _data_bytes() + LIMIT_BYTES
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
        end_without_asker(fd)
        write_all(fd, _answer(answers, folder, question))
        code = 0
    except BaseException as error:  # noqa: BLE001 - nothing of the parent's may run here
        sys.excepthook(type(error), error, error.__traceback__)
    finally:
        sys.stderr.flush()
        os._exit(code)


def _answer(answers: ModuleType, folder: Path, question: Question) -> bytes:
    try:
        found: bytes = answers.answer(folder, question)
    except ConfigError as error:
        return AnswerKind.NOTHING.value + shown(str(error)).encode()
    except (GatewayError, OSError) as error:
        return AnswerKind.FAULT.value + shown(str(error)).encode()
    except MemoryError:
        return AnswerKind.FAULT.value + b"it needs too much memory"
    return AnswerKind.ANSWER.value + found


def _data_bytes() -> int:
    """What RLIMIT_DATA counts."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
    return pages * resource.getpagesize()
