"""What a bay has done in some time, in figures: of the index's minutes and of visits. Pure.

What was not recorded is neither available nor stopped: shares are of the recorded time, and the rest is given as
unrecorded.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import msgspec

from gateway.core.state import Reason
from gateway.core.visit_progress import FAULTS
from gateway.core.visit_summary import VisitEnd, VisitSummary

MINUTE_S = 60.0


class CauseKind(StrEnum):
    """What a reason of `stop` means for the work of the bay. The names are on the wire."""

    AT_MARK = "at_mark"
    NO_MEASUREMENT = "no_measurement"
    FAULT = "fault"


_AT_MARK = frozenset({Reason.TARGET_REACHED, Reason.STOP_LATCHED, Reason.MOVED})
_KINDS: dict[str, CauseKind] = {
    reason.name.lower(): CauseKind.FAULT
    if reason in FAULTS
    else CauseKind.AT_MARK
    if reason in _AT_MARK
    else CauseKind.NO_MEASUREMENT
    for reason in Reason
    if reason is not Reason.NONE
}


@dataclass(frozen=True, slots=True)
class StopCause:
    """A reason of `stop`: how long it was that, and how often it became it."""

    reason: str
    seconds: float
    times: int

    @property
    def kind(self) -> CauseKind:
        """A reason that this version does not know, as of a recording of a later one, is a fault."""
        return _KINDS.get(self.reason, CauseKind.FAULT)


@dataclass(frozen=True, slots=True)
class Times:
    """What the outputs were, how long, in some time of which `passed_s` are over. `causes`: the longest first."""

    passed_s: float = 0.0
    recorded_s: float = 0.0
    may_move_s: float = 0.0
    in_place_s: float = 0.0
    sensor_faults: int = 0
    causes: tuple[StopCause, ...] = ()

    def of_kind_s(self, kind: CauseKind) -> float:
        """Seconds of `stop` for such reasons."""
        return sum(cause.seconds for cause in self.causes if cause.kind is kind)

    @property
    def unrecorded_s(self) -> float:
        return max(0.0, self.passed_s - self.recorded_s)

    @property
    def neither_s(self) -> float:
        """Recorded, but neither stop nor may_move was on: settling, or withheld from the PLC."""
        stopped_s = sum(cause.seconds for cause in self.causes)
        return max(0.0, self.recorded_s - stopped_s - self.may_move_s)

    @property
    def good_s(self) -> float:
        """Recorded without a fault that stopped the bay."""
        return max(0.0, self.recorded_s - self.of_kind_s(CauseKind.FAULT))

    @property
    def availability(self) -> float | None:
        """Share of the recorded time; None: nothing was recorded."""
        return self.good_s / self.recorded_s if self.recorded_s > 0 else None

    @property
    def recorded_share(self) -> float | None:
        """None: none of that time is over."""
        return min(1.0, self.recorded_s / self.passed_s) if self.passed_s > 0 else None


def times_of(minutes: Iterable[Mapping[str, Any]], passed_s: float) -> Times:
    """`minutes`: rows of the index. A minute that is there twice, because the clock was set back, counts as one."""
    rows: dict[int, list[Mapping[str, Any]]] = defaultdict(list)
    for row in minutes:
        rows[row["minute"]].append(row)
    seconds: dict[str, float] = defaultdict(float)
    stopped_s: dict[str, float] = defaultdict(float)
    stops: dict[str, int] = defaultdict(int)
    faults = 0
    for same in rows.values():
        share = min(1.0, MINUTE_S / max(sum(row["recorded_s"] for row in same), 1e-9))
        for row in same:
            for name in ("recorded_s", "may_move_s", "in_place_s"):
                seconds[name] += share * row[name]
            for reason, length_s in _counts(row["stop_s"]).items():
                stopped_s[reason] += share * length_s
            for reason, times in _counts(row["stops"]).items():
                stops[reason] += round(times)
            faults += row["faults"]
    causes = [StopCause(reason, stopped_s[reason], stops[reason]) for reason in {**stopped_s, **stops}]
    passed_s = max(passed_s, seconds["recorded_s"])  # the newest minute may be later than `now` was taken
    return Times(
        passed_s, seconds["recorded_s"], seconds["may_move_s"], seconds["in_place_s"], faults, _longest_first(causes)
    )


def together(parts: Sequence[Times]) -> Times:
    seconds: dict[str, float] = defaultdict(float)
    stops: dict[str, int] = defaultdict(int)
    for part in parts:
        for cause in part.causes:
            seconds[cause.reason] += cause.seconds
            stops[cause.reason] += cause.times
    return Times(
        sum(part.passed_s for part in parts),
        sum(part.recorded_s for part in parts),
        sum(part.may_move_s for part in parts),
        sum(part.in_place_s for part in parts),
        sum(part.sensor_faults for part in parts),
        _longest_first([StopCause(reason, seconds[reason], stops[reason]) for reason in seconds]),
    )


@dataclass(frozen=True, slots=True)
class Distribution:
    """Of measured values. p10, p90: a tenth of them is smaller, a tenth larger. `deviation`: the standard one."""

    count: int
    least: float
    p10: float
    median: float
    p90: float
    largest: float
    mean: float
    deviation: float

    @staticmethod
    def of(values: Iterable[float | None]) -> "Distribution | None":
        """None: there is no value. Those that are None are left out."""
        found = sorted(value for value in values if value is not None)
        if not found:
            return None
        mean = math.fsum(found) / len(found)
        deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in found) / len(found))
        tenths = (_quantile(found, share) for share in (0.1, 0.5, 0.9))
        p10, median, p90 = tenths
        return Distribution(len(found), found[0], p10, median, p90, found[-1], mean, deviation)


@dataclass(frozen=True, slots=True)
class Positions:
    """Of visits. Measured values are those when each truck was last in place; times leave out visits during which the
    gateway was off."""

    trucks: int
    placed: int  # were in place at least once
    moved: int  # rolled, or left their place, though they were to stand
    interrupted: int  # by a restart of the gateway
    unwatched_end: int  # the gateway was off when the truck left
    corrections: int  # in all
    corrected: int  # visits with at least one
    to_position_s: Distribution | None
    length_s: Distribution | None
    offset_mm: Distribution | None
    offset_px: Distribution | None
    radius_px: Distribution | None
    distance_mm: Distribution | None
    stop_latency_ms: Distribution | None
    overrun_mm: Distribution | None


def positions_of(visits: Iterable[VisitSummary]) -> Positions:
    """A visit that is there twice counts once: the first of them."""
    found = list({visit.begun_ms: visit for visit in reversed(list(visits))}.values())
    watched = [visit for visit in found if not visit.interrupted]
    return Positions(
        trucks=len(found),
        placed=sum(visit.times_in_place > 0 for visit in found),
        moved=sum(visit.rolled for visit in found),
        interrupted=len(found) - len(watched),
        unwatched_end=sum(visit.end is VisitEnd.GATEWAY_OFF for visit in found),
        corrections=sum(visit.corrections for visit in found),
        corrected=sum(visit.corrections > 0 for visit in found),
        to_position_s=Distribution.of(visit.to_position_s for visit in watched),
        length_s=Distribution.of(visit.length_s for visit in watched if visit.end is not VisitEnd.GATEWAY_OFF),
        offset_mm=Distribution.of(visit.offset_mm for visit in found),
        offset_px=Distribution.of(visit.offset_px for visit in found),
        radius_px=Distribution.of(visit.radius_px for visit in found),
        distance_mm=Distribution.of(visit.distance_mm for visit in found),
        stop_latency_ms=Distribution.of(visit.stop_latency_ms for visit in found),
        overrun_mm=Distribution.of(visit.overrun_mm for visit in found),
    )


def _longest_first(causes: Iterable[StopCause]) -> tuple[StopCause, ...]:
    return tuple(sorted(causes, key=lambda cause: (-cause.seconds, -cause.times, cause.reason)))


def _counts(text: str) -> dict[str, float]:
    return msgspec.json.decode(text, type=dict[str, float])


def _quantile(ordered: Sequence[float], share: float) -> float:
    """Between the two values next to it, linearly."""
    at = share * (len(ordered) - 1)
    low = math.floor(at)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (at - low) * (ordered[high] - ordered[low])
