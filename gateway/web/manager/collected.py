"""The figures of some days, made of the index day by day, so that other questions are answered in between. IO."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from gateway.core.visit_summary import VisitSummary
from gateway.records.alarm_rates import KINDS, AlarmFigures, alarm_figures
from gateway.records.days import LocalDay
from gateway.records.index_reader import IndexReader
from gateway.records.statistics import MINUTE_S, Positions, Times, positions_of, times_of, together
from gateway.web.history.records_thread import RecordsThread

MAX_MINUTES = 8 * 60 * 24  # rows of a day: a minute in two segments is two
MAX_VISITS = 1000  # of a day
MAX_EVENTS = 50_000  # changes of alarms
LOOK_BACK_MS = 7 * 86_400_000  # for alarms that were active already


@dataclass(frozen=True, slots=True)
class DayFigures:
    day: LocalDay
    times: Times
    positions: Positions


@dataclass(frozen=True, slots=True)
class Figures:
    """`remarks`: why something may be missing, for people."""

    days: tuple[DayFigures, ...]
    times: Times
    positions: Positions
    alarms: AlarmFigures
    span_ms: tuple[int, int] | None  # what the index has of the bay at all; None: nothing yet
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Read:
    figures: DayFigures
    visits: list[VisitSummary]
    recorded_s: dict[int, float]  # by minute
    cut: bool


async def figures(records: RecordsThread, bay: str, days: Sequence[LocalDay], now_ms: int) -> Figures:
    """A truck is of the day on which it arrived. Raises RefusalError where there is no index."""
    span_ms = await records.index(lambda reader: reader.span(bay))
    read = [await records.index(partial(_read_day, bay=bay, day=day, now_ms=now_ms)) for day in days]
    recorded_s: dict[int, float] = {}
    for one in read:
        recorded_s |= one.recorded_s
    since_ms, until_ms = days[0].begin_ms - LOOK_BACK_MS, days[-1].end_ms

    def alarms(reader: IndexReader) -> tuple[AlarmFigures, bool, int]:
        events = reader.events(bay, since_ms, until_ms, MAX_EVENTS, KINDS)
        left_out = reader.events_left_out(bay, days[0].begin_ms, until_ms)
        return alarm_figures(events, days, recorded_s, now_ms), len(events) == MAX_EVENTS, left_out

    alarm, alarms_cut, left_out = await records.index(alarms)
    remarks = []
    if cut := [str(one.figures.day.date) for one in read if one.cut]:
        remarks.append(f"more than {MAX_VISITS} visits, of which the newest count: {', '.join(cut)}")
    if alarms_cut:
        remarks.append(f"more than {MAX_EVENTS} changes of alarms, of which the oldest count: choose fewer days")
    if left_out:
        remarks.append(f"{left_out} events came so often that they are not in the index: alarms may be missing here")
    return Figures(
        days=tuple(one.figures for one in read),
        times=together([one.figures.times for one in read]),
        positions=positions_of(visit for one in read for visit in one.visits),
        alarms=alarm,
        span_ms=span_ms,
        remarks=tuple(remarks),
    )


def _read_day(reader: IndexReader, bay: str, day: LocalDay, now_ms: int) -> _Read:
    minutes = reader.minutes(bay, day.begin_ms, day.end_ms, MAX_MINUTES)
    found = reader.visits(bay, day.begin_ms, day.end_ms, MAX_VISITS + 1)
    visits = [visit for visit in found[:MAX_VISITS] if visit.begun_ms >= day.begin_ms]
    recorded_s: dict[int, float] = {}
    for row in minutes:
        minute, seconds = int(str(row["minute"])), float(str(row["recorded_s"]))
        recorded_s[minute] = min(MINUTE_S, recorded_s.get(minute, 0.0) + seconds)
    made = DayFigures(day, times_of(minutes, day.passed_s(now_ms)), positions_of(visits))
    return _Read(made, visits, recorded_s, len(found) > MAX_VISITS)
