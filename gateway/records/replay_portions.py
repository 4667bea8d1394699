"""A replay in portions, one for each segment, so that several processes can share it. Pure.

Other rules go on with a state of their own, across segments: what counts for the next segment is carried to it. So what
is found in a segment depends on the rules, its bytes and that alone.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import msgspec

from gateway.config import BayConfig, GatewayConfig
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.state import StateVector
from gateway.errors import ConfigError
from gateway.modbus.registers.register import WordOrder
from gateway.processes.codec import Message
from gateway.records import recording
from gateway.records.comparison import Intervals, Otherwise
from gateway.records.empty_bay import EmptyBay
from gateway.records.moment import unix_ns
from gateway.records.record import Decision
from gateway.records.recorded_rules import RecordedRules
from gateway.records.recording import Continuity, Item, MissingItem
from gateway.records.replay import Difference, Replay, Step
from gateway.records.segment import Head
from gateway.records.trucks import ComparedTruck, Trucks

MOST_SHOWN = 20
Row = dict[str, str]
Cells = dict[str, str | bool | float | None]
FoundDifference = tuple[int, str, tuple[tuple[str, str, str], ...]]  # Unix ns, place, what: was, now


class ReplayRules(Message, frozen=True):
    """`against`: other rules, as `recorder_service.decides` has them; None: the recorded ones. `bay`: of these; None:
    that of a segment's head. Times: Unix ns. `complete`: minutes of an empty bay, too."""

    against: str | None
    bay: str | None
    begin_ns: int = 0
    end_ns: int = 2**63 - 1
    complete: bool = False


class Carried(Message, frozen=True):
    """All of the segments before one that counts for it; by default: none was before it. `silent`: the state was shown
    withdrawn."""

    state: StateVector | None = None
    silent: bool = False
    recorded: Decision | None = None
    continuity: Continuity = msgspec.field(default_factory=Continuity)
    intervals: Intervals = msgspec.field(default_factory=Intervals)
    trucks: Trucks = msgspec.field(default_factory=Trucks)


class Portion(Message, frozen=True, kw_only=True):
    """What was found in one segment, or in several. Times: Unix ns. `first_ns` None: no step was taken. `empty`: steps
    of an empty bay, not taken. `intervals`: begin, end, and what of it a table shows."""

    steps: int = 0
    empty: int = 0
    first_ns: int | None = None
    last_ns: int = 0
    images: int = 0
    missing: tuple[str, ...] = ()
    differing: int = 0
    differences: tuple[FoundDifference, ...] = ()
    intervals: tuple[tuple[int, int, Row], ...] = ()
    trucks: tuple[tuple[int, Cells], ...] = ()  # by begin of their visits

    def joined(self, more: "Portion") -> "Portion":
        return Portion(
            steps=self.steps + more.steps,
            empty=self.empty + more.empty,
            first_ns=more.first_ns if self.first_ns is None else self.first_ns,
            last_ns=more.last_ns or self.last_ns,
            images=self.images + more.images,
            missing=self.missing + more.missing,
            differing=self.differing + more.differing,
            differences=(self.differences + more.differences)[:MOST_SHOWN],
            intervals=self.intervals + more.intervals,
            trucks=self.trucks + more.trucks,
        )


def replayed(
    rules: ReplayRules, path: Path, data: bytes, before: Carried, *, last: bool = False
) -> tuple[Portion, Carried]:
    """One segment of these bytes. `before` is used up. `last`: none follows it. Raises ConfigError."""
    recorded = RecordedRules()
    against = None if rules.against is None else _settings(rules.against)
    replay = Replay(recorded) if against is None else Replay(_rules_in(against, rules.bay), exact=False)
    now = replay.now
    now.state, now.recorded = before.state, before.recorded
    now.silent = now.state if before.silent else None
    empty = EmptyBay(lambda: now.state, lambda head: replay.rules_of(head)[0], recorded.known)
    seen = _Seen(rules, replay, before.trucks, before.intervals)
    items = recording.records([path], lambda _: data, before.continuity)
    if against is None:
        items = recorded.readable(items)
    else:
        items = items if rules.complete else empty.left_out(items)
        items = seen.trucks.visits(items, last=last)
    seen.follow(items)
    if last:
        seen.intervals.end()
    portion = seen.portion(empty.steps)
    for found in (seen.trucks.found, seen.intervals.found):
        found.clear()
    silent = now.silent is not None and now.silent is now.state
    return portion, Carried(now.state, silent, now.recorded, before.continuity, seen.intervals, seen.trucks)


