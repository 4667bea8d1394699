"""How many alarms people had, as ANSI/ISA-18.2-2016 (16.4) and IEC 62682:2014 count them. Pure.

Counted are announcements: an alarm becomes unacknowledged. All shares and rates are of the recorded time. An alarm is
active from there until its cause is gone, or it is shelved, suppressed or out of service, or the gateway ends.
"""

from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from gateway.alarms.records import LoggedChange
from gateway.alarms.states import AlarmState
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.core.events import EventKind
from gateway.records.days import LocalDay
from gateway.records.record import NotedKind

MINUTE_MS = 60_000
PERIOD_MS = 10 * MINUTE_MS
HOUR_S = 3600.0
PERIOD_S = 600.0
FLOOD_BEGINS, FLOOD_ENDS = 10, 5  # more than, fewer than so many in 10 min
STALE_MS = 24 * 60 * MINUTE_MS
CHATTER_TIMES, CHATTER_MS = 3, MINUTE_MS
MOST_FREQUENT = 10
LEAST_H = 1.0  # recorded, for a verdict
KINDS = (NotedKind.ALARM.value, EventKind.START.value, EventKind.SHUTDOWN.value)
"""The kinds of events of the index that are needed here."""
_ACTIVE = (AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED)


@dataclass(frozen=True, slots=True)
class Announced:
    """An alarm became unacknowledged. Unix time, ms."""

    t_ms: int
    id: str
    kind: str


@dataclass(frozen=True, slots=True)
class Standing:
    """An alarm was active. `over`: it ended; otherwise it is active as far as is known."""

    id: str
    since_ms: int
    until_ms: int
    over: bool

    @property
    def stale(self) -> bool:
        return self.until_ms - self.since_ms > STALE_MS


@dataclass(frozen=True, slots=True)
class Frequent:
    """One alarm, and how often it was announced."""

    id: str
    kind: str
    times: int
    share: float  # of all announcements


@dataclass(frozen=True, slots=True)
class AlarmFigures:
    """Of some days. `by_day`: announcements on each. None: nothing was recorded."""

    announced: int
    by_day: tuple[int, ...]
    by_priority: dict[str, int]  # of the table: high, medium, low; an alarm of another version: unknown
    recorded_h: float
    per_hour: float | None
    per_10_min: float | None
    peak_10_min: int  # in one period of 10 min
    peak_ms: int | None  # its begin
    busy_share: float | None  # of the periods: with more than 10
    flood_share: float | None  # of the periods: of a flood
    floods: int
    frequent: tuple[Frequent, ...]
    frequent_share: float | None  # of those ten in all announcements
    chattering: tuple[str, ...]  # ids
    stale: tuple[Standing, ...]
    stale_most: int  # on one day
    standing: tuple[Standing, ...]  # at the end of what is recorded


class AlarmRateVerdict(StrEnum):
    """The names are on the wire."""

    ACCEPTABLE = "acceptable"
    MANAGEABLE = "manageable"
    TOO_MANY = "too_many"


@dataclass(frozen=True, slots=True)
class Benchmark:
    """A figure of the standard, of one operator position. `acceptable`: up to so many is very likely acceptable, `most`
    is the maximum that can be managed; the same where there is one limit. `below`: it must stay below the limit."""

    figure: str  # name of a field of AlarmFigures; of a tuple its length counts
    title: str
    acceptable: float
    most: float
    below: bool = False

    def value(self, figures: AlarmFigures) -> float | None:
        found = getattr(figures, self.figure)
        return float(len(found)) if isinstance(found, tuple) else found

    def verdict(self, figures: AlarmFigures) -> AlarmRateVerdict | None:
        """None: too little was recorded to judge."""
        value = self.value(figures)
        if value is None or figures.recorded_h < LEAST_H:
            return None
        if value < self.acceptable or (value == self.acceptable and not self.below):
            return AlarmRateVerdict.ACCEPTABLE
        return AlarmRateVerdict.MANAGEABLE if value <= self.most and not self.below else AlarmRateVerdict.TOO_MANY


BENCHMARKS: tuple[Benchmark, ...] = (
    Benchmark("per_hour", "alarms an hour, on average", 6, 12),
    Benchmark("per_10_min", "alarms in 10 min, on average", 1, 2),
    Benchmark("peak_10_min", "most alarms in 10 min", 10, 10),
    Benchmark("busy_share", "periods of 10 min with more than 10 alarms", 0.01, 0.01, below=True),
    Benchmark("flood_share", "time in alarm floods", 0.01, 0.01, below=True),
    Benchmark("chattering", "chattering alarms", 0, 0),
    Benchmark("stale_most", "alarms active for more than 24 h, on any day", 5, 5, below=True),
)
SOURCE = "ANSI/ISA-18.2-2016, 16.4; the same in IEC 62682:2014"


