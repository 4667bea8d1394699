"""A bay's figures as the models of the API, and as CSV. Pure, but for the machine's time zone."""

import csv
import io
from collections.abc import Iterable
from typing import Any

from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.config import BayConfig, GatewayConfig
from gateway.core.state import Reason
from gateway.records.alarm_rates import BENCHMARKS, HOUR_S, SOURCE, AlarmFigures, Standing
from gateway.records.days import LocalDay, machine_zone_name, shown
from gateway.records.statistics import CauseKind, Distribution, Positions, StopCause, Times
from gateway.web.manager.collected import DayFigures, Figures
from gateway.web.manager.models import (
    AlarmsOfDaysView,
    BenchmarkView,
    CauseView,
    DayView,
    FrequentView,
    PositionsView,
    StandingView,
    StatisticsView,
    TimesView,
)
from gateway.web.server.models import view_of

_TEXTS = {reason.name.lower(): text for reason, text in Reason.meanings().items()}
_REASONS = tuple(reason.name.lower() for reason in Reason if reason is not Reason.NONE)
_SECONDS = ("passed_s", "recorded_s", "unrecorded_s", "good_s", "may_move_s", "in_place_s", "neither_s")
_COUNTS = ("trucks", "placed", "moved", "interrupted", "unwatched_end", "corrections", "corrected")
_MEASURED = (
    "to_position_s", "length_s", "offset_mm", "offset_px", "radius_px", "distance_mm", "stop_latency_ms", "overrun_mm",
)  # fmt: skip
_OF_EACH = ("count", "p10", "median", "p90", "mean", "deviation")
HEADER = (
    "bay", "date", "begin", "end", *_SECONDS, *(f"stop_{kind.value}_s" for kind in CauseKind), "sensor_faults",
    *_COUNTS, *(f"{name}_{figure}" for name in _MEASURED for figure in _OF_EACH), "alarms",
    *(f"stop_{reason}_{unit}" for reason in _REASONS for unit in ("s", "times")),
)  # fmt: skip


def statistics_view(config: GatewayConfig, bay: BayConfig, found: Figures, now_ms: int) -> StatisticsView:
    first, last = found.days[0].day, found.days[-1].day
    return StatisticsView(
        site=config.site,
        instance=config.instance,
        bay=bay.name,
        time_zone=machine_zone_name(),
        first=first.date,
        last=last.date,
        made=shown(now_ms),
        recorded_from=None if found.span_ms is None else shown(found.span_ms[0]),
        recorded_to=None if found.span_ms is None else shown(found.span_ms[1]),
        aim=bay.guidance.aim_u_px is not None,
        days=tuple(
            DayView(
                date=one.day.date,
                begin=shown(one.day.begin_ms),
                end=shown(one.day.end_ms),
                times=_times_view(one.times),
                positions=PositionsView.model_validate(one.positions),
                alarms=alarms,
            )
            for one, alarms in zip(found.days, found.alarms.by_day, strict=True)
        ),
        times=_times_view(found.times),
        positions=PositionsView.model_validate(found.positions),
        alarms=_alarms_view(found.alarms),
        remarks=found.remarks,
    )


def _times_view(times: Times) -> TimesView:
    stop_s = {kind: times.of_kind_s(kind) for kind in CauseKind}
    return view_of(TimesView, times, stop_s=stop_s, causes=tuple(map(_cause_view, times.causes)))


def _cause_view(cause: StopCause) -> CauseView:
    return view_of(CauseView, cause, text=_TEXTS.get(cause.reason, "a reason of a later version"))


def _alarms_view(figures: AlarmFigures) -> AlarmsOfDaysView:
    return view_of(
        AlarmsOfDaysView,
        figures,
        source=SOURCE,
        recorded_s=figures.recorded_h * HOUR_S,
        benchmarks=[
            view_of(BenchmarkView, one, value=one.value(figures), verdict=one.verdict(figures)) for one in BENCHMARKS
        ],
        peak=None if figures.peak_ms is None else shown(figures.peak_ms),
        frequent=[view_of(FrequentView, one, title=_title(one.kind)) for one in figures.frequent],
        stale=list(map(_standing_view, figures.stale)),
        standing=list(map(_standing_view, figures.standing)),
    )


def _standing_view(one: Standing) -> StandingView:
    title = _title(one.id.rpartition(".")[2])
    return view_of(StandingView, one, title=title, since=shown(one.since_ms), until=shown(one.until_ms))


def _title(kind: str) -> str:
    return ALARM_DEFINITIONS[kind].title if kind in ALARM_DEFINITIONS else kind


def csv_text(bay: str, found: Figures) -> str:
    """RFC 4180, comma, with a header: a row for each day; an empty cell is unknown."""
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(HEADER)
    writer.writerows(_row(bay, one, alarms) for one, alarms in zip(found.days, found.alarms.by_day, strict=True))
    return out.getvalue()


def _row(bay: str, one: DayFigures, alarms: int) -> list[Any]:
    day: LocalDay = one.day
    times, positions = one.times, one.positions
    causes = {cause.reason: cause for cause in times.causes}
    stops = [causes.get(reason, StopCause(reason, 0.0, 0)) for reason in _REASONS]
    return [
        bay, day.date, shown(day.begin_ms), shown(day.end_ms),
        *(round(getattr(times, name), 3) for name in _SECONDS),
        *(round(times.of_kind_s(kind), 3) for kind in CauseKind),
        times.sensor_faults,
        *(getattr(positions, name) for name in _COUNTS),
        *_measured(positions),
        alarms,
        *(figure for cause in stops for figure in (round(cause.seconds, 3), cause.times)),
    ]  # fmt: skip


def _measured(positions: Positions) -> Iterable[float | str]:
    for name in _MEASURED:
        found: Distribution | None = getattr(positions, name)
        for figure in _OF_EACH:
            yield "" if found is None else round(getattr(found, figure), 3)
