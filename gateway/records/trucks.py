"""What other rules would have meant for each truck: in place, and where it was stopped at the mark. Pure."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from gateway.core.state import Reason
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.durations import NS_PER_MS
from gateway.records.moment import unix_ns
from gateway.records.record import VisitRecord
from gateway.records.recording import Item, MissingItem
from gateway.records.replay import Step


class ThenNow(NamedTuple):
    """Of one truck, by the recorded decisions or by the other rules. `in_place` None: not known, as records of its
    visit are missing. `stop_mm`: Z when it was first stopped at the mark; None: it was not, or that is not known."""

    in_place: bool | None = False
    stop_mm: float | None = None


@dataclass(frozen=True, slots=True)
class ComparedTruck:
    """`begun_ns`, `ended_ns`: of its visit, Unix time."""

    begun_ns: int
    ended_ns: int
    then: ThenNow
    now: ThenNow

    @property
    def earlier_mm(self) -> float | None:
        """So much farther away the other rules stop it; negative: nearer. None: it is not stopped both times."""
        if self.then.stop_mm is None or self.now.stop_mm is None:
            return None
        return self.now.stop_mm - self.then.stop_mm


@dataclass(slots=True)
class Trucks:
    """Follows the items of a replay and its steps. `found`: the trucks whose visit is over, and then the open one."""

    found: list[ComparedTruck] = field(default_factory=list)
    open: VisitSummary | None = None
    before: list[tuple[bool, bool] | None] = field(default_factory=lambda: [None, None])  # at mark, in place: then, now
    marks: list[tuple[int, int, ThenNow]] = field(default_factory=list)  # Unix ns; 0: then, 1: now
    gaps: list[tuple[int, int]] = field(default_factory=list)  # the records before and behind what is missing, Unix ns
    newest_ns: int = 0
    missing: bool = False  # since the newest record

    def visits(self, items: Iterable[Item | MissingItem], *, last: bool = True) -> Iterator[Item | MissingItem]:
        """The same items. `last`: none follow them."""
        for item in items:
            if isinstance(item, MissingItem):
                self.missing = True
            else:
                self._goes_on(unix_ns(item[0].head, item[1].t_ns))
                if isinstance(record := item[1], VisitRecord):
                    self.open = record.visit
                    if record.visit.end is not VisitEnd.OPEN:
                        self._end()
            yield item
        if last:
            self._end()

    def _goes_on(self, at_ns: int) -> None:
        if self.missing:
            self.gaps.append((self.newest_ns, at_ns))
        self.newest_ns, self.missing = at_ns, False

    def step(self, step: Step) -> None:
        at_ns, z_mm = unix_ns(step.place.head, step.state.t_ns), step.state.range.distance_mm
        began = step.observation is None
        for which, decision in enumerate((step.recorded, step.state)):
            if decision is None:
                continue
            at_mark = decision.stop and decision.reason is Reason.TARGET_REACHED
            before, self.before[which] = self.before[which], (at_mark, decision.in_place)
            stopped = at_mark and not began and before is not None and not before[0]
            if stopped or (decision.in_place and (before is None or not before[1])):
                self.marks.append((at_ns, which, ThenNow(decision.in_place, z_mm if stopped else None)))

    def _end(self) -> None:
        visit, self.open = self.open, None
        if visit is None:
            return
        begun_ns, ended_ns = visit.begun_ms * NS_PER_MS, visit.last_seen_ms * NS_PER_MS
        of = [mark for mark in self.marks if begun_ns <= mark[0] <= ended_ns]
        self.marks = [mark for mark in self.marks if mark[0] > ended_ns]
        last_ns = self.newest_ns if visit.end is VisitEnd.OPEN else ended_ns
        gap_ns = min((since for since, until in self.gaps if since <= last_ns and until >= begun_ns), default=None)
        self.gaps = [gap for gap in self.gaps if gap[1] > ended_ns]
        sure = of if gap_ns is None else [mark for mark in of if mark[0] <= gap_ns]  # the first stop may be missing
        then, now = (
            ThenNow(
                any(mark.in_place for _, by, mark in of if by == which) or (False if gap_ns is None else None),
                next((mark.stop_mm for _, by, mark in sure if by == which and mark.stop_mm is not None), None),
            )
            for which in (0, 1)
        )
        self.found.append(ComparedTruck(begun_ns, ended_ns, then, now))