def alarm_figures(
    events: Iterable[Mapping[str, object]], days: Sequence[LocalDay], recorded_s: Mapping[int, float], now_ms: int
) -> AlarmFigures:
    """`events`: rows of the index of KINDS, the oldest first, from before the days, too, for what was active already.
    `days`: without a gap between them. `recorded_s`: seconds by minute of Unix time, of these days.
    """
    begin_ms, end_ms = days[0].begin_ms, days[-1].end_ms
    minutes = sorted(minute for minute, seconds in recorded_s.items() if seconds > 0)
    every, standing = _followed(events, minutes, begin_ms, end_ms, now_ms)
    announced = [one for one in every if begin_ms <= one.t_ms < end_ms]
    hours = sum(recorded_s.values()) / HOUR_S
    counts: Counter[int] = Counter(one.t_ms // PERIOD_MS for one in announced)
    periods = sorted({minute * MINUTE_MS // PERIOD_MS for minute in minutes} | set(counts))
    peak = max(counts.items(), key=lambda item: (item[1], -item[0]), default=None)
    flood, floods = _flood(periods, counts)
    times = Counter((one.id, one.kind) for one in announced)
    ranked = sorted(times.items(), key=lambda item: (-item[1], item[0]))[:MOST_FREQUENT]
    frequent = tuple(Frequent(name, kind, count, count / len(announced)) for (name, kind), count in ranked)
    stale = tuple(one for one in standing if one.stale)
    return AlarmFigures(
        announced=len(announced),
        by_day=tuple(sum(day.begin_ms <= one.t_ms < day.end_ms for one in announced) for day in days),
        by_priority=dict(Counter(_priority(one.kind) for one in announced)),
        recorded_h=hours,
        per_hour=len(announced) / hours if hours else None,
        per_10_min=len(announced) * PERIOD_S / (hours * HOUR_S) if hours else None,
        peak_10_min=peak[1] if peak else 0,
        peak_ms=peak[0] * PERIOD_MS if peak else None,
        busy_share=sum(counts[period] > FLOOD_BEGINS for period in periods) / len(periods) if periods else None,
        flood_share=flood / len(periods) if periods else None,
        floods=floods,
        frequent=frequent,
        frequent_share=sum(one.times for one in frequent) / len(announced) if announced else None,
        chattering=_chattering(announced),
        stale=stale,
        stale_most=max(sum(_stale_on(day, one) for one in stale) for day in days),
        standing=tuple(one for one in standing if not one.over),
    )


def _followed(
    events: Iterable[Mapping[str, object]], minutes: Sequence[int], begin_ms: int, end_ms: int, now_ms: int
) -> tuple[list[Announced], list[Standing]]:
    """Announcements, and how long each alarm was active, as far as that is within the days."""
    announced: list[Announced] = []
    active: dict[str, int] = {}
    found: list[Standing] = []

    def end(name: str, until_ms: int, *, over: bool) -> None:
        since_ms = active.pop(name)
        if until_ms > begin_ms:
            found.append(Standing(name, since_ms, max(since_ms, until_ms), over))

    for event in events:
        t_ms = int(str(event["t_ms"]))
        if t_ms >= min(end_ms, now_ms):
            break
        if event["kind"] != NotedKind.ALARM:
            known_ms = t_ms if event["kind"] == EventKind.SHUTDOWN else _recorded_until(minutes, t_ms)
            for name in list(active):
                end(name, min(t_ms, max(known_ms, active[name])), over=True)
            continue
        if (change := LoggedChange.of(str(event["detail"]))) is None:
            continue
        if change.after is AlarmState.UNACKNOWLEDGED:
            announced.append(Announced(t_ms, change.id, change.kind))
        if change.after in _ACTIVE:
            active.setdefault(change.id, t_ms)
        elif change.id in active:
            end(change.id, t_ms, over=True)
    known_ms = min(_recorded_until(minutes, end_ms), end_ms, now_ms)
    for name in list(active):
        end(name, max(known_ms, active[name]), over=False)
    return announced, found


def _recorded_until(minutes: Sequence[int], before_ms: int) -> int:
    """The end of the newest recorded minute that began before that moment; 0: there is none."""
    at = bisect_left(minutes, -(-before_ms // MINUTE_MS))
    return (minutes[at - 1] + 1) * MINUTE_MS if at else 0


def _flood(periods: Sequence[int], counts: Mapping[int, int]) -> tuple[int, int]:
    """Periods of floods, and floods. What was not recorded ends one."""
    flooded, floods, on, before = 0, 0, False, None
    for period in periods:
        count = counts.get(period, 0)
        went_on = on and before == period - 1 and count >= FLOOD_ENDS
        on = went_on or count > FLOOD_BEGINS
        flooded += on
        floods += on and not went_on
        before = period
    return flooded, floods


def _chattering(announced: Iterable[Announced]) -> tuple[str, ...]:
    """Ids of those that were announced so often within so short a time."""
    times: dict[str, list[int]] = defaultdict(list)
    for one in announced:
        times[one.id].append(one.t_ms)
    apart = CHATTER_TIMES - 1
    return tuple(
        sorted(
            name
            for name, at in times.items()
            if any(later - first <= CHATTER_MS for first, later in zip(at, at[apart:], strict=False))
        )
    )


def _stale_on(day: LocalDay, one: Standing) -> bool:
    return one.since_ms + STALE_MS < day.end_ms and one.until_ms > max(day.begin_ms, one.since_ms + STALE_MS)


def _priority(kind: str) -> str:
    definition = ALARM_DEFINITIONS.get(kind)
    return "unknown" if definition is None else definition.priority.name.lower()
