"""What a bay has done, in figures: expected numbers, and that no second is counted twice or made up."""

import itertools
from dataclasses import astuple, replace
from datetime import date
from typing import Any
from zoneinfo import ZoneInfo

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.state import Moved, Reason
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.records.days import local_days
from gateway.records.index_rows import MINUTE_COLUMNS
from gateway.records.statistics import (
    CauseKind,
    Distribution,
    StopCause,
    Times,
    positions_of,
    times_of,
    together,
)

BERLIN = ZoneInfo("Europe/Berlin")
STOPS = {"no_target": 20.0, "camera_down": 10.0, "target_reached": 5.0}


def minute(number: int, recorded_s: float = 60.0, may_move_s: float = 0.0, **more: Any) -> dict[str, Any]:
    row = dict.fromkeys(MINUTE_COLUMNS, None) | {
        "minute": number, "recorded_s": recorded_s, "may_move_s": may_move_s, "in_place_s": 0.0, "stop_s": "{}",
        "stops": "{}", "frames": 0, "faults": 0,
    }  # fmt: skip
    for name in ("stop_s", "stops"):
        more[name] = msgspec.json.encode(more.get(name, {})).decode()
    return row | more


def visit(begun_ms: int, **more: Any) -> VisitSummary:
    return replace(VisitSummary(begun_ms, 100.0, VisitEnd.CLEAR), **more)


def test_a_day_of_two_minutes_and_a_gap() -> None:
    rows = [
        minute(10, may_move_s=25.0, stop_s=STOPS, stops={"no_target": 2, "camera_down": 1, "target_reached": 1}),
        minute(12, 30.0, in_place_s=12.0, stop_s={"target_reached": 30.0}, stops={"target_reached": 1}, faults=3),
    ]
    found = times_of(rows, 600.0)
    assert (found.recorded_s, found.unrecorded_s, found.may_move_s, found.in_place_s) == (90, 510, 25, 12)
    assert found.causes == (
        StopCause("target_reached", 35.0, 2),
        StopCause("no_target", 20.0, 2),
        StopCause("camera_down", 10.0, 1),
    )
    assert [found.of_kind_s(kind) for kind in CauseKind] == [35, 20, 10]
    assert found.neither_s == 0
    assert found.good_s == 80
    assert found.availability == pytest.approx(80 / 90)
    assert found.recorded_share == pytest.approx(90 / 600)
    assert found.sensor_faults == 3


def test_what_was_not_recorded_is_neither_available_nor_stopped() -> None:
    empty = times_of([], 86_400.0)
    assert (empty.recorded_s, empty.unrecorded_s, empty.causes) == (0, 86_400, ())
    assert empty.availability is None
    assert empty.recorded_share == 0
    assert times_of([], 0.0).recorded_share is None, "a day that has not begun"


def test_what_is_neither_stop_nor_permit_is_its_own() -> None:
    assert times_of([minute(1, may_move_s=10.0, stop_s={"no_target": 30.0})], 60.0).neither_s == 20


def test_a_minute_that_is_there_twice_counts_as_one() -> None:
    """The clock was set back by an hour: it was recorded twice."""
    twice = [minute(7, may_move_s=60.0), minute(7, stop_s={"camera_down": 60.0}, stops={"camera_down": 1})]
    found = times_of(twice, 60.0)
    assert (found.recorded_s, found.may_move_s, found.good_s) == (60, 30, 30)
    assert found.causes == (StopCause("camera_down", 30.0, 1),)
    of_two_segments = times_of([minute(7, 20.0, 20.0), minute(7, 40.0, 5.0)], 60.0)
    assert (of_two_segments.recorded_s, of_two_segments.may_move_s) == (60, 25)


def test_the_newest_minute_may_be_later_than_now() -> None:
    assert times_of([minute(1)], 59.5).unrecorded_s == 0


def test_every_reason_has_its_kind() -> None:
    kinds = {reason: StopCause(reason.name.lower(), 1.0, 1).kind for reason in Reason if reason is not Reason.NONE}
    assert {reason for reason, kind in kinds.items() if kind is CauseKind.AT_MARK} == {
        Reason.TARGET_REACHED, Reason.STOP_LATCHED, Reason.MOVED,
    }  # fmt: skip
    assert {reason for reason, kind in kinds.items() if kind is CauseKind.NO_MEASUREMENT} == {
        Reason.STARTING, Reason.NO_TARGET, Reason.TARGET_COASTED, Reason.NO_ECHO, Reason.RANGE_TOO_FAR,
        Reason.CLEARING, Reason.SHUTDOWN,
    }  # fmt: skip
    assert StopCause("of_a_later_version", 1.0, 1).kind is CauseKind.FAULT


SECONDS = st.floats(0, 60, allow_nan=False)
ROWS = st.builds(
    minute,
    st.integers(0, 30),
    SECONDS,
    SECONDS,
    in_place_s=SECONDS,
    stop_s=st.dictionaries(st.sampled_from([reason.name.lower() for reason in Reason]), SECONDS, max_size=4),
    stops=st.dictionaries(st.sampled_from([reason.name.lower() for reason in Reason]), st.integers(0, 9), max_size=4),
    faults=st.integers(0, 3),
)


