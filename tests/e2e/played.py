"""What the emulated board played, beside what the gateway made of it: when each reading was taken."""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gateway.clock import SystemClock
from gateway.core.readings import RangeReading
from gateway.ranger.arrival_times import LATE_NS

FLIGHT_NS = 12_000_000  # a date is of the echo; the sound to a target at 4 m takes 12 ms

LINE_NS = 60_000_000  # a cycle: from the trigger to the end of the line


def lines(log: Path) -> int:
    """How many lines the board has sent so far."""
    return log.read_text().count('"type": "line"')


def too_fresh_ns(log: Path, readings: Iterable[RangeReading], clock: SystemClock) -> list[int]:
    """By how much of `clock` each reading is dated later than the board took it, for a target that comes nearer.

    Its distance tells when a reading was taken: a board that cannot keep up on a busy machine measures later than
    planned, and wrote down when it did. A median of two lies half way between them, and so does its date.
    """
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    taken = [row for row in reversed(rows) if row["type"] == "trigger" and row.get("true_mm", -1.0) > 0]
    true_mm, real_ns = [row["true_mm"] for row in taken], [row["real_ns"] - clock.origin_ns for row in taken]
    assert true_mm == sorted(true_mm)
    measured = [reading for reading in readings if reading.distance_mm is not None]
    at_ns = np.interp([reading.distance_mm or 0.0 for reading in measured], true_mm, real_ns)
    return [round(r.t_ns - clock.origin_ns - at * clock.speed) for r, at in zip(measured, at_ns, strict=True)]


def dated_right(fresh_ns: list[int]) -> bool:
    """The contract of gateway/ranger/arrival_times.py: no date is more than 150 ms too fresh.

    Nor is one older than a line takes: a board that catches up with the machine's time sends faster than a wire could.
    """
    return bool(fresh_ns) and min(fresh_ns) >= -LINE_NS and max(fresh_ns) <= LATE_NS + FLIGHT_NS
