"""All alarms of a gateway: fed with states and signs, asked by people, never asking anybody. Pure.

Nothing here touches `stop` or `may_move`, or could: it sees states and changes none. What a person does to an alarm
changes what people are told, and nothing else.
"""

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Generic

from gateway.alarms.records import DEEDS, MAX_NOTE, SHELVE_MOST_MIN, Alarm, Change, Deed, Outcome, Reply, Standing
from gateway.alarms.states import AlarmState, Cue, following
from gateway.alarms.table import BAY_ALARMS, GATEWAY_ALARMS, KINDS, BaySeen, GatewaySeen, Kind, Seen, Signs, alarm_id
from gateway.config import FusionConfig
from gateway.core.model import StateVector

NS_PER_S = 1_000_000_000
HISTORY = 1000  # changes kept, of all alarms
MAX_DETAIL = 120
# What an operator must look at first.
_RANK = {
    AlarmState.UNACKNOWLEDGED: 0,
    AlarmState.LATCHED_UNACKNOWLEDGED: 1,
    AlarmState.RETURNED: 2,
    AlarmState.ACKNOWLEDGED: 3,
    AlarmState.LATCHED_ACKNOWLEDGED: 4,
    AlarmState.SHELVED: 5,
    AlarmState.OUT_OF_SERVICE: 6,
    AlarmState.SUPPRESSED: 7,
}


class AlarmBoard:
    """`bays`: name -> its thresholds. Call `look_at_bay` and `look_at_gateway` about once a second and when something
    happened; each gives what changed. Times never step back.
    """

    def __init__(self, bays: Mapping[str, FusionConfig]) -> None:
        self._thresholds = dict(bays)
        self._bays: dict[str, list[_Slot[BaySeen]]] = {
            bay: [_Slot(kind, bay) for kind in BAY_ALARMS] for bay in self._thresholds
        }
        self._gateway: list[_Slot[GatewaySeen]] = [_Slot(kind, None) for kind in GATEWAY_ALARMS]
        self._by_id: dict[str, _Slot[BaySeen] | _Slot[GatewaySeen]] = {
            slot.alarm.id: slot for slots in self._bays.values() for slot in slots
        }
        self._by_id |= {slot.alarm.id: slot for slot in self._gateway}
        self._signs = Signs()
        self._history: deque[Change] = deque(maxlen=HISTORY)
        self._told = 0

    def look_at_bay(self, state: StateVector, now_ns: int) -> list[Change]:
        """`state` as a PLC would be shown it now, a dead control task included. KeyError: no such bay."""
        fusion = self._thresholds[state.bay]
        seen = BaySeen(state, fusion.radius_threshold_px, fusion.distance_threshold_mm)
        return self._look(self._bays[state.bay], seen, now_ns)

    def look_at_gateway(self, signs: Signs, now_ns: int) -> list[Change]:
        seen = GatewaySeen(signs, self._signs)
        self._signs = signs
        return self._look(self._gateway, seen, now_ns)

    def _look(self, slots: "Iterable[_Slot[Seen]]", seen: Seen, now_ns: int) -> list[Change]:
        designs = seen.designs
        changes: list[Change] = []
        for slot in slots:
            changes += [self._note(change) for change in slot.look(seen, bool(designs & slot.kind.suppressed), now_ns)]
        return changes

    def act(self, deed: Deed, now_ns: int) -> tuple[Reply, list[Change]]:
        """Do what a person asks for, and give what changed; or say why not, and change nothing."""
        slot = self._by_id.get(deed.id)
        if slot is None:
            return Reply(Outcome.UNKNOWN, f"there is no alarm {deed.id[:100]!r}"), []
        if wrong := _wrong(deed):
            return Reply(Outcome.WRONG, wrong), []
        alarm = slot.alarm
        if deed.occurrence is not None and deed.occurrence != alarm.occurrences:
            return Reply(Outcome.REFUSED, f"{deed.id} has occurred again since: look at it first"), []
        change = slot.act(deed, now_ns)
        if change is None:
            return Reply(Outcome.REFUSED, f"{deed.cue.value}: not possible, {deed.id} is {alarm.state.value}"), []
        return Reply(), [self._note(change)]

    def alarm(self, name: str) -> Alarm | None:
        slot = self._by_id.get(name)
        return None if slot is None else slot.alarm

    def standing(self, most: int = 200) -> Standing:
        """What stands, the most important first, at most so many."""
        alarms = [slot.alarm for slot in self._by_id.values()]
        counts = Counter(alarm.state for alarm in alarms)
        announced: Counter[str] = Counter()
        for alarm in alarms:
            announced[alarm.kind] += alarm.occurrences
        shown = sorted((alarm for alarm in alarms if alarm.state is not AlarmState.NORMAL), key=_importance)
        return Standing(
            tuple(shown[:most]),
            max(0, len(shown) - most),
            tuple((state, counts[state]) for state in AlarmState),
            tuple((kind, count) for kind, count in announced.items() if count),
            self._told,
        )

    def history(self, after: int = 0, most: int = HISTORY) -> tuple[Change, ...]:
        """Changes numbered above `after`, the oldest first; a gap in the numbers: older ones are not kept any more."""
        return tuple(change for change in self._history if change.number > after)[:most]

    def _note(self, change: Change) -> Change:
        self._told += 1
        numbered = replace(change, number=self._told)
        self._history.append(numbered)
        return numbered


