"""All alarms of a gateway: fed with states and conditions, asked by people, never asking anybody. Pure.

Nothing here touches `stop` or `may_move`, or could: it sees states and changes none. What a person does to an alarm
changes what people are told, and nothing else.
"""

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Generic

from gateway.alarms.records import (
    MAX_NOTE,
    MAX_SHELVE_MIN,
    OPERATOR_EVENTS,
    ActionOutcome,
    ActionReply,
    Alarm,
    AlarmChange,
    AlarmSummary,
    OperatorAction,
)
from gateway.alarms.states import AlarmEvent, AlarmState, next_state
from gateway.alarms.table import (
    ALARM_DEFINITIONS,
    BAY_ALARMS,
    GATEWAY_ALARMS,
    AlarmDefinition,
    BayInputs,
    GatewayConditions,
    GatewayInputs,
    Inputs,
    alarm_id,
)
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


class AlarmEngine:
    """`bays`: name -> its thresholds. Call `update_bay` and `update_gateway` about once a second and when something
    happened; each gives what changed. Times never step back.
    """

    def __init__(self, bays: Mapping[str, FusionConfig]) -> None:
        self._thresholds = dict(bays)
        self._bays: dict[str, list[_AlarmInstance[BayInputs]]] = {
            bay: [_AlarmInstance(kind, bay) for kind in BAY_ALARMS] for bay in self._thresholds
        }
        self._gateway: list[_AlarmInstance[GatewayInputs]] = [_AlarmInstance(kind, None) for kind in GATEWAY_ALARMS]
        self._by_id: dict[str, _AlarmInstance[BayInputs] | _AlarmInstance[GatewayInputs]] = {
            instance.alarm.id: instance for instances in self._bays.values() for instance in instances
        }
        self._by_id |= {instance.alarm.id: instance for instance in self._gateway}
        self._conditions = GatewayConditions()
        self._history: deque[AlarmChange] = deque(maxlen=HISTORY)
        self._changes_count = 0

    def update_bay(self, state: StateVector, now_ns: int) -> list[AlarmChange]:
        """`state` as a PLC would be shown it now, a dead control task included. KeyError: no such bay."""
        fusion = self._thresholds[state.bay]
        seen = BayInputs(state, fusion.radius_threshold_px, fusion.distance_threshold_mm)
        return self._update(self._bays[state.bay], seen, now_ns)

    def update_gateway(self, conditions: GatewayConditions, now_ns: int) -> list[AlarmChange]:
        seen = GatewayInputs(conditions, self._conditions)
        self._conditions = conditions
        return self._update(self._gateway, seen, now_ns)

    def _update(self, instances: "Iterable[_AlarmInstance[Inputs]]", seen: Inputs, now_ns: int) -> list[AlarmChange]:
        suppressions = seen.suppressions
        changes: list[AlarmChange] = []
        for instance in instances:
            changes += [
                self._note(change)
                for change in instance.update(seen, bool(suppressions & instance.kind.suppressed_by), now_ns)
            ]
        return changes

    def act(self, action: OperatorAction, now_ns: int) -> tuple[ActionReply, list[AlarmChange]]:
        """Do what a person asks for, and give what changed; or say why not, and change nothing."""
        instance = self._by_id.get(action.id)
        if instance is None:
            return ActionReply(ActionOutcome.UNKNOWN, f"there is no alarm {action.id[:100]!r}"), []
        if invalid := _invalid(action):
            return ActionReply(ActionOutcome.INVALID, invalid), []
        alarm = instance.alarm
        if action.occurrence is not None and action.occurrence != alarm.occurrences:
            return ActionReply(ActionOutcome.REFUSED, f"{action.id} has occurred again since: look at it first"), []
        change = instance.act(action, now_ns)
        if change is None:
            return ActionReply(
                ActionOutcome.REFUSED, f"{action.event.value}: not possible, {action.id} is {alarm.state.value}"
            ), []
        return ActionReply(), [self._note(change)]

    def alarm(self, name: str) -> Alarm | None:
        instance = self._by_id.get(name)
        return None if instance is None else instance.alarm

    def summary(self, most: int = 200) -> AlarmSummary:
        """What stands, the most important first, at most so many."""
        alarms = [instance.alarm for instance in self._by_id.values()]
        counts = Counter(alarm.state for alarm in alarms)
        announced: Counter[str] = Counter()
        for alarm in alarms:
            announced[alarm.kind] += alarm.occurrences
        shown = sorted((alarm for alarm in alarms if alarm.state is not AlarmState.NORMAL), key=_display_order)
        return AlarmSummary(
            tuple(shown[:most]),
            max(0, len(shown) - most),
            tuple((state, counts[state]) for state in AlarmState),
            tuple((kind, count) for kind, count in announced.items() if count),
            self._changes_count,
        )

    def history(self, after: int = 0, most: int = HISTORY) -> tuple[AlarmChange, ...]:
        """Changes numbered above `after`, the oldest first; a gap in the numbers: older ones are not kept any more."""
        return tuple(change for change in self._history if change.number > after)[:most]

    def _note(self, change: AlarmChange) -> AlarmChange:
        self._changes_count += 1
        numbered = replace(change, number=self._changes_count)
        self._history.append(numbered)
        return numbered


