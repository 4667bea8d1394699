"""The last hour of a few values and the last events, in memory, for HistoryRead: a limited number of each."""

from collections import deque
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AddressSpace
from asyncua.server.history import HistoryStorageInterface

from gateway.opcua.sent_event import SentEvent, check_filter, matching

KEPT = timedelta(hours=1)
MAX_ENTRIES = 4000  # of one value; the oldest make way
MOST = 2000  # in one response; a continuation point follows
LEAST_S = 1.0  # between two numbers of a value
AGAIN_S = 60.0  # a value that stays as it is is entered again
MAX_EVENTS = 1000


class LastHour(HistoryStorageInterface):  # type: ignore[misc]  # without types of its own
    """`nodes`: those of the server, which where-clauses may read."""

    def __init__(self, nodes: AddressSpace) -> None:
        super().__init__(MOST)
        self._nodes = nodes
        self._kept: dict[ua.NodeId, deque[ua.DataValue]] = {}
        self._events: deque[SentEvent] = deque(maxlen=MAX_EVENTS)

    def keep(self, node: ua.NodeId) -> None:
        self._kept[node] = deque(maxlen=MAX_ENTRIES)

    def note(self, node: ua.NodeId, value: ua.DataValue) -> None:
        """What is not kept is ignored. Times only go forward: after a step of the clock the former entries go."""
        entries = self._kept.get(node)
        if entries is None:
            return
        last = entries[-1] if entries else None
        if last is not None and value.SourceTimestamp < last.SourceTimestamp:
            if value.StatusCode.is_bad():  # since a frame of before the last entry: of a camera long gone
                value = replace(value, SourceTimestamp=last.SourceTimestamp)
            else:
                entries.clear()
                last = None
        if last is None or _due(last, value):
            entries.append(value)

    def note_event(self, event: SentEvent) -> None:
        self._events.append(event)

    async def read_node_history(
        self, node_id: ua.NodeId, start: datetime | None, end: datetime | None, nb_values: int
    ) -> tuple[list[ua.DataValue], datetime | None]:
        """Both ends included; newest first where only the end is given, or where it lies before the start. Raises
        ServiceError for more than `nb_values` of one time."""
        entries = list(self._kept.get(node_id, ()))
        first, last, backwards = _span(start, end)
        most = min(nb_values or MOST, MOST)
        goes_on = most != nb_values or None not in (first, last)
        if entries:
            oldest = entries[-1].SourceTimestamp - KEPT
            first = oldest if first is None else max(first, oldest)
        found = [one for one in entries if _within(one.SourceTimestamp, first, last)]
        if backwards:
            found.reverse()
        return _page(found, [one.SourceTimestamp for one in found], most, goes_on)

    async def init(self) -> None:
        """Nothing is opened."""

    async def stop(self) -> None:
        """Nothing is closed."""

    async def new_historized_node(self, node_id: ua.NodeId, period: Any, count: int = 0) -> None:
        raise NotImplementedError

    async def save_node_value(self, node_id: ua.NodeId, datavalue: ua.DataValue) -> None:
        raise NotImplementedError

    async def new_historized_event(self, source_id: ua.NodeId, evtypes: Any, period: Any, count: int = 0) -> None:
        raise NotImplementedError

    async def save_event(self, event: Any) -> None:
        raise NotImplementedError

    async def read_event_history(
        self, source_id: ua.NodeId, start: datetime | None, end: datetime | None, nb_values: int, evfilter: Any
    ) -> tuple[list[SentEvent], datetime | None]:
        """By their Time, in the order of a value's. Raises ServiceError for a filter that is too large, and
        for more than `nb_values` events of one time."""
        check_filter(evfilter)
        first, last, backwards = _span(start, end)
        found = [one for one in self._events if one.emitting_node == source_id and _within(one.Time, first, last)]
        found = matching(found, evfilter, self._nodes)
        found.sort(key=lambda one: one.Time, reverse=backwards)
        times = [one.Time for one in found]
        return _page(found, times, nb_values or len(found), None not in (first, last))


def _page(found: list[Any], times: list[datetime], most: int, goes_on: bool) -> tuple[list[Any], datetime | None]:
    """The first response, and where the next one begins, if it `goes_on`. A continuation point is a time: all of this
    one are in the next response."""
    if len(found) <= most or not goes_on:
        return found[:most], None
    page = [one for one, at in zip(found[:most], times, strict=False) if at != times[most]]
    if not page:
        raise ServiceError(ua.StatusCodes.BadNoContinuationPoints)
    return page, times[most]


def _span(start: datetime | None, end: datetime | None) -> tuple[datetime | None, datetime | None, bool]:
    """First, last, and whether the newest comes first."""
    nothing = ua.get_win_epoch()
    start, end = (None if one is None or one == nothing else one for one in (start, end))
    backwards = start is None or (end is not None and end < start)
    return (end, start, True) if start is not None and backwards else (start, end, backwards)


def _due(last: ua.DataValue, value: ua.DataValue) -> bool:
    since_s = (value.SourceTimestamp - last.SourceTimestamp).total_seconds()
    if last.StatusCode != value.StatusCode or since_s >= AGAIN_S:
        return True
    number = value.Value.VariantType is ua.VariantType.Double
    return bool(last.Value != value.Value and (not number or since_s >= LEAST_S))


def _within(at: datetime, first: datetime | None, last: datetime | None) -> bool:
    return (first is None or first <= at) and (last is None or at <= last)
