"""The process that keeps test sets: it alone reads and writes their folder, one question after the other. IO.

It has the gateway's own rights, for the web process may write no file. It decodes no picture. It is killed where a
disk holds it up for LIMIT_S, which leaves every file as it was or as it was to be, and ends when nothing was asked for
IDLE_S.
"""

import os
import select
import signal
import socket
import sys
from collections.abc import Sequence
from pathlib import Path

from gateway.errors import GatewayError
from gateway.processes.channel import Channel, Failed
from gateway.processes.child import shown
from gateway.processes.codec import record_packed
from gateway.processes.forked import write_all
from gateway.web.ipc.testsets import (
    MAX_FILE_BYTES,
    SETS_QUESTIONS,
    SETS_SETUP,
    AddPicture,
    BaySets,
    DeleteSet,
    ListSets,
    MakeSet,
    ReadPicture,
    RemovePicture,
    RenameSet,
    SetAnswerKind,
    SetLabel,
    SetsQuestion,
    SetsSetup,
)
from gateway.web.testsets.store import NothingError, SetRefusedError, SetStore

CODEC = SETS_SETUP
NICE = 15  # after the camera, the PLC and the pages
IDLE_S = 60.0
LIMIT_S = 40


def run(channel: Channel[Failed, SetsSetup], setup: SetsSetup) -> None:
    """Until nothing is asked any more, or the main process has ended."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICE)
    questions: Channel[object, SetsQuestion] = Channel(socket.socket(fileno=setup.questions), SETS_QUESTIONS)
    store = SetStore(Path(setup.folder), frozenset(setup.bays))
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    while True:
        readable, _, _ = select.select([questions.sock, channel.sock], [], [], IDLE_S)
        if questions.sock not in readable:
            sys.exit(0)
        take(questions, store)


def take(questions: Channel[object, SetsQuestion], store: SetStore) -> None:
    """Take a question and answer it. One whose asker is gone changes nothing: its asker was told so, and may have asked
    once more."""
    question, fds = questions.receive_with_fds()
    signal.alarm(LIMIT_S)
    try:
        if fds and _is_read(fds[0]):
            write_all(fds[0], answer(store, question, fds[1:]))
    except OSError as error:  # who asked is gone
        print(f"test sets: an answer could not be given: {error.strerror}", file=sys.stderr)
    finally:
        signal.alarm(0)
        for fd in fds:
            os.close(fd)


def _is_read(pipe: int) -> bool:
    """Is its other end open?"""
    watch = select.poll()
    watch.register(pipe, 0)  # only that the other end is closed
    return not watch.poll(0)


def answer(store: SetStore, question: SetsQuestion, fds: Sequence[int] = ()) -> bytes:
    """`fds`: what came with the question, but for the pipe. Never raises what the asker can cause."""
    try:
        return SetAnswerKind.ANSWER.value + _content(store, question, fds)
    except NothingError as error:
        return SetAnswerKind.NOTHING.value + shown(str(error)).encode()
    except SetRefusedError as error:
        return SetAnswerKind.REFUSED.value + shown(str(error)).encode()
    except GatewayError as error:
        return SetAnswerKind.FAULT.value + shown(str(error)).encode()
    except OSError as error:
        where = error.filename or store.folder
        why = f"{os.fsdecode(where) if isinstance(where, bytes) else where}: {error.strerror or error}"
        return SetAnswerKind.FAULT.value + shown(why).encode()


def _content(store: SetStore, question: SetsQuestion, fds: Sequence[int]) -> bytes:
    added = ""
    match question:
        case ReadPicture(bay, name, file):
            return store.read(bay, name, file)
        case ListSets():
            pass
        case MakeSet(bay, name):
            store.make(bay, name)
        case RenameSet(bay, name, new):
            store.rename(bay, name, new)
        case DeleteSet(bay, name):
            store.delete(bay, name)
        case AddPicture(bay, name, title):
            added = store.add(bay, name, title, _received(fds))
        case SetLabel(bay, name, file, place):
            store.label(bay, name, file, place)
        case RemovePicture(bay, name, file):
            store.remove(bay, name, file)
    return record_packed(BaySets(store.sets(question.bay), added))


def _received(fds: Sequence[int]) -> bytes:
    """A copy of the memory that came with a question: its sender may still change it."""
    if len(fds) != 1:
        raise SetRefusedError("no picture came with it")
    return os.pread(fds[0], MAX_FILE_BYTES + 1, 0)
