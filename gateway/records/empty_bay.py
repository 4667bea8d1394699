"""Minutes of an empty bay, which a replay by other rules passes over: nothing that is compared can differ there. Pure.

Without a circle in any frame, and with no truck in the bay at its beginning, D is not known: `stop` is on, `may_move`
off, and none is in place, whatever the thresholds; nor is anything learned. So where a replay's own state is the
recorded one at a complete state, it can begin anew at the next, a minute later. The minute before a circle is seen is
always decided step by step, so that all that depends on times is by then as the other rules make it.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain

from gateway import __version__
from gateway.core.interlock import VALID_MIN_S, Rules
from gateway.core.state import Moved, StateVector
from gateway.durations import NS_PER_S
from gateway.records.record import (
    AnyRecord,
    Checkpoint,
    ConnectionRecord,
    Decision,
    DistanceRecord,
    EventRecord,
    FrameRecord,
    RegisterImage,
    TickRecord,
    WriteRecord,
    observed,
)
from gateway.records.recording import Item, MissingItem, Place
from gateway.records.segment import Head

LONGEST_S = 30.0  # of all times that must have passed before the next truck; half a minute between complete states
HARMLESS = TickRecord | DistanceRecord | ConnectionRecord | RegisterImage | EventRecord


@dataclass(slots=True)
class RecordedMinute:
    """A complete state that follows what was before it, and all behind it; None: what is before the first one."""

    begin: tuple[Place, Checkpoint] | None
    items: list[Item | MissingItem] = field(default_factory=list)

    @property
    def steps(self) -> int:
        return sum(not isinstance(item, MissingItem) and observed(item[1]) is not None for item in self.items)

    @property
    def long(self) -> bool:
        """Do all times pass in it? A recorder that starts anew begins with a complete state, too."""
        times_ns = [item[1].t_ns for item in self.items if not isinstance(item, MissingItem)]
        return self.begin is not None and times_ns != [] and times_ns[-1] - self.begin[1].t_ns >= LONGEST_S * NS_PER_S

    def empty(self) -> bool:
        """Was the bay empty, and decided about all the time?"""
        if self.begin is None:
            return False
        place, (state, t_ns) = self.begin[0], (self.begin[1].state, self.begin[1].t_ns)
        visit, memory = state.visit, state.memory
        truck = visit.monitored or visit.released or visit.moved is not Moved.NO
        if visit.checked or memory.pairs or memory.marker_confirmed:
            return False  # they end when the bay is clear, which other rules find at another time
        if truck or memory.d or memory.latched or memory.disagree or state.vision.circle is not None or not state.stop:
            return False
        valid_until_ns = state.valid_until_ns
        for item in self.items:
            if isinstance(item, MissingItem) or item[0].head is not place.head:
                return False
            record = item[1]
            if record.t_ns > valid_until_ns or record.t_ns < t_ns or not _harmless(record, state.plc.recipe):
                return False
            t_ns = record.t_ns
            if isinstance(record, TickRecord) and record.marker is None:
                valid_until_ns = t_ns + int(VALID_MIN_S * NS_PER_S)
        return True


@dataclass(slots=True)
class EmptyBay:
    """`state`: the replay's own, now. `rules_of`, `recorded_rules_of`: of a segment; None: this version refuses them.
    `steps`: so many were passed over."""

    state: Callable[[], StateVector | None]
    rules_of: Callable[[Head], Rules]
    recorded_rules_of: Callable[[Head], Rules | None]
    steps: int = 0
    _comparable: dict[tuple[str, str], bool] = field(default_factory=dict)

    def left_out(self, items: Iterable[Item | MissingItem]) -> Iterator[Item | MissingItem]:
        """The same items; of each empty minute none but the complete state at its end, to begin anew at."""
        minutes = _minutes(items)
        minute = next(minutes)
        passes = minute.empty()
        for following in chain(minutes, (None,)):
            follows = following is not None and following.empty()
            own = self._own(minute) if passes and follows else None
            if own is not None and following is not None and following.begin is not None and following.long:
                self.steps += minute.steps
                yield from _anew(*following.begin, own)
            else:
                yield from minute.items
                if following is not None and following.begin is not None:
                    yield following.begin
            if following is not None:
                minute, passes = following, follows

    def _own(self, minute: RecordedMinute) -> StateVector | None:
        """The replay's own state, where it is the recorded one at the begin of this minute in all that may count."""
        own = self.state()
        if own is None or minute.begin is None or not self._are_comparable(minute.begin[0].head):
            return None
        recorded = minute.begin[1].state
        return own if own == _carried(_since_long(recorded, own), own) else None

    def _are_comparable(self, head: Head) -> bool:
        key = head.bay, head.config
        if key not in self._comparable:
            then, now = self.recorded_rules_of(head), self.rules_of(head)
            self._comparable[key] = then is not None and comparable(then, now)
        return self._comparable[key] and head.gateway_version == __version__


