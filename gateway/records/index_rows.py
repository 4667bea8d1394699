"""What the index holds of one segment: its visits, its events, and its minutes. Pure: records in, rows out.

A row depends on the records of its own segment only, so that the index can be made anew from any of them.
"""

from dataclasses import dataclass, field

import msgspec

from gateway.core.readings import FRESH_FRAME, Quality
from gateway.core.visit_summary import VisitEnd
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.records.record import (
    AnyRecord,
    Checkpoint,
    Decision,
    DistanceRecord,
    EventRecord,
    FrameRecord,
    Gap,
    NotedKind,
    RegisterImage,
    VisitRecord,
)
from gateway.records.segment import Head

MINUTE_NS = 60 * NS_PER_S
MAX_EVENTS = 1000  # of one segment, and as many changes of alarms; what flickers is in the segment, and counted here
LONGEST_STEP_NS = NS_PER_S  # records that are farther apart: nothing is known of the time between them

VisitRow = tuple[int, int, str]  # begun_ms, ended_ms, VisitSummary as JSON
EventRow = tuple[int, str, str, str, str]  # t_ms, kind, sensor, quality, detail
MinuteRow = tuple[int | float | str | None, ...]  # as MINUTE_COLUMNS
MINUTE_COLUMNS = (
    "minute", "recorded_s", "may_move_s", "in_place_s", "stop_s", "stops", "frames", "faults",
    "r_min", "r_mean", "r_max", "z_min", "z_mean", "z_max",
)  # fmt: skip


@dataclass(slots=True)
class MinMeanMax:
    """Least, mean and largest of what was measured."""

    count: int = 0
    total: float = 0.0
    least: float = 0.0
    most: float = 0.0

    def add(self, value: float) -> None:
        self.least = value if not self.count else min(self.least, value)
        self.most = value if not self.count else max(self.most, value)
        self.count += 1
        self.total += value

    @property
    def row(self) -> tuple[float | None, float | None, float | None]:
        if not self.count:
            return None, None, None
        return round(self.least, 2), round(self.total / self.count, 2), round(self.most, 2)


@dataclass(slots=True)
class Minute:
    """One minute of Unix time, as far as it was recorded. Times in ns; `stop_ns` by reason; `stops`: how often each
    reason has become that of `stop`."""

    number: int  # since 1970
    recorded_ns: int = 0
    may_move_ns: int = 0
    in_place_ns: int = 0
    stop_ns: dict[str, int] = field(default_factory=dict)
    stops: dict[str, int] = field(default_factory=dict)
    frames: int = 0
    faults: int = 0
    radius_px: MinMeanMax = field(default_factory=MinMeanMax)
    distance_mm: MinMeanMax = field(default_factory=MinMeanMax)

    @property
    def row(self) -> MinuteRow:
        stop_s = {reason: _s(ns) for reason, ns in sorted(self.stop_ns.items())}
        return (
            self.number, _s(self.recorded_ns), _s(self.may_move_ns), _s(self.in_place_ns),
            _json(stop_s), _json(dict(sorted(self.stops.items()))), self.frames, self.faults,
            *self.radius_px.row, *self.distance_mm.row,
        )  # fmt: skip


