"""The helper process that keeps test sets: it alone reads and writes their folder, one question after the other. IO.

It has the gateway's own rights, for the web process may write no file. It decodes no picture. An answer is ended where
a disk holds it up for LIMIT_S, which leaves every file as it was or as it was to be (`processes.helper`).
"""

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import get_args

from gateway.errors import LinkError
from gateway.processes.answers import QuestionRefusedError
from gateway.processes.channel import Channel, Failed
from gateway.processes.child import lower_priority
from gateway.processes.codec import record_packed
from gateway.processes.helper import Helper, QuestionKind, Send
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
    SetLabel,
    SetsQuestion,
    SetsSetup,
)
from gateway.web.testsets.store import SetStore

CODEC = SETS_SETUP
LIMIT_S = 40.0
LIMIT_BYTES = 500_000_000


def run(channel: Channel[Failed, SetsSetup], setup: SetsSetup) -> None:
    """Until nothing is asked any more, or the main process has ended."""
    lower_priority()
    store = SetStore(Path(setup.folder), frozenset(setup.bays))
    sets_helper(store).serve(channel, setup.questions, SETS_QUESTIONS)


def sets_helper(store: SetStore) -> Helper:
    kind = QuestionKind(partial(answer, store), LIMIT_S, LIMIT_BYTES, to_its_end=True)
    return Helper(dict.fromkeys(get_args(SetsQuestion), kind))


def answer(store: SetStore, question: SetsQuestion, fds: Sequence[int], send: Send) -> None:
    """Raises GatewayError."""
    try:
        content = _content(store, question, fds)
    except OSError as error:
        where = error.filename or store.folder
        why = f"{os.fsdecode(where) if isinstance(where, bytes) else where}: {error.strerror or error}"
        raise LinkError(why) from error
    send(content)


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
        raise QuestionRefusedError("no picture came with it")
    return os.pread(fds[0], MAX_FILE_BYTES + 1, 0)
