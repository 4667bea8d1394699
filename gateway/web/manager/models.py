"""The models of a bay's statistics as JSON, for the page and programs. Pure. Times of day are local ones with their
offset from UTC, ISO 8601."""

from datetime import date
from typing import Annotated

from pydantic import BeforeValidator, Field

from gateway.records.alarm_rates import SOURCE, AlarmRateVerdict
from gateway.records.statistics import CauseKind
from gateway.sinks.mqtt.values import Count
from gateway.web.server.models import View


def _seconds(value: float) -> float:
    return round(value, 3)


def _share(value: float | None) -> float | None:
    return None if value is None else round(value, 6)


Seconds = Annotated[float, BeforeValidator(_seconds)]
Share = Annotated[float | None, BeforeValidator(_share)]


class CauseView(View):
    """A reason of `stop`."""

    reason: str = Field(description="by name, as in the state")
    text: str = Field(description="for people")
    kind: CauseKind
    seconds: Seconds = Field(description="in all")
    times: Count = Field(description="how often it became the reason of stop; on for longer than the days: 0")


class TimesView(View):
    """What the outputs were, how long. `stop`, `may_move` and `neither_s` together are `recorded_s`."""

    passed_s: Seconds = Field(description="of these days, until now")
    recorded_s: Seconds
    unrecorded_s: Seconds = Field(description="neither available nor stopped: not known")
    good_s: Seconds = Field(description="recorded, without a fault that stopped the bay")
    availability: Share = Field(description="good_s / recorded_s; null: nothing was recorded")
    recorded_share: Share = Field(description="recorded_s / passed_s; null: none of that time is over")
    may_move_s: Seconds
    in_place_s: Seconds
    neither_s: Seconds = Field(description="neither stop nor may_move")
    stop_s: dict[CauseKind, Seconds] = Field(description="seconds of stop by what its reason means")
    sensor_faults: Count = Field(description="events sensor_fault")
    causes: tuple[CauseView, ...] = Field(description="reasons of stop, the longest first")


class DistributionView(View):
    """Of measured values, in the unit of the field that holds it."""

    count: Count
    least: float = Field(description="of all values")
    p10: float = Field(description="a tenth of the values is smaller")
    median: float = Field(description="half of the values are smaller")
    p90: float = Field(description="a tenth of the values is larger")
    largest: float = Field(description="of all values")
    mean: float = Field(description="of all values")
    deviation: float = Field(description="standard deviation")


class PositionsView(View):
    """Of the trucks that arrived then and whose visit is over. Measured values are those when each was last in
    place."""

    trucks: Count
    placed: Count = Field(description="were in place at least once")
    moved: Count = Field(description="rolled, or left their place, though they were to stand")
    interrupted: Count = Field(description="by a restart of the gateway; their times are left out")
    unwatched_end: Count = Field(description="the gateway was off when the truck left")
    corrections: Count = Field(description="reversals before a truck was last in place, of all trucks")
    corrected: Count = Field(description="trucks with at least one")
    to_position_s: DistributionView | None = Field(description="from arrival until first in place; null: no truck")
    length_s: DistributionView | None
    offset_mm: DistributionView | None = Field(description="marker minus aim point, to the right; null: no aim point")
    offset_px: DistributionView | None
    radius_px: DistributionView | None
    distance_mm: DistributionView | None
    stop_latency_ms: DistributionView | None
    overrun_mm: DistributionView | None


class DayView(View):
    """A local day, from midnight to midnight."""

    date: date
    begin: str
    end: str
    times: TimesView
    positions: PositionsView
    alarms: Count = Field(description="announced on that day")


class BenchmarkView(View):
    """A figure beside that of the standard, which is for one operator position."""

    figure: str
    title: str
    value: float | None = Field(description="a share where the limits are shares; null: nothing was recorded")
    acceptable: float = Field(description="very likely acceptable up to this")
    most: float = Field(description="maximum that can be managed")
    below: bool = Field(description="the limit itself is too many")
    verdict: AlarmRateVerdict | None = Field(description="null: less than an hour is recorded")


class FrequentView(View):
    id: str
    title: str
    times: Count
    share: float = Field(description="of all announcements")


class StandingView(View):
    id: str
    title: str
    since: str
    until: str
    over: bool = Field(description="false: active as far as is recorded")


class AlarmsOfDaysView(View):
    """Alarms of the bay and of the gateway itself, announced in these days."""

    source: str = SOURCE
    announced: Count
    recorded_s: Seconds = Field(description="what the rates are of")
    by_priority: dict[str, Count]
    benchmarks: tuple[BenchmarkView, ...]
    peak: str | None = Field(description="begin of the 10 min with the most; null: there was no alarm")
    floods: Count
    frequent: tuple[FrequentView, ...] = Field(description="the ten most frequent")
    frequent_share: float | None = Field(description="of those in all announcements")
    chattering: tuple[str, ...] = Field(description="ids of those announced three times within a minute")
    stale: tuple[StandingView, ...] = Field(description="active for more than 24 h")
    standing: tuple[StandingView, ...] = Field(description="active at the end")


class StatisticsView(View):
    """What a bay did on some days of the plant's calendar."""

    site: str
    instance: str
    bay: str
    time_zone: str = Field(description="of the gateway's machine: days and times of day are of this one")
    first: date
    last: date
    made: str = Field(description="when; the newest day may not be over")
    recorded_from: str | None = Field(description="the first minute that there is of this bay; null: none yet")
    recorded_to: str | None = Field(description="the end of the newest")
    aim: bool = Field(description="is an aim point configured? Without one there is no offset")
    days: tuple[DayView, ...]
    times: TimesView
    positions: PositionsView
    alarms: AlarmsOfDaysView
    remarks: tuple[str, ...] = Field(description="why something may be missing, for people")
