"""What of the last hour is kept and read."""

import asyncio
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from asyncua import ua
from asyncua.common.event_objects import AlarmCondition, BaseEvent
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AddressSpace

from gateway.opcua.history import MAX_ENTRIES, MAX_EVENTS, MOST, LastHour
from gateway.opcua.sent_event import MAX_FIELDS, MAX_OPERANDS, SentEvent

SERVER = ua.NodeId(ua.ObjectIds.Server)
NODE = ua.NodeId("bay1.distance_mm", 2)
T0 = datetime(2026, 11, 28, 4, 0, tzinfo=UTC)


def value(number: Any, seconds: float, code: int = ua.StatusCodes.Good) -> ua.DataValue:
    return ua.DataValue(ua.Variant(number), ua.StatusCode(code), SourceTimestamp=T0 + timedelta(seconds=seconds))


def kept(*values: ua.DataValue) -> LastHour:
    history = LastHour(AddressSpace())
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
    assert read(LastHour(AddressSpace()), 0, 200) == []


def test_what_was_asked_for_in_parts_goes_on_to_the_end() -> None:
    history = kept(*(value(float(n), n) for n in range(5)), value(None, 4, ua.StatusCodes.BadNoCommunication))

    def part(start: datetime, end: datetime) -> tuple[list[Any], datetime | None]:
        found, more = asyncio.run(history.read_node_history(NODE, start, end, 2))
        return [one.Value.Value for one in found], more

    at = [T0 + timedelta(seconds=n) for n in range(6)]
    assert part(at[0], at[5]) == ([0.0, 1.0], at[2])
    assert part(at[2], at[5]) == ([2.0, 3.0], at[4])
    assert part(at[4], at[5]) == ([4.0, None], None)
    assert part(at[3], at[0]) == ([3.0, 2.0], at[1])


def test_a_camera_long_gone_does_not_end_the_history_when_the_gateway_was_silent() -> None:
    down, silent = ua.StatusCodes.BadNotConnected, ua.StatusCodes.BadNoCommunication
    entries = value(1.0, 0), value(None, 0, down), value(None, 600, silent), value(None, 0, down), value(2.0, 601)
    history = kept(*entries)
    assert read(history, 0, 700) == [1.0, None, None, None, 2.0]
    assert read(history, 600, 600) == [None, None]


def sent(number: int, seconds: float, kind: type[BaseEvent] = BaseEvent) -> SentEvent:
    event = kind(severity=number)
    event.Time = T0 + timedelta(seconds=seconds)
    return SentEvent(event)


def path(*names: str) -> ua.SimpleAttributeOperand:
    return ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName(name) for name in names])


def element(operator: ua.FilterOperator, *operands: Any) -> ua.ContentFilterElement:
    return ua.ContentFilterElement(operator, list(operands))


def severities(
    history: LastHour, start: float | None, end: float | None, most: int = 0, *where: ua.ContentFilterElement
) -> tuple[list[int], float | None]:
    """With the seconds from which on the next response goes."""
    times = [None if one is None else T0 + timedelta(seconds=one) for one in (start, end)]
    wanted = ua.EventFilter([path("Severity")], ua.ContentFilter(list(where)))
    found, more = asyncio.run(history.read_event_history(SERVER, times[0], times[1], most, wanted))
    return [one.Severity for one in found], None if more is None else (more - T0).total_seconds()


def events(*sent_events: SentEvent) -> LastHour:
    history = LastHour(AddressSpace())
    for one in sent_events:
        history.note_event(one)
    return history


def test_events_come_by_their_time_not_as_they_were_sent() -> None:
    history = events(sent(1, 10), sent(2, 30), sent(3, 20))
    assert severities(history, 10, 30) == ([1, 3, 2], None)
    assert severities(history, 25, 15) == ([3], None)
    assert severities(history, None, 30) == ([2, 3, 1], None)
    assert severities(history, 15, None) == ([3, 2], None)


def test_events_of_one_time_are_not_divided_between_two_responses() -> None:
    history = events(sent(1, 10), sent(2, 20), sent(3, 20), sent(4, 30))
    assert severities(history, 0, 40, 2) == ([1], 20)
    assert severities(history, 20, 40, 2) == ([2, 3], 30)
    assert severities(history, 40, 0, 2) == ([4], 20)
    assert severities(history, 0, None, 2) == ([1, 2], None)  # without an end: so many and no more
    with pytest.raises(ServiceError) as refused:
        severities(history, 20, 40, 1)
    assert refused.value.code == ua.StatusCodes.BadNoContinuationPoints


def test_the_oldest_events_make_way() -> None:
    history = events(*(sent(n, n) for n in range(MAX_EVENTS + 5)))
    assert severities(history, 0, 100_000)[0] == list(range(5, MAX_EVENTS + 5))


def test_only_what_the_where_clause_names_is_read() -> None:
    history = events(sent(200, 1), sent(500, 2), sent(800, 3, AlarmCondition))
    kinds = ua.FilterOperator
    above = element(kinds.GreaterThan, path("Severity"), ua.LiteralOperand(ua.Variant(300)))
    alarm = element(kinds.OfType, ua.LiteralOperand(ua.Variant(ua.NodeId(ua.ObjectIds.AlarmConditionType))))
    both = element(kinds.And, ua.ElementOperand(1), ua.ElementOperand(2))
    assert severities(history, 0, 9, 0, above)[0] == [500, 800]
    assert severities(history, 0, 9, 0, both, above, alarm)[0] == [800]


def test_a_where_clause_that_does_not_end_or_is_too_large_is_refused() -> None:
    history = events(sent(1, 1))
    again = element(ua.FilterOperator.Not, ua.ElementOperand(0))
    twice = element(ua.FilterOperator.And, ua.ElementOperand(1), ua.ElementOperand(1))
    large = element(ua.FilterOperator.InList, *[path("Severity")] * (MAX_OPERANDS + 1))
    codes = []
    for where in ([again], [twice, again], [large]):
        with pytest.raises(ServiceError) as refused:
            severities(history, 0, 9, 0, *where)
        codes.append(refused.value.code)
    invalid = ua.StatusCodes.BadContentFilterInvalid
    assert codes == [invalid, invalid, ua.StatusCodes.BadTooManyOperations]
    fields = ua.EventFilter([path("Severity")] * (MAX_FIELDS + 1))
    with pytest.raises(ServiceError):
        asyncio.run(history.read_event_history(SERVER, T0, None, 0, fields))


def test_a_field_that_an_event_does_not_have_is_null() -> None:
    """Whatever it is called: the library's own event fails at names of its insides."""
    event = sent(7, 0)
    asked = [
        path("Severity"), path("data_types"), path("_fields"), path("to_event_fields"), path("A", "B"),
        ua.SimpleAttributeOperand(AttributeId=ua.AttributeIds.NodeId), ua.SimpleAttributeOperand(AttributeId=99),
        ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName(None), ua.QualifiedName(None)]),
    ]  # fmt: skip
    assert [one.Value for one in event.to_event_fields(asked)] == [7, *[None] * 7]
