"""A helper process, in this one: what is forked for a question, its limits and its end, on real pipes."""

import fcntl
import multiprocessing
import os
import select
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from gateway.errors import ConfigError, LinkError
from gateway.processes.answers import LENGTH_BYTES, NothingError, QuestionRefusedError
from gateway.processes.channel import Channel
from gateway.processes.codec import Codec, Message
from gateway.processes.helper import Helper, QuestionKind, Send

pytestmark = pytest.mark.one_interpreter
MB = 1_000_000


class Common(Message, frozen=True):
    """A question."""

    data: str = ""


class Look(Message, frozen=True):
    """One that holds a device."""


CODEC = Codec(Common | Look)
Work = Callable[[Any, Sequence[int], Send], None]


class Asked:
    """A helper, its questions' socket, and what it has forked."""

    def __init__(self, work: Work, at_once: int = 1, **limits: Any) -> None:
        given = {"limit_s": 50.0, "limit_bytes": 500 * MB} | limits
        kinds: dict[type, QuestionKind] = {
            Common: QuestionKind(work, **given),
            Look: QuestionKind(work, **given, one_device=True),
        }
        self.helper = Helper(kinds, at_once)
        near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.asker: Channel[Any, Any] = Channel(near, CODEC)
        self.questions: Channel[object, Any] = Channel(far, CODEC)

    def ask(self, question: object = Common(), *fds: int) -> int:
        """The pipe's reading end."""
        reading, writing = os.pipe()
        assert self.asker.offer(question, (writing, *fds))
        os.close(writing)
        return reading

    def begun(self, question: object = Common(), *fds: int) -> int:
        reading = self.ask(question, *fds)
        self.helper.take(self.questions)
        return reading

    def ended(self, left: int = 0) -> None:
        """Until that many are left: a process that was killed closes its files before it can be reaped."""
        until = time.monotonic() + 30
        while len(self.helper.running) > left:
            assert time.monotonic() < until
            self.helper.reap()
            time.sleep(0.005)


@pytest.fixture
def made() -> Iterator[Callable[..., Asked]]:
    found: list[Asked] = []

    def make(*args: Any, **limits: Any) -> Asked:
        found.append(Asked(*args, **limits))
        return found[-1]

    yield make
    for each in found:
        for forked in each.helper.running:
            os.kill(forked.pid, signal.SIGKILL)
        each.ended()
        each.asker.close()
        each.questions.close()


def read(fd: int) -> bytes:
    with os.fdopen(fd, "rb") as file:
        return file.read()


def hangs(*_: object) -> None:
    time.sleep(60)


def works_for_ever(*_: object) -> None:
    while True:
        time.sleep(0.001)


def raising(error: BaseException) -> Work:
    def work(*_: object) -> None:
        raise error

    return work


def test_an_answer_comes_whole_through_the_pipe(made: Callable[..., Asked]) -> None:
    def work(question: Common, fds: Sequence[int], send: Send) -> None:
        send(question.data.encode() * 3_000_000)
        send(os.pread(fds[0], 10, 0))

    memory = os.memfd_create("data")
    os.write(memory, b"memory")
    asked = made(work)
    fd = asked.begun(Common("x"), memory)
    os.close(memory)
    assert len(asked.helper.running) == 1
    assert read(fd) == (3_000_001).to_bytes(LENGTH_BYTES) + b"+" + b"x" * 3_000_000 + b"\0\0\0\x07+memory"
    asked.ended()


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (NothingError("no segment"), b"0no segment"),
        (QuestionRefusedError("taken"), b"!taken"),
        (LinkError("gone\x07"), b"-gone\\x07"),
        (ConfigError("a line"), b"-a line"),
        (OSError(5, "Input/output error"), b"-[Errno 5] Input/output error"),
        (MemoryError(), b"-it needs too much memory"),
    ],
)
def test_what_went_wrong_is_told(made: Callable[..., Asked], error: BaseException, told: bytes) -> None:
    assert read(made(raising(error)).begun())[LENGTH_BYTES:] == told


def test_a_fault_in_the_software_ends_only_the_forked_process(
    made: Callable[..., Asked], capfd: pytest.CaptureFixture[str]
) -> None:
    assert read(made(raising(KeyError("a bug"))).begun()) == b""
    assert "a bug" in capfd.readouterr().err


@pytest.mark.parametrize("work", [hangs, works_for_ever])
def test_what_takes_too_long_is_ended(
    made: Callable[..., Asked], capfd: pytest.CaptureFixture[str], work: Work
) -> None:
    asked = made(work, limit_s=0.1)
    fd = asked.begun()
    assert read(fd) == b""  # by its own alarm: with reduced rights the helper may kill nobody
    asked.ended()
    assert "an answer took more than 0.1 s" in capfd.readouterr().err


def test_what_ignores_its_alarm_is_killed(made: Callable[..., Asked]) -> None:
    """It may be an intruder's, who came in by what a camera sent."""

    def work(*_: object) -> None:
        signal.signal(signal.SIGALRM, signal.SIG_IGN)
        time.sleep(60)

    asked = made(work, limit_s=0.3)
    fd = asked.begun()
    asked.ended()
    assert read(fd) == b""


def test_what_takes_too_much_memory_ends(made: Callable[..., Asked]) -> None:
    def work(question: Common, _: object, send: Send) -> None:
        send(b"%d" % len(bytearray(int(question.data))))

    asked = made(work, limit_bytes=100 * MB)
    assert read(asked.begun(Common(f"{300 * MB}")))[LENGTH_BYTES:] == b"-it needs too much memory"
    assert read(asked.begun(Common(f"{30 * MB}")))[LENGTH_BYTES:] == b"+30000000"