@dataclass(slots=True)
class _Seen:
    """What a replay has shown of one segment."""

    rules: ReplayRules
    replay: Replay
    trucks: Trucks
    intervals: Intervals
    _steps: int = 0
    _first_ns: int | None = None
    _last_ns: int = 0
    _differing: int = 0
    _differences: list[Difference] = field(default_factory=list)

    def follow(self, items: Iterable[Item | MissingItem]) -> None:
        """Counted is what is within the times that were asked for."""
        for found in self.replay.run(items):
            t_ns = found.state.t_ns if isinstance(found, Step) else found.t_ns
            at_ns = unix_ns(found.place.head, t_ns)
            if isinstance(found, Step) and not self.replay.exact:  # else nobody asks
                self.trucks.step(found)
            if not self.rules.begin_ns <= at_ns <= self.rules.end_ns:
                continue
            if isinstance(found, Step):
                self._steps += isinstance(found.observation, Observation)
                self._last_ns = at_ns
                self._first_ns = at_ns if self._first_ns is None else self._first_ns
                self.intervals.step(found)
            else:
                self._differing += 1
                if len(self._differences) < MOST_SHOWN:
                    self._differences.append(found)

    def portion(self, empty: int) -> Portion:
        trucks = [truck for truck in self.trucks.found if self._overlaps(truck)]
        return Portion(
            steps=self._steps,
            empty=empty,
            first_ns=self._first_ns,
            last_ns=self._last_ns,
            images=self.replay.images,
            missing=tuple(self.replay.missing),
            differing=self._differing,
            differences=tuple(map(_difference, self._differences)),
            intervals=tuple((found.begin_ns, found.end_ns, _row(found)) for found in self.intervals.found),
            trucks=tuple((truck.begun_ns, _truck(truck)) for truck in trucks),
        )

    def _overlaps(self, truck: ComparedTruck) -> bool:
        return truck.begun_ns <= self.rules.end_ns and truck.ended_ns >= self.rules.begin_ns


def _row(interval: Otherwise) -> Row:
    circle, distance_mm = interval.state.vision.circle, interval.state.range.distance_mm
    return {
        "seconds": f"{interval.seconds:.2f} s",
        "outputs": interval.what,
        "reason_then": interval.was.reason.name.lower(),
        "reason_now": interval.now.reason.name.lower(),
        "radius_px": "-" if circle is None else f"{circle.radius_px:.1f}",
        "distance_mm": "-" if distance_mm is None else f"{distance_mm:.0f}",
    }


def _difference(found: Difference) -> FoundDifference:
    what = tuple((name, str(was), str(now)) for name, (was, now) in found.what.items())
    return unix_ns(found.place.head, found.t_ns), str(found.place), what


def _truck(truck: ComparedTruck) -> Cells:
    return {
        "in_place_then": truck.then.in_place,
        "in_place_now": truck.now.in_place,
        "stop_then_mm": _rounded(truck.then.stop_mm),
        "stop_now_mm": _rounded(truck.now.stop_mm),
        "earlier_mm": _rounded(truck.earlier_mm),
    }


def _rounded(mm: float | None) -> float | None:
    return None if mm is None else round(mm, 1)


@lru_cache(1)
def _settings(text: str) -> GatewayConfig:
    return GatewayConfig.model_validate_json(text)


def _rules_in(settings: GatewayConfig, bay: str | None) -> Callable[[Head], tuple[Rules, WordOrder]]:
    """Those of `bay`, or of the bay that a segment's head names; without its drive, which follows from what is
    compared, and whose memory would never be as recorded."""

    def rules(head: Head) -> tuple[Rules, WordOrder]:
        found = Rules.of(_bay(settings, bay or head.bay), settings)
        recipes = {number: replace(recipe, drive=None) for number, recipe in found.recipes.items()}
        return replace(found, recipes=recipes), settings.modbus.word_order

    return rules


def _bay(settings: GatewayConfig, name: str) -> BayConfig:
    names = {bay.name: bay for bay in settings.bays}
    if name not in names:
        raise ConfigError(f"no bay {name!r} in the configuration; there: {', '.join(names)}. Use --bay NAME")
    return names[name]
