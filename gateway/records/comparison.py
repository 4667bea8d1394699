"""What another configuration, or another version, would have decided otherwise: intervals, from a replay. Pure."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter

from gateway.core.state import StateVector
from gateway.records.moment import unix_ns
from gateway.records.record import Decision
from gateway.records.replay import Step
from gateway.records.segment import Head

# What a PLC acts on, of a decision, and where it stands in the state; other reasons and phases are shown beside.
JUDGED = {"stop": "stop", "may_move": "may_move", "in_place": "in_place", "moved": "visit.moved"}


@dataclass(frozen=True, slots=True)
class Otherwise:
    """One uninterrupted time in which the outputs would have been other, all the time in the same way.

    Times: Unix ns. `was`, `now`: the decisions at its beginning. `state`: as recomputed then.
    """

    bay: str
    begin_ns: int
    end_ns: int
    was: Decision
    now: Decision
    state: StateVector

    @property
    def seconds(self) -> float:
        return (self.end_ns - self.begin_ns) / 1e9

    @property
    def what(self) -> str:
        """`may_move 1 -> 0, stop 0 -> 1`."""
        pairs = ((name, int(getattr(self.was, name)), int(getattr(self.now, name))) for name in JUDGED)
        return ", ".join(f"{name} {was} -> {now}" for name, was, now in pairs if was != now)


def otherwise(steps: Iterable[Step]) -> Iterator[Otherwise]:
    """The intervals in which the outputs of the steps differ from what was recorded."""
    open_: tuple[Head, Step, Decision, Decision] | None = None
    newest: Step | None = None
    for step in steps:
        if open_ is not None and newest is not None and step.observation is None:
            yield _interval(*open_, newest)  # what was between is not known
            open_ = None
        newest = step
        was, other = step.recorded, differs(step)
        if open_ is None and not other:
            continue
        now = Decision.of(step.state)
        if open_ is not None:
            head, first, old, new = open_
            same = other and was is not None and (_judged(was), _judged(now)) == (_judged(old), _judged(new))
            if same and step.place.head.boot == head.boot:
                continue
            yield _interval(head, first, old, new, step)
            open_ = None
        if other and was is not None:
            open_ = step.place.head, step, was, now
    if open_ is not None and newest is not None:
        yield _interval(*open_, newest)


def differs(step: Step) -> bool:
    """Are its outputs other than recorded?"""
    return step.recorded is not None and _judged(step.recorded) != _judged_of_state(step.state)


def _interval(head: Head, first: Step, was: Decision, now: Decision, after: Step) -> Otherwise:
    begin_ns, end_ns = unix_ns(head, first.state.t_ns), unix_ns(after.place.head, after.state.t_ns)
    return Otherwise(head.bay, begin_ns, max(begin_ns, end_ns), was, now, first.state)


_judged: Callable[[Decision], tuple[object, ...]] = attrgetter(*JUDGED)
_judged_of_state: Callable[[StateVector], tuple[object, ...]] = attrgetter(*JUDGED.values())  # without a Decision