@pytest.mark.parametrize("to_its_end", [False, True])
def test_what_nobody_waits_for_any_more_ends_unless_it_changes_something(
    made: Callable[..., Asked], to_its_end: bool
) -> None:
    """Also while it hangs in a driver: the last reader's end is what a page that was closed leaves."""
    started, tell = os.pipe()
    go_on, let = os.pipe()

    def work(*_: object) -> None:
        os.close(reading)  # which the fork has inherited
        os.write(tell, b".")
        os.read(go_on, 1)
        os.write(tell, b"!")

    asked = made(work, to_its_end=to_its_end)
    reading = asked.ask()
    asked.helper.take(asked.questions)
    assert os.read(started, 1) == b"."
    os.close(reading)
    if to_its_end:
        os.write(let, b".")
        assert os.read(started, 1) == b"!"
    asked.ended()
    assert not select.select([started], [], [], 0)[0]
    for fd in (started, tell, go_on, let):
        os.close(fd)


def test_a_question_whose_asker_is_gone_is_not_begun(made: Callable[..., Asked]) -> None:
    """It has been told that there is no answer in time, and may have asked once more."""
    asked = made(hangs)
    os.close(asked.ask())
    asked.helper.take(asked.questions)
    assert asked.helper.running == []


def test_a_new_look_ends_the_one_before(made: Callable[..., Asked]) -> None:
    asked = made(hangs, 4)
    first, other, second = asked.begun(Look()), asked.begun(), asked.begun(Look())
    assert read(first) == b""
    asked.ended(left=2)
    assert [each.kind.one_device for each in asked.helper.running] == [False, True]
    for fd in (other, second):
        os.close(fd)


def test_what_goes_on_to_its_end_is_not_ended_by_a_new_look(made: Callable[..., Asked]) -> None:
    """A board that is being given its firmware."""
    asked = made(hangs, 4, to_its_end=True)
    pipes = [asked.begun(Look()), asked.begun(Look())]
    asked.helper.reap()
    assert len(asked.helper.running) == 2
    assert not select.select(pipes, [], [], 0)[0]
    for each, fd in zip(asked.helper.running, pipes, strict=True):
        os.kill(each.pid, signal.SIGKILL)
        os.close(fd)
    asked.ended()


def test_a_new_look_begins_when_the_one_before_has_ended(
    made: Callable[..., Asked], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only then is its camera free."""
    held = tmp_path / "camera"
    held.touch()

    def opens(_: object, __: object, send: Send) -> None:
        fcntl.flock(os.open(held, os.O_RDWR), fcntl.LOCK_EX | fcntl.LOCK_NB)  # as a driver that one program may open
        send(b"open")
        time.sleep(60)

    def slowly(before: Any) -> None:
        threading.Timer(0.3, os.kill, (before.pid, signal.SIGKILL)).start()

    monkeypatch.setattr("gateway.processes.helper._kill", slowly)
    asked = made(opens, 9)
    for _ in range(2):
        fd = asked.begun(Look())
        assert os.read(fd, LENGTH_BYTES + 1)[-1:] == b"+"  # it has it; otherwise why not would follow
        assert os.read(fd, 4) == b"open"
    os.close(fd)


def served(work: Work, at_once: int) -> tuple[Asked, Any, socket.socket]:
    """A helper that serves in a process of its own, and the main process's end of its channel."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    asked = Asked(work, at_once)

    def serve() -> None:
        ours.close()
        asked.asker.close()
        asked.helper.serve(Channel(theirs, CODEC), asked.questions.sock.detach(), CODEC)

    process = multiprocessing.get_context("fork").Process(target=serve)
    process.start()
    theirs.close()
    asked.questions.close()
    return asked, process, ours


def test_only_so_many_at_a_time_and_the_others_wait() -> None:
    def work(question: Common, _: object, send: Send) -> None:
        send(question.data.encode())
        time.sleep(60)

    asked, process, ours = served(work, 2)
    with ours:
        fds = [asked.ask(Common(f"{n}")) for n in range(3)]
        for n in (0, 1):
            assert select.select([fds[n]], [], [], 30)[0]
        assert not select.select([fds[2]], [], [], 0.3)[0]
        os.close(fds[0])  # its asker is gone
        assert select.select([fds[2]], [], [], 30)[0]
    process.join(30)  # the main process is gone
    assert process.exitcode == 0
    assert read(fds[1])[LENGTH_BYTES:] == b"+1"  # and so are those that it had forked
    assert read(fds[2])[LENGTH_BYTES:] == b"+2"
    asked.asker.close()


def test_it_is_not_outlived_by_what_it_has_forked() -> None:
    """Even where it is killed."""

    def work(_: object, __: object, send: Send) -> None:
        send(b"")
        works_for_ever()

    asked, process, ours = served(work, 1)
    with ours:
        fd = asked.ask()
        assert select.select([fd], [], [], 30)[0]
        process.kill()
        process.join(30)
        assert read(fd)[LENGTH_BYTES:] == b"+"  # all that had it open have ended
    asked.asker.close()


def test_it_ends_when_nothing_is_asked_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.processes.helper.IDLE_S", 0.2)

    def work(_: object, __: object, send: Send) -> None:
        time.sleep(1.2)
        send(b"late")

    asked, process, ours = served(work, 1)
    with ours:
        assert read(asked.ask())[LENGTH_BYTES:] == b"+late"  # not before it is answered
        process.join(30)
        assert process.exitcode == 0
    asked.asker.close()
