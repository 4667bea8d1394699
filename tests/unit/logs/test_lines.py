"""The form of the log's lines: for people, for systemd's journal, as JSON."""

import io
import json
import logging
import os
import socket
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from gateway.bay import BayControl
from gateway.config import BayConfig
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.hub import Hub
from gateway.logs.lines import formatter, priority
from gateway.logs.setup import to_journal
from tests.virtual_time import HandClock


def record(level: int, text: str, *args: object, **fields: Any) -> logging.LogRecord:
    made = logging.LogRecord("gateway.x", level, "x.py", 1, text, args, None)
    made.created = 1_700_000_000.1239
    made.fields = fields
    return made


@pytest.mark.parametrize(
    ("level", "number"),
    [("CRITICAL", 2), ("ERROR", 3), ("WARNING", 4), ("INFO", 6), ("DEBUG", 7)],
)
def test_the_priorities_of_syslog(level: str, number: int) -> None:
    assert priority(logging.getLevelNamesMapping()[level]) == number


def test_each_line_of_a_traceback_has_its_priority_in_the_journal() -> None:
    made = record(logging.ERROR, "%s crashed", "bay1.vision")
    try:
        raise RuntimeError("two\nlines")
    except RuntimeError:
        made.exc_info = sys.exc_info()
    lines = formatter("text", journal=True).format(made).splitlines()
    assert lines[0] == "<3>gateway.x: bay1.vision crashed"
    assert lines[-2:] == ["<3>RuntimeError: two", "<3>lines"]
    assert all(line.startswith("<3>") for line in lines)


def test_for_people_it_has_time_and_level() -> None:
    line = formatter("text", journal=False).format(record(logging.WARNING, "port %d", 502))
    assert line.endswith(" WARNING gateway.x: port 502")
    assert not line.startswith("<")


@pytest.mark.parametrize("journal", [True, False])
def test_json_has_utc_and_the_fields(journal: bool) -> None:
    line = formatter("json", journal=journal).format(record(logging.INFO, "„%s“", "ä", bay="bay1", radius_px=180.5))
    assert line.startswith("<6>{" if journal else "{")
    assert json.loads(line.removeprefix("<6>")) == {
        "time": "2023-11-14T22:13:20.123+00:00",
        "level": "info",
        "logger": "gateway.x",
        "message": "„ä“",
        "bay": "bay1",
        "radius_px": 180.5,
    }
    assert "\n" not in line


def test_an_event_s_line_has_bay_radius_distance_and_reason() -> None:
    out = io.StringIO()
    handler = logging.StreamHandler(out)
    handler.setFormatter(formatter("json", journal=False))
    logger = logging.getLogger("gateway.bay")
    logger.addHandler(handler)
    before = logger.level
    logger.setLevel("INFO")
    try:
        clock = HandClock()
        control = BayControl(BayConfig(), Hub(["bay1"]), clock)
        control.on_reading(VisionReading(clock.now_ns(), Quality.GOOD, Circle(1.0, 2.0, 100.04)))
        control.on_reading(RangeReading(clock.now_ns(), Quality.GOOD, 900.0))
        control.on_reading(RangeReading(clock.now_ns(), Quality.LINK_DOWN, detail="no such device"))
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
    lines = [json.loads(line) for line in out.getvalue().splitlines()]
    wanted = ("bay", "event", "radius_px", "distance_mm", "reason")
    assert [tuple(line[key] for key in wanted) for line in (lines[0], lines[-1])] == [
        ("bay1", "start", None, None, "starting"),
        ("bay1", "sensor_fault", 100.0, None, lines[-1]["reason"]),
    ]
    assert lines[-1]["message"] == "bay1: sensor fault (range link_down): no such device"


def test_the_journal_is_known_by_its_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    ours, theirs = socket.socketpair()
    with closing(ours), closing(theirs), (tmp_path / "log").open("w") as file:
        assert not to_journal(ours)
        found = os.fstat(ours.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{found.st_dev}:{found.st_ino}")
        assert to_journal(ours)
        assert not to_journal(file), "stderr was sent elsewhere"
        assert not to_journal(io.StringIO())