class _Slot(Generic[Seen]):
    """One alarm and its delays."""

    __slots__ = ("_pending_ns", "alarm", "kind")

    def __init__(self, kind: Kind[Seen], bay: str | None) -> None:
        self.kind: Kind[Seen] = kind
        self.alarm = Alarm(alarm_id(kind.id, bay), kind.id, bay)
        self._pending_ns: int | None = None  # since when the cause is other than `alarm.active`

    def look(self, seen: Seen, suppressed: bool, now_ns: int) -> list[Change]:
        changes: list[Change] = []
        if suppressed:
            # After it the on-delay begins anew: what was hidden by design settles before it is judged.
            self._pending_ns = None
            if self.alarm.active:
                self.alarm = replace(self.alarm, active=False)
        if self.alarm.state is AlarmState.SHELVED and now_ns >= (self.alarm.shelved_until_ns or 0):
            changes += self._cue(Cue.UNSHELVE, now_ns)
        if suppressed:
            return changes + self._cue(Cue.SUPPRESS, now_ns)
        if self.alarm.state is AlarmState.SUPPRESSED:
            changes += self._cue(Cue.UNSUPPRESS, now_ns)
        return changes + self._judge(seen, now_ns)

    def _judge(self, seen: Seen, now_ns: int) -> list[Change]:
        """Does the cause hold, delays counted?"""
        kind = self.kind
        holds = kind.holds(seen)
        if holds == self.alarm.active:
            self._pending_ns = None
            return []
        if self._pending_ns is None:
            self._pending_ns = now_ns
        if now_ns - self._pending_ns < (kind.on_delay_s if holds else kind.off_delay_s) * NS_PER_S:
            return []
        self._pending_ns = None
        detail = kind.detail(seen)[:MAX_DETAIL] if holds else self.alarm.detail
        self.alarm = replace(self.alarm, active=holds, detail=detail)
        return self._cue(Cue.OCCURS if holds else Cue.RETURNS, now_ns)

    def act(self, deed: Deed, now_ns: int) -> Change | None:
        changes = self._cue(deed.cue, now_ns, deed)
        return changes[0] if changes else None

    def _cue(self, cue: Cue, now_ns: int, deed: Deed | None = None) -> list[Change]:
        """Follow the arrow, if there is one."""
        alarm = self.alarm
        after = following(alarm.state, cue, latching=self.kind.latching, active=alarm.active)
        if after is None:
            return []
        raised = after is AlarmState.UNACKNOWLEDGED
        who, note = (deed.who, deed.note) if deed else ("", "")
        minutes = deed.minutes if deed and after is AlarmState.SHELVED else None
        self.alarm = replace(
            alarm,
            state=after,
            since_ns=now_ns,
            raised_ns=now_ns if raised else alarm.raised_ns,
            occurrences=alarm.occurrences + raised,
            who=who if deed or raised else alarm.who,
            note=note if deed or raised else alarm.note,
            shelved_until_ns=None if minutes is None else now_ns + round(minutes * 60 * NS_PER_S),
        )
        return [Change(0, now_ns, alarm.id, alarm.kind, alarm.bay, cue, alarm.state, after, alarm.detail, who, note)]


def _wrong(deed: Deed) -> str:
    if deed.cue not in DEEDS:
        return f"{deed.cue.value}: not for people; what they may do: {', '.join(cue.value for cue in DEEDS)}"
    if len(deed.note) > MAX_NOTE:
        return f"note: {len(deed.note)} characters; at most {MAX_NOTE}"
    if deed.cue is Cue.SHELVE and (deed.minutes is None or not 1 <= deed.minutes <= SHELVE_MOST_MIN):
        return f"minutes = {deed.minutes}: shelving takes 1 to {SHELVE_MOST_MIN} minutes"
    return ""


def _importance(alarm: Alarm) -> tuple[int, int, int]:
    """Sorts the most important first: what nobody has looked at, then by priority, then the newest."""
    return _RANK[alarm.state], -KINDS[alarm.kind].priority, -(alarm.raised_ns or 0)
