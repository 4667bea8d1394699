"""The bdSeq outlives the process, and nothing that lies in everybody's folder can hold the event loop up."""

import os
import threading
from pathlib import Path

import pytest

from gateway.sinks.sparkplug import bd_seq as numbers
from gateway.sinks.sparkplug.bd_seq import BdSeq

NAME = "loading-gateway-bdseq.test"


@pytest.fixture(autouse=True)
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(numbers, "folder", lambda: tmp_path)
    return tmp_path


def drawn(count: int) -> list[int]:
    """So many numbers of one process; in a thread, for a pipe that is waited for would hang the test."""
    found: list[int] = []
    bd_seq = BdSeq("test")
    thread = threading.Thread(target=lambda: found.extend(bd_seq() for _ in range(count)), daemon=True)
    thread.start()
    thread.join(20)
    assert not thread.is_alive(), "waits"
    return found


def test_it_goes_on_after_a_restart_and_in_a_circle(shared: Path) -> None:
    assert drawn(3) == [0, 1, 2]
    assert drawn(2) == [3, 4]
    (shared / NAME).write_text("254")
    assert drawn(3) == [255, 0, 1]


def test_where_it_cannot_be_kept_it_still_counts(shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numbers, "folder", lambda: shared / "missing")
    assert drawn(3) == [0, 1, 2]


@pytest.mark.parametrize("tail", ["", ".new"])
def test_a_pipe_in_its_place_is_not_waited_for(shared: Path, tail: str) -> None:
    os.mkfifo(shared / (NAME + tail))
    assert drawn(2) == [0, 1]
    assert drawn(1) == [2]


@pytest.mark.parametrize("tail", ["", ".new"])
def test_a_link_in_its_place_is_neither_read_nor_written_through(shared: Path, tail: str) -> None:
    other = shared / "other"
    other.write_text("77")
    (shared / (NAME + tail)).symlink_to(other)
    assert drawn(2) == [0, 1]
    assert other.read_text() == "77"


@pytest.mark.parametrize("junk", [b"", b"x", b"\xff", b"9" * 10_000_000, b"-3"])
def test_junk_in_it_is_no_fault(shared: Path, junk: bytes) -> None:
    (shared / NAME).write_bytes(junk)
    (first,) = drawn(1)
    assert drawn(1) == [(first + 1) % 256]
    assert first in range(256)