class _AlarmInstance(Generic[Inputs]):
    """One alarm and its delays."""

    __slots__ = ("_pending_ns", "alarm", "kind")

    def __init__(self, kind: AlarmDefinition[Inputs], bay: str | None) -> None:
        self.kind: AlarmDefinition[Inputs] = kind
        self.alarm = Alarm(alarm_id(kind.id, bay), kind.id, bay)
        self._pending_ns: int | None = None  # since when the cause is other than `alarm.active`

    def update(self, seen: Inputs, suppressed: bool, now_ns: int) -> list[AlarmChange]:
        changes: list[AlarmChange] = []
        if suppressed:
            # After it the on-delay begins anew: what was hidden by design settles before it is judged.
            self._pending_ns = None
            if self.alarm.active:
                self.alarm = replace(self.alarm, active=False)
        if self.alarm.state is AlarmState.SHELVED and now_ns >= (self.alarm.shelved_until_ns or 0):
            changes += self._transition(AlarmEvent.UNSHELVE, now_ns)
        if suppressed:
            return changes + self._transition(AlarmEvent.SUPPRESS, now_ns)
        if self.alarm.state is AlarmState.SUPPRESSED:
            changes += self._transition(AlarmEvent.UNSUPPRESS, now_ns)
        return changes + self._evaluate(seen, now_ns)

    def _evaluate(self, seen: Inputs, now_ns: int) -> list[AlarmChange]:
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
        return self._transition(AlarmEvent.OCCURS if holds else AlarmEvent.RETURNS, now_ns)

    def act(self, action: OperatorAction, now_ns: int) -> AlarmChange | None:
        changes = self._transition(action.event, now_ns, action)
        return changes[0] if changes else None

    def _transition(self, event: AlarmEvent, now_ns: int, action: OperatorAction | None = None) -> list[AlarmChange]:
        """Follow the arrow, if there is one."""
        alarm = self.alarm
        after = next_state(alarm.state, event, latching=self.kind.latching, active=alarm.active)
        if after is None:
            return []
        raised = after is AlarmState.UNACKNOWLEDGED
        who, note = (action.who, action.note) if action else ("", "")
        minutes = action.minutes if action and after is AlarmState.SHELVED else None
        self.alarm = replace(
            alarm,
            state=after,
            since_ns=now_ns,
            raised_ns=now_ns if raised else alarm.raised_ns,
            occurrences=alarm.occurrences + raised,
            who=who if action or raised else alarm.who,
            note=note if action or raised else alarm.note,
            shelved_until_ns=None if minutes is None else now_ns + round(minutes * 60 * NS_PER_S),
        )
        return [
            AlarmChange(0, now_ns, alarm.id, alarm.kind, alarm.bay, event, alarm.state, after, alarm.detail, who, note)
        ]


def _invalid(action: OperatorAction) -> str:
    if action.event not in OPERATOR_EVENTS:
        allowed = ", ".join(event.value for event in OPERATOR_EVENTS)
        return f"{action.event.value}: not for people; what they may do: {allowed}"
    if len(action.note) > MAX_NOTE:
        return f"note: {len(action.note)} characters; at most {MAX_NOTE}"
    if action.event is AlarmEvent.SHELVE and (action.minutes is None or not 1 <= action.minutes <= MAX_SHELVE_MIN):
        return f"minutes = {action.minutes}: shelving takes 1 to {MAX_SHELVE_MIN} minutes"
    return ""


def _display_order(alarm: Alarm) -> tuple[int, int, int]:
    """Sorts the most important first: what nobody has looked at, then by priority, then the newest."""
    return _RANK[alarm.state], -ALARM_DEFINITIONS[alarm.kind].priority, -(alarm.raised_ns or 0)
