"""Output that nobody reads must cost nothing but the output."""

import fcntl
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

import pytest

from gateway.cli.output import LossyOutput

PIPE_BYTES = 4096  # the smallest there is


class Pipe:
    """A pipe's writing end as a text stream. Shut, it blocks whoever writes, as a terminal does on Ctrl-S."""

    def __init__(self, stream: TextIO, read: int) -> None:
        self.stream = stream
        self._read = read

    def shut(self) -> None:
        fcntl.fcntl(self._read, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        os.write(self.stream.fileno(), b"." * PIPE_BYTES)

    def open(self) -> None:
        """Take out what `shut` put in."""
        left = PIPE_BYTES
        while left:
            left -= len(os.read(self._read, left))

    def line(self) -> str:
        """The next line; blocks until it is there."""
        line = b""
        while not line.endswith(b"\n"):
            line += os.read(self._read, 1)
        return line.decode()


@contextmanager
def pipe() -> Iterator[Pipe]:
    read, write = os.pipe()
    try:
        with open(write, "w", encoding="utf-8") as stream:
            yield Pipe(stream, read)
    finally:
        os.close(read)


def test_everything_arrives_in_order() -> None:
    with pipe() as out:
        outlet = LossyOutput(out.stream)
        for n in range(1000):
            print(f"{n} px²", file=outlet)
        assert [out.line() for _ in range(1000)] == [f"{n} px²\n" for n in range(1000)]
        outlet.close(None)


def test_closing_without_a_limit_waits_for_a_slow_reader() -> None:
    with pipe() as out:
        out.shut()
        outlet = LossyOutput(out.stream)
        outlet.write("last\n")
        closing = threading.Thread(target=outlet.close, args=(None,))
        closing.start()
        assert closing.is_alive()
        out.open()
        closing.join(10)
        assert not closing.is_alive()
        assert out.line() == "last\n"


def test_a_blocked_stream_blocks_nobody_and_what_was_dropped_is_counted() -> None:
    with pipe() as out:
        out.shut()
        outlet = LossyOutput(out.stream, limit=3)
        outlet.write("first\n")
        while outlet._queue.qsize():  # the thread has it, and hangs
            threading.Event().wait(0.001)
        for n in range(10):
            assert outlet.write(f"{n}\n") == 2
        out.open()
        lines = [out.line() for _ in range(5)]
        outlet.write("last\n")
        assert lines == ["first\n", "(7 outputs dropped: not read in time)\n", "0\n", "1\n", "2\n"]
        assert out.line() == "last\n"
        assert outlet.dropped == 7
        outlet.close(None)


def test_a_stream_that_never_moves_again_does_not_hold_up_the_end() -> None:
    with pipe() as out:
        out.shut()
        outlet = LossyOutput(out.stream, limit=1)
        for _ in range(5):
            outlet.write("x")
        outlet.close(0.05)  # returns
        out.open()
        outlet.close(None)


AT_THE_END = """
import sys
from gateway.cli.output import LossyOutput

outlet = LossyOutput(sys.stdout)
outlet.write("x" * 100_000)
while outlet._queue.qsize():
    pass
outlet.close(0.05)
"""


def test_the_interpreter_ends_while_the_thread_hangs_in_a_write() -> None:
    """Its own flush of stdout, at its end, finds nothing to do and no lock to wait for."""
    with subprocess.Popen(
        [sys.executable, "-c", AT_THE_END], stdout=subprocess.PIPE, stderr=subprocess.PIPE, pipesize=PIPE_BYTES
    ) as process:
        assert process.wait(60) == 0
        assert process.stderr is not None
        assert process.stderr.read() == b""


def test_a_lost_reader_is_reported_once_and_nothing_raises() -> None:
    lost = threading.Semaphore(0)
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as stream:
        outlet = LossyOutput(stream, on_lost=lost.release)
        outlet.write("x")
        assert lost.acquire(timeout=10)
        outlet.write("y")
        outlet.close(5.0)
        assert outlet.lost
        assert not lost.acquire(blocking=False)
        stream.write("z")
        stream.flush()  # what the interpreter does at its end: goes nowhere now, and does not complain


def test_a_closed_stdout_is_no_terminal() -> None:
    outlet = LossyOutput(None)
    outlet.write("x")
    assert outlet.lost
    assert not outlet.isatty()
    with pytest.raises(OSError, match="closed"):
        outlet.fileno()
    outlet.close()


def test_it_looks_like_the_stream_behind_it() -> None:
    assert LossyOutput(sys.__stderr__).encoding == (sys.__stderr__ and sys.__stderr__.encoding)
