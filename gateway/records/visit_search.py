"""The visits of weeks that somebody looks for, for the page and the command line. IO: reads the index and pictures."""

from bisect import bisect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from gateway.alarms.records import LoggedChange
from gateway.alarms.states import AlarmState
from gateway.core.readings import PictureFault
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.records import kept_pictures
from gateway.records.alarm_rates import KINDS
from gateway.records.index_reader import IndexReader
from gateway.records.kept_pictures import KeptPicture
from gateway.records.record import NotedKind

MOST_CHANGES = 50_000  # of alarms, the newest
PICTURE_NEAR_NS = 2 * NS_PER_S  # of a visit's own moment
_ACTIVE = (AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED)
Spans = Sequence[tuple[int, int]]  # Unix ms, ascending, none overlaps another


class VisitKind(StrEnum):
    """As on the page."""

    FAULTS = "faults"
    ODD = "odd"
    MOVED = "moved"
    DUST = "dust"
    NEVER = "never"
    CORRECTED = "corrected"
    INTERRUPTED = "interrupted"


OF_KIND: dict[VisitKind, Callable[[VisitSummary], bool]] = {  # but for DUST, which alarms show
    VisitKind.FAULTS: lambda visit: bool(visit.faults),
    VisitKind.ODD: lambda visit: (
        visit.rolled
        or bool(visit.faults)
        or visit.to_position_s is None
        or visit.interrupted
        or visit.end is VisitEnd.GATEWAY_OFF
    ),
    VisitKind.MOVED: lambda visit: visit.rolled,
    VisitKind.NEVER: lambda visit: visit.to_position_s is None,
    VisitKind.CORRECTED: lambda visit: visit.corrections > 0,
    VisitKind.INTERRUPTED: lambda visit: visit.interrupted,
}


@dataclass(frozen=True, slots=True)
class VisitSearch:
    """All of `kinds` apply, one of the faults is of `reasons`, and while the truck was there one of `alarms` (rows of
    the table of alarms) was active. Empty: any."""

    kinds: tuple[VisitKind, ...] = ()
    reasons: tuple[str, ...] = ()
    alarms: tuple[str, ...] = ()

    def found(self, reader: IndexReader, bay: str, since_ms: int, until_ms: int, limit: int) -> list[VisitSummary]:
        """As IndexReader.visits. Alarms are known for as long as their segments are kept. Raises LinkError."""
        spans: list[Spans] = []
        if self.alarms or VisitKind.DUST in self.kinds:
            changes = reader.marks(bay, 0, until_ms, MOST_CHANGES, KINDS)
            if self.alarms:
                spans.append(_active(changes, lambda change, _: change.kind in self.alarms))
            if VisitKind.DUST in self.kinds:
                dusty = PictureFault.DUSTY.name.lower()
                spans.append(
                    _active(changes, lambda change, text: change.kind.startswith("picture_") and dusty in text)
                )
        kinds = [OF_KIND[kind] for kind in self.kinds if kind is not VisitKind.DUST]

        def wanted(visit: VisitSummary) -> bool:
            stopped = not self.reasons or any(reason.name.lower() in self.reasons for reason, _, _ in visit.faults)
            return stopped and all(fits(visit) for fits in kinds) and all(_meets(visit, each) for each in spans)

        return reader.visits(bay, since_ms, until_ms, limit, wanted)


def pictures_of(
    folder: Path, visits: Iterable[VisitSummary], advance: Callable[[], None] = lambda: None
) -> list[KeptPicture | None]:
    """Of each visit the kept picture nearest to the moment when it was last found in place. Raises OSError."""
    times_ns = [visit.frame_ms * NS_PER_MS if visit.frame_ms is not None else None for visit in visits]
    return kept_pictures.nearest(folder, times_ns, PICTURE_NEAR_NS, advance)


def _active(changes: Iterable[Mapping[str, object]], wanted: Callable[[LoggedChange, str], bool]) -> Spans:
    """When one of the wanted alarms was active; until the gateway's end at most."""
    active: set[str] = set()
    spans: list[tuple[int, int]] = []
    since_ms = 0
    for event in changes:
        t_ms, text, before = int(str(event["t_ms"])), str(event["detail"]), bool(active)
        if event["kind"] != NotedKind.ALARM:
            active.clear()
        elif (change := LoggedChange.of(text)) is not None:
            if change.after not in _ACTIVE:
                active.discard(change.id)
            elif wanted(change, text):
                active.add(change.id)
        if active and not before:
            since_ms = t_ms
        elif before and not active:
            spans.append((since_ms, t_ms))
    return [*spans, (since_ms, 2**62)] if active else spans


def _meets(visit: VisitSummary, spans: Spans) -> bool:
    at = bisect(spans, (visit.last_seen_ms, 2**63)) - 1
    return at >= 0 and spans[at][1] >= visit.begun_ms