@dataclass(slots=True)
class SegmentRows:
    """The rows of one segment, in the order of its records. With another `minute_ns` the "minutes" are this long."""

    head: Head
    minute_ns: int = MINUTE_NS
    visits: list[VisitRow] = field(default_factory=list)
    events: list[EventRow] = field(default_factory=list)
    minutes: list[MinuteRow] = field(default_factory=list)  # those that are over
    events_left_out: int = 0
    lost: int = 0  # records that could not be written
    end_ms: int = 0
    _offset_ns: int = 0  # Unix time minus monotonic time
    _minute: Minute | None = None
    _decision: Decision | None = None
    _before_ns: int | None = None
    _event_count: int = 0
    _alarm_count: int = 0

    def __post_init__(self) -> None:
        self._offset_ns = self.head.unix_ns - self.head.t_ns
        self.end_ms = self.head.unix_ns // NS_PER_MS

    @property
    def begun_ms(self) -> int:
        """Unix time."""
        return self.head.unix_ns // NS_PER_MS

    def follow(self, head: Head) -> None:
        """What comes now is of another segment."""
        self.head = head
        self._offset_ns = head.unix_ns - head.t_ns
        self.broken()

    def broken(self) -> None:
        """Nothing is known of the time between the record before and the next."""
        self._decision = self._before_ns = None

    def add(self, record: AnyRecord) -> None:
        """The next record."""
        if isinstance(record, RegisterImage):
            self._offset_ns = record.unix_ns - record.t_ns
        minute = self._at(record.t_ns)
        match record:
            case Decision():
                self._decide(record, minute)
            case Checkpoint():
                self._decide(Decision.of(record.state), minute, follows=record.follows)
            case Gap():
                self._decision = None
                self.lost += record.lost
            case FrameRecord():
                minute.frames += record.reading.quality in FRESH_FRAME
                if record.reading.quality is Quality.GOOD and record.reading.circle is not None:
                    minute.radius_px.add(record.reading.circle.radius_px)
            case DistanceRecord():
                if record.reading.quality is Quality.GOOD and record.reading.distance_mm is not None:
                    minute.distance_mm.add(record.reading.distance_mm)
            case EventRecord():
                minute.faults += record.kind == "sensor_fault"
                self._event(record)
            case VisitRecord():
                if record.visit.end is not VisitEnd.OPEN:
                    text = msgspec.json.encode(record.visit).decode()
                    self.visits.append((record.visit.begun_ms, record.visit.last_seen_ms, text))
            case _:
                pass

    def finish(self) -> None:
        """The segment has ended: so has its last minute."""
        if self._minute is not None:
            self.minutes.append(self._minute.row)
            self._minute = None

    def _decide(self, decision: Decision, minute: Minute, *, follows: bool = False) -> None:
        """A stop that is on after a gap or a restart counts, whether or not it was on before. `follows`: it was so at
        the end of the segment before."""
        before, self._decision = self._decision, decision
        if before is None and follows:
            return
        if decision.stop and (before is None or not before.stop or before.reason is not decision.reason):
            reason = decision.reason.name.lower()
            minute.stops[reason] = minute.stops.get(reason, 0) + 1

    def _event(self, record: EventRecord) -> None:
        alarm = record.kind == NotedKind.ALARM
        self._alarm_count += alarm
        self._event_count += not alarm
        if (self._alarm_count if alarm else self._event_count) > MAX_EVENTS:
            self.events_left_out += 1
            return
        quality = record.quality.name if record.sensor in ("vision", "range") else ""
        t_ms = (record.t_ns + self._offset_ns) // NS_PER_MS
        self.events.append((t_ms, record.kind, record.sensor, quality, record.detail))

    def _at(self, t_ns: int) -> Minute:
        """The minute of that moment; the time until then counts as what was decided before."""
        unix_ns = t_ns + self._offset_ns
        self.end_ms = max(self.end_ms, unix_ns // NS_PER_MS)
        number = unix_ns // self.minute_ns
        if self._minute is not None and number != self._minute.number:
            self.minutes.append(self._minute.row)
            self._minute = None
        if self._minute is None:
            self._minute = Minute(number)
        decision, before_ns, self._before_ns = self._decision, self._before_ns, t_ns
        if decision is not None and before_ns is not None and 0 < (step_ns := t_ns - before_ns) <= LONGEST_STEP_NS:
            minute = self._minute
            minute.recorded_ns += step_ns
            minute.may_move_ns += step_ns * decision.may_move
            minute.in_place_ns += step_ns * decision.in_place
            if decision.stop:
                reason = decision.reason.name.lower()
                minute.stop_ns[reason] = minute.stop_ns.get(reason, 0) + step_ns
        return self._minute


def _json(values: dict[str, float] | dict[str, int]) -> str:
    return msgspec.json.encode(values).decode()


def _s(ns: int) -> float:
    return round(ns / NS_PER_S, 3)
