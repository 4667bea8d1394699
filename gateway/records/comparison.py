"""What another configuration, or another version, would have decided otherwise: intervals, from a replay. Pure."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from operator import attrgetter

from gateway.core.state import StateVector
from gateway.records.moment import unix_ns
from gateway.records.record import Decision
from gateway.records.replay import Step

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


@dataclass(slots=True)
class Intervals:
    """Follows the steps of a replay. `found`: the times in which the outputs differ from what was recorded, and then
    the `open` one, as far as it goes until now. `boot`, `newest_ns`: of the newest step."""

    found: list[Otherwise] = field(default_factory=list)
    open: Otherwise | None = None
    boot: str = ""
    newest_ns: int = 0

    def step(self, step: Step) -> None:
        head = step.place.head
        if step.observation is None:
            self.end()  # what was between is not known
        same_boot, self.boot, self.newest_ns = self.boot == head.boot, head.boot, unix_ns(head, step.state.t_ns)
        was, other = step.recorded, differs(step)
        if self.open is None and not other:
            return
        now = Decision.of(step.state)
        if self.open is not None:
            before = _judged(self.open.was), _judged(self.open.now)
            if other and was is not None and (_judged(was), _judged(now)) == before and same_boot:
                return
            self.end()
        if other and was is not None:
            self.open = Otherwise(head.bay, self.newest_ns, self.newest_ns, was, now, step.state)

    def end(self) -> None:
        if self.open is not None:
            self.found.append(replace(self.open, end_ns=max(self.open.begin_ns, self.newest_ns)))
        self.open = None


def differs(step: Step) -> bool:
    """Are its outputs other than recorded?"""
    return step.recorded is not None and _judged(step.recorded) != _judged_of_state(step.state)


_judged: Callable[[Decision], tuple[object, ...]] = attrgetter(*JUDGED)
_judged_of_state: Callable[[StateVector], tuple[object, ...]] = attrgetter(*JUDGED.values())  # without a Decision
