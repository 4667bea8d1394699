"""Output that nobody reads must cost nothing but the output."""

import io
import os
import sys
import threading

import pytest

from gateway.cli.outlet import Outlet


class Gate(io.StringIO):
    """A stream that blocks while it is shut, as a terminal does on Ctrl-S."""

    def __init__(self) -> None:
        super().__init__()
        self.open_ = threading.Event()
        self.waiting = threading.Event()

    def write(self, text: str) -> int:
        self.waiting.set()
        self.open_.wait(10)
        return super().write(text)


def test_everything_arrives_in_order() -> None:
    stream = io.StringIO()
    outlet = Outlet(stream)
    for n in range(1000):
        print(n, file=outlet)
    outlet.close(5.0)
    assert stream.getvalue() == "".join(f"{n}\n" for n in range(1000))


def test_a_blocked_stream_blocks_nobody_and_what_was_dropped_is_told() -> None:
    gate = Gate()
    outlet = Outlet(gate, limit=3)
    outlet.write("first\n")
    assert gate.waiting.wait(10)
    for n in range(10):
        assert outlet.write(f"{n}\n") == 2
    gate.open_.set()
    while outlet._queue.qsize():
        gate.waiting.wait(0.001)
    outlet.write("last\n")
    outlet.close(5.0)
    text = gate.getvalue()
    assert text.startswith("first\n(7 outputs dropped")
    assert [line for line in text.splitlines() if line.isdigit()] == ["0", "1", "2"]
    assert text.endswith("last\n")


def test_a_stream_that_never_moves_again_does_not_hold_up_the_end() -> None:
    outlet = Outlet(Gate(), limit=1)
    for _ in range(5):
        outlet.write("x")
    outlet.close(0.05)  # returns


def test_a_lost_reader_is_told_once_and_nothing_raises() -> None:
    lost = threading.Semaphore(0)
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as stream:
        outlet = Outlet(stream, on_lost=lost.release)
        outlet.write("x")
        assert lost.acquire(timeout=10)
        outlet.write("y")
        outlet.close(5.0)
        assert outlet.lost
        assert not lost.acquire(blocking=False)
        stream.flush()  # what the interpreter does at its end: goes nowhere now, and does not complain


def test_a_closed_stdout_is_no_terminal() -> None:
    outlet = Outlet(None)
    outlet.write("x")
    assert outlet.lost
    assert not outlet.isatty()
    with pytest.raises(OSError, match="closed"):
        outlet.fileno()
    outlet.close()


def test_it_looks_like_the_stream_behind_it() -> None:
    assert Outlet(sys.__stderr__).encoding == (sys.__stderr__ and sys.__stderr__.encoding)