def _minutes(items: Iterable[Item | MissingItem]) -> Iterator[RecordedMinute]:
    minute = RecordedMinute(None)
    for item in items:
        if not isinstance(item, MissingItem) and isinstance(record := item[1], Checkpoint) and record.follows:
            yield minute
            minute = RecordedMinute((item[0], record))
        else:
            minute.items.append(item)
    yield minute


def _harmless(record: AnyRecord, recipe: int) -> bool:
    match record:
        case FrameRecord():
            return record.reading.circle is None and record.reading.wrong_size is None
        case WriteRecord():
            return record.write.recipe in (None, recipe)
        case Decision():
            return record.stop and not (record.may_move or record.in_place or record.moved)
        case _:
            return isinstance(record, HARMLESS)


def comparable(then: Rules, now: Rules) -> bool:
    """Do both make the same of an empty bay, but for thresholds and short times?"""
    same = (then.handshake, then.beacon_tolerance_ns, then.valid_for_ns) == (
        now.handshake,
        now.beacon_tolerance_ns,
        now.valid_for_ns,
    )
    return same and _short(then) and _short(now)


def _short(rules: Rules) -> bool:
    """Is stop on in an empty bay, and does all that passes by time pass soon?"""
    times_s, fusions = [rules.visit.leave_s], [recipe.fusion for recipe in rules.recipes.values()]
    for of in fusions:
        times_s += of.vision_deadline_s, of.range_deadline_s, of.start_grace_s, of.recovery_s, of.latch_leave_s
    return max(times_s) <= LONGEST_S and all(of.fail_safe for of in fusions)


def _since_long(recorded: StateVector, own: StateVector) -> StateVector:
    """With `own`'s times since when there is no truck, where both are older than all that counts by them."""
    before_ns = own.t_ns - LONGEST_S * NS_PER_S

    def since(then_ns: int | None, now_ns: int | None) -> int | None:
        old = then_ns is not None and now_ns is not None and max(then_ns, now_ns) <= before_ns
        return now_ns if old else then_ns

    clear_ns = since(recorded.visit.clear_since_ns, own.visit.clear_since_ns)
    absent_ns = since(recorded.memory.absent_since_ns, own.memory.absent_since_ns)
    return replace(
        recorded,
        visit=replace(recorded.visit, clear_since_ns=clear_ns),
        memory=replace(recorded.memory, absent_since_ns=absent_ns),
    )


def _carried(recorded: StateVector, own: StateVector) -> StateVector:
    """With what `own` has learned of markers, has of a drive, and says and shows of the truck that has left."""
    memory = replace(
        recorded.memory, scale_samples=own.memory.scale_samples, scale=own.memory.scale, drive=own.memory.drive
    )
    left = own.visit
    visit = replace(recorded.visit, ended=left.ended, way_out=left.way_out, unseen_since_ns=left.unseen_since_ns)
    return replace(recorded, memory=memory, visit=visit, setpoint=own.setpoint)


def _anew(place: Place, checkpoint: Checkpoint, own: StateVector) -> Iterator[Item]:
    state = _carried(checkpoint.state, own)
    yield place, Checkpoint(t_ns=checkpoint.t_ns, state=state)
    yield place, Decision.of(checkpoint.state)