@pytest.mark.long
@pytest.mark.one_interpreter
@given(st.lists(ROWS, max_size=40), st.floats(0, 1800))
def test_no_second_is_made_up(rows: list[dict[str, Any]], passed_s: float) -> None:
    found = times_of(rows, passed_s)
    numbers = {row["minute"] for row in rows}
    assert found.recorded_s <= 60 * len(numbers) + 1e-6
    assert found.recorded_s <= found.passed_s
    assert found.recorded_s + found.unrecorded_s == pytest.approx(found.passed_s)
    assert 0 <= found.good_s <= found.recorded_s
    assert found.availability is None or 0 <= found.availability <= 1
    assert sum(cause.times for cause in found.causes) == sum(
        sum(msgspec.json.decode(row["stops"]).values()) for row in rows
    )
    lengths = [cause.seconds for cause in found.causes]
    assert lengths == sorted(lengths, reverse=True)


@pytest.mark.one_interpreter
@given(st.lists(st.lists(ROWS, max_size=6), max_size=4))
def test_days_together_are_their_sum(parts: list[list[dict[str, Any]]]) -> None:
    days = [times_of(rows, 600.0) for rows in parts]
    found = together(days)
    for name in ("passed_s", "recorded_s", "may_move_s", "in_place_s", "sensor_faults"):
        assert getattr(found, name) == pytest.approx(sum(getattr(day, name) for day in days))
    for kind in CauseKind:
        assert found.of_kind_s(kind) == pytest.approx(sum(day.of_kind_s(kind) for day in days))
    assert sum(cause.times for cause in found.causes) == sum(cause.times for day in days for cause in day.causes)


def test_nothing_together_is_nothing() -> None:
    assert together([]) == Times()


# Visits.


def test_positions_of_four_trucks() -> None:
    found = positions_of(
        [
            visit(1, times_in_place=1, to_position_s=20.0, offset_mm=-4.0, radius_px=190.0, distance_mm=300.0),
            visit(2, times_in_place=2, to_position_s=40.0, offset_mm=8.0, radius_px=192.0, distance_mm=310.0,
                  corrections=3, moved=list(Moved)[1]),
            visit(3, end=VisitEnd.GATEWAY_OFF, length_s=9.0),
            visit(4, times_in_place=1, to_position_s=900.0, length_s=990.0, interruptions=1, corrections=1,
                  distance_mm=320.0),
        ]
    )  # fmt: skip
    assert (found.trucks, found.placed, found.moved, found.interrupted, found.unwatched_end) == (4, 3, 1, 1, 1)
    assert (found.corrections, found.corrected) == (4, 2)
    assert found.to_position_s is not None
    assert (found.to_position_s.count, found.to_position_s.median) == (2, 30.0), "without the time of the restart"
    assert found.length_s is not None
    assert (found.length_s.count, found.length_s.mean) == (2, 100.0), "both with an end that was seen, and not cut"
    assert found.offset_mm is not None
    assert (found.offset_mm.least, found.offset_mm.mean, found.offset_mm.largest) == (-4, 2, 8)
    assert found.offset_px is None
    assert found.distance_mm is not None
    assert found.distance_mm.deviation == pytest.approx((200 / 3) ** 0.5)


def test_no_truck_has_no_figures() -> None:
    found = positions_of([])
    assert (found.trucks, found.placed, found.to_position_s, found.distance_mm) == (0, 0, None, None)


def test_a_visit_that_is_there_twice_counts_once() -> None:
    found = positions_of([visit(1, to_position_s=5.0), visit(1, to_position_s=9.0)])
    assert found.trucks == 1
    assert found.to_position_s is not None
    assert found.to_position_s.mean == 5.0


def test_quantiles_lie_between_the_values() -> None:
    found = Distribution.of([None, 4.0, 1.0, 3.0, 2.0])
    assert found is not None
    assert astuple(found) == pytest.approx((4, 1.0, 1.3, 2.5, 3.7, 4.0, 2.5, 1.25**0.5))
    assert Distribution.of([7.0]) == Distribution(1, 7, 7, 7, 7, 7, 7, 0)
    assert Distribution.of([None]) is None


@given(st.lists(st.floats(-1e6, 1e6), min_size=1))
def test_a_distribution_is_in_order(values: list[float]) -> None:
    found = Distribution.of(values)
    assert found is not None
    tolerance = 1e-6 * max(1.0, *map(abs, values))
    order = [found.least, found.p10, found.median, found.p90, found.largest]
    assert all(a <= b + tolerance for a, b in itertools.pairwise(order))
    assert found.least - tolerance <= found.mean <= found.largest + tolerance
    assert 0 <= found.deviation <= found.largest - found.least + tolerance


def test_a_day_of_25_hours_has_25_hours() -> None:
    (day,) = local_days(date(2026, 10, 25), date(2026, 10, 25), BERLIN)
    first = day.begin_ms // 60_000
    found = times_of([minute(first + n) for n in range(25 * 60)], day.passed_s(day.end_ms))
    assert (found.recorded_s, found.unrecorded_s) == (25 * 3600, 0)
