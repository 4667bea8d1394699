"""The process that keeps test sets: one question after the other, none for an asker that is gone, none for ever."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.processes.channel import Channel
from gateway.web.ipc.testsets import (
    BAY_SETS,
    SETS_QUESTIONS,
    AddPicture,
    DeleteSet,
    ListSets,
    MakeSet,
    SetAnswerKind,
    SetsQuestion,
)
from gateway.web.testsets import client, process
from gateway.web.testsets.store import SetStore
from tests.unit.web.testsets import plain

Asked = Channel[SetsQuestion, Any]


@pytest.fixture
def store(tmp_path: Path) -> SetStore:
    made = SetStore(tmp_path, frozenset(("bay1",)))
    made.make("bay1", "dusk")
    return made


@pytest.fixture
def link() -> Iterator[tuple[Asked, Channel[Any, SetsQuestion]]]:
    """The asker's end, and that of the process."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far:
        yield Channel(near, SETS_QUESTIONS), Channel(far, SETS_QUESTIONS)


def asked(channel: Asked, question: SetsQuestion, picture: bytes | None = None) -> int:
    """The pipe from which the answer is read."""
    reading, writing = os.pipe()
    fds = [writing]
    if picture is not None:
        fds.append(os.memfd_create("picture"))
        os.write(fds[1], picture)
    assert channel.offer(question, fds)
    for fd in fds:
        os.close(fd)
    return reading


def test_a_question_whose_asker_is_gone_changes_nothing(
    store: SetStore, link: tuple[Asked, Channel[Any, SetsQuestion]]
) -> None:
    """It has been told that the disk did not answer in time, and asks once more."""
    near, far = link
    for question, picture in (
        (AddPicture("bay1", "dusk", "a.png"), plain()),
        (MakeSet("bay1", "dawn"), None),
        (DeleteSet("bay1", "dusk"), None),
    ):
        os.close(asked(near, question, picture))
        process.take(far, store)
    again = asked(near, AddPicture("bay1", "dusk", "a.png"), plain())
    process.take(far, store)
    with os.fdopen(again, "rb") as answer:
        assert answer.read(1) == SetAnswerKind.ANSWER.value
        (one,) = BAY_SETS.unpacked(answer.read()).sets
    assert (one.name, [picture.file for picture in one.pictures]) == ("dusk", ["0001-a.png"])


@pytest.mark.one_interpreter
def test_a_disk_that_holds_it_up_is_its_end_before_the_asker_gives_up(tmp_path: Path) -> None:
    assert process.LIMIT_S < client.ANSWER_S
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far:
        reading = asked(Channel(near, SETS_QUESTIONS), ListSets("bay1"))
        code = (
            "import socket, sys, time; from pathlib import Path; from gateway.processes.channel import Channel;"
            "from gateway.web.ipc.testsets import SETS_QUESTIONS; from gateway.web.testsets import process;"
            "from gateway.web.testsets.store import SetStore;"
            "SetStore.sets = lambda *_: time.sleep(60); process.LIMIT_S = 1;"
            "far = socket.socket(fileno=int(sys.argv[1]));"
            "process.take(Channel(far, SETS_QUESTIONS), SetStore(Path(sys.argv[2]), frozenset(('bay1',))))"
        )
        command = [sys.executable, "-c", code, str(far.fileno()), str(tmp_path)]
        ended = subprocess.run(command, pass_fds=[far.fileno()], timeout=50, check=False)
    assert ended.returncode == -signal.SIGALRM
    with os.fdopen(reading, "rb") as answer:
        assert answer.read() == b""
