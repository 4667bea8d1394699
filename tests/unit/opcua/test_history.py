"""What of the last hour is kept and read."""

import asyncio
from datetime import UTC, datetime, timedelta
from typing import Any

from asyncua import ua

from gateway.opcua.history import MAX_ENTRIES, MOST, LastHour

NODE = ua.NodeId("bay1.distance_mm", 2)
T0 = datetime(2026, 11, 28, 4, 0, tzinfo=UTC)


def value(number: Any, seconds: float, code: int = ua.StatusCodes.Good) -> ua.DataValue:
    return ua.DataValue(ua.Variant(number), ua.StatusCode(code), SourceTimestamp=T0 + timedelta(seconds=seconds))


def kept(*values: ua.DataValue) -> LastHour:
    history = LastHour()
    history.keep(NODE)
    for one in values:
        history.note(NODE, one)
    return history


def read(history: LastHour, start: float | None, end: float | None, most: int = 0) -> list[Any]:
    times = [None if one is None else T0 + timedelta(seconds=one) for one in (start, end)]
    found, _ = asyncio.run(history.read_node_history(NODE, times[0], times[1], most))
    return [one.Value.Value for one in found]


def test_numbers_are_kept_once_a_second_and_a_change_of_quality_at_once() -> None:
    bad = ua.StatusCodes.BadSensorFailure
    history = kept(value(1.0, 0), value(2.0, 0.5), value(3.0, 1), value(None, 1.1, bad), value(None, 1.2, bad))
    assert read(history, 0, 10) == [1.0, 3.0, None]


def test_what_is_no_number_is_kept_with_every_change_and_again_each_minute() -> None:
    history = kept(value(True, 0), value(False, 0.1), value(False, 30), value(False, 60.1), value(True, 60.2))
    assert read(history, 0, 100) == [True, False, False, True]


def test_both_ends_count_and_the_newest_come_first_where_the_end_lies_before() -> None:
    history = kept(*(value(float(n), n) for n in range(6)))
    assert read(history, 1, 3) == [1.0, 2.0, 3.0]
    assert read(history, 3, 1) == [3.0, 2.0, 1.0]
    assert read(history, 2, None, 2) == [2.0, 3.0]
    assert read(history, None, 4, 2) == [4.0, 3.0]
    assert read(history, None, None) == [5.0, 4.0, 3.0, 2.0, 1.0, 0.0]


def test_it_is_bounded_in_time_number_and_answer() -> None:
    history = kept(*(value(float(n), n) for n in range(MAX_ENTRIES + 10)))
    found, more = asyncio.run(history.read_node_history(NODE, T0, None, 0))
    newest = MAX_ENTRIES + 9
    assert found[0].Value.Value == newest - 3600
    assert (len(found), more) == (MOST, found[0].SourceTimestamp + timedelta(seconds=MOST))


def test_after_a_step_of_the_clock_backwards_it_begins_anew() -> None:
    assert read(kept(value(1.0, 100), value(2.0, 50)), 0, 200) == [2.0]
    assert read(LastHour(), 0, 200) == []
