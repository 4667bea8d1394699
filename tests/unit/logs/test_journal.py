"""What systemd's journal gets of a record: its fields, in the form of its protocol, on a real socket."""

import io
import logging
import socket
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from gateway.logs.folding import LogCounts
from gateway.logs.journal import MAX_BYTES, Journal, datagram, fields_of
from gateway.logs.lines import formatter, message_formatter
from gateway.logs.setup import FoldingHandler


def record(level: int, text: str, **fields: object) -> logging.LogRecord:
    made = logging.LogRecord("gateway.bay", level, "bay.py", 1, text, (), None)
    made.fields = fields
    return made


def parsed(data: bytes) -> dict[str, str]:
    """As the journal does it: written from its description, not from the code under test."""
    found = {}
    while data:
        line, _, rest = data.partition(b"\n")
        name, separator, value = line.partition(b"=")
        if not separator:
            size = int.from_bytes(rest[:8], "little")
            value, rest = rest[8 : 8 + size], rest[8 + size :]
            assert rest[:1] == b"\n"
            rest = rest[1:]
        found[name.decode()] = value.decode()
        data = rest
    return found


@pytest.fixture
def received(tmp_path: Path) -> Iterator[socket.socket]:
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as sock:
        sock.bind(str(tmp_path / "socket"))
        sock.settimeout(5)
        yield sock


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with closing(Journal(message_formatter("text", journal=True), str(tmp_path / "socket"))) as made:
        yield made


def test_an_event_has_bay_radius_distance_and_reason(received: socket.socket, journal: Journal) -> None:
    made = record(
        logging.INFO, "stop raised", bay="bay1", event="stop_raised", radius_px=180.5, distance_mm=None, reason="moved"
    )
    assert journal.send(made)
    assert parsed(received.recv(65536)) == {
        "MESSAGE": "gateway.bay: stop raised",
        "PRIORITY": "6",
        "SYSLOG_IDENTIFIER": "gateway",
        "LOGGER": "gateway.bay",
        "BAY": "bay1",
        "EVENT": "stop_raised",
        "RADIUS_PX": "180.5",
        "REASON": "moved",
    }


def test_a_traceback_is_one_record(received: socket.socket, journal: Journal) -> None:
    made = record(logging.ERROR, "bay1.vision crashed")
    try:
        raise RuntimeError("two\nlines = 2")
    except RuntimeError:
        made.exc_info = sys.exc_info()
    assert journal.send(made)
    found = parsed(received.recv(65536))
    assert found["PRIORITY"] == "3"
    assert found["MESSAGE"].splitlines()[0] == "gateway.bay: bay1.vision crashed"
    assert found["MESSAGE"].endswith("RuntimeError: two\nlines = 2")


def test_what_a_caller_gives_replaces_no_field_of_the_journal() -> None:
    made = record(logging.WARNING, "x", priority=0, message="y", _pid=1, **{"b-ad": 1, "": 2, "ok_1": "a\nb"})
    found = fields_of(made, "x")
    assert found == {
        "MESSAGE": "x",
        "PRIORITY": "4",
        "SYSLOG_IDENTIFIER": "gateway",
        "LOGGER": "gateway.bay",
        "OK_1": "a\nb",
    }
    assert parsed(datagram(found)) == found


def test_a_long_value_is_cut() -> None:
    assert len(datagram({"MESSAGE": "ä" * MAX_BYTES})) == len("MESSAGE=\n") + MAX_BYTES


def test_without_a_journal_the_line_goes_to_the_stream(journal: Journal) -> None:
    out = io.StringIO()
    handler = FoldingHandler(out, None, journal=journal)
    handler.setFormatter(formatter("text", journal=True))
    handler.handle(record(logging.WARNING, "the journal is being restarted"))
    assert out.getvalue() == "<4>gateway.bay: the journal is being restarted\n"


def test_a_journal_that_does_not_read_blocks_nothing(received: socket.socket, journal: Journal) -> None:
    out = io.StringIO()
    handler = FoldingHandler(out, None, journal=journal)
    for _ in range(2000):
        handler.handle(record(logging.WARNING, "x" * 1000))
    assert out.getvalue() == ""
    counts = handler.counts()
    received.setblocking(False)
    read = 0
    while True:
        try:
            received.recv(65536)
        except BlockingIOError:
            break
        read += 1
    assert counts == LogCounts(folded=0, lost=2000 - read)
    assert 0 < read < 2000
