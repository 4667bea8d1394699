"""All alarms of a gateway: updated with states and conditions, acted on by people. Pure.

Nothing here touches `stop` or `may_move`, or could: it sees states and changes none. What a person does to an alarm
changes what people see, and nothing else.
"""

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Generic

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.definition import AlarmDefinition, BayInputs, GatewayConditions, GatewayInputs, Inputs
from gateway.alarms.gateway_alarms import GATEWAY_ALARMS
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
from gateway.alarms.table import alarm_id
from gateway.config import BayConfig
from gateway.core.state import StateVector
from gateway.durations import NS_PER_S

HISTORY = 1000  # changes kept, of all alarms
MAX_ALARM_DETAIL_CHARS = 120
# What an operator must see first. Of those that wait for somebody, priority decides, not whether the cause is active.
_ORDER = {
    AlarmState.UNACKNOWLEDGED: 0,
    AlarmState.LATCHED_UNACKNOWLEDGED: 0,
    AlarmState.RETURNED: 0,
    AlarmState.ACKNOWLEDGED: 1,
    AlarmState.LATCHED_ACKNOWLEDGED: 1,
    AlarmState.SHELVED: 2,
    AlarmState.OUT_OF_SERVICE: 3,
    AlarmState.SUPPRESSED: 4,
    AlarmState.NORMAL: 5,
}


class AlarmEngine:
    """`bays`: by name; `bay_alarms`: the alarms of each. Call `update_bay` and `update_gateway` about
    once a second and when something happened; each returns what changed. Times never step back.
    """

    def __init__(
        self, bays: Mapping[str, BayConfig], bay_alarms: Sequence[AlarmDefinition[BayInputs]] = BAY_ALARMS
    ) -> None:
        self._configs = dict(bays)
        self._bays = {bay: [_AlarmInstance(kind, bay) for kind in bay_alarms] for bay in bays}
        self._gateway = [_AlarmInstance(kind, None) for kind in GATEWAY_ALARMS]
        self._by_id: dict[str, _AlarmInstance[BayInputs] | _AlarmInstance[GatewayInputs]] = {
            **{instance.alarm.id: instance for instances in self._bays.values() for instance in instances},
            **{instance.alarm.id: instance for instance in self._gateway},
        }
        self._conditions = GatewayConditions()
        self._history: deque[AlarmChange] = deque(maxlen=HISTORY)
        self.newest_change = 0

    def update_bay(self, state: StateVector, now_ns: int) -> list[AlarmChange]:
        """`state` as a PLC would be shown it now, a dead control task included. KeyError: no such bay."""
        return self._update(self._bays[state.bay], BayInputs(state, self._configs[state.bay]), now_ns)

    def update_gateway(self, conditions: GatewayConditions, now_ns: int) -> list[AlarmChange]:
        inputs = GatewayInputs(conditions, self._conditions)
        self._conditions = conditions
        return self._update(self._gateway, inputs, now_ns)

    def _update(self, instances: "Iterable[_AlarmInstance[Inputs]]", inputs: Inputs, now_ns: int) -> list[AlarmChange]:
        return [self._number(change) for instance in instances for change in instance.update(inputs, now_ns)]

    def act(self, action: OperatorAction, now_ns: int) -> tuple[ActionReply, list[AlarmChange]]:
        """Apply a person's action and return what changed; or the reason why not, and change nothing."""
        instance = self._by_id.get(action.id)
        if instance is None:
            return ActionReply(ActionOutcome.UNKNOWN, f"there is no alarm {action.id[:100]!r}"), []
        if invalid := _invalid(action):
            return ActionReply(ActionOutcome.INVALID, invalid), []
        if action.occurrence not in (None, instance.alarm.occurrences):
            return ActionReply(ActionOutcome.REFUSED, f"{action.id} has occurred again since: read it first"), []
        if changes := instance.transition(action.event, now_ns, action):
            return ActionReply(), [self._number(change) for change in changes]
        state = instance.alarm.state.value
        return ActionReply(ActionOutcome.REFUSED, f"{action.event.value}: not possible, {action.id} is {state}"), []

    def alarm(self, name: str) -> Alarm | None:
        instance = self._by_id.get(name)
        return None if instance is None else instance.alarm

    def of(self, bay: str | None) -> list[tuple[Alarm, AlarmDefinition[BayInputs] | AlarmDefinition[GatewayInputs]]]:
        """All alarms of a bay, or of the gateway itself (None), and their rows; the most important first."""
        instances = self._gateway if bay is None else self._bays[bay]
        return [(instance.alarm, instance.kind) for instance in sorted(instances, key=_display_order)]

    def summary(self, most: int = 200) -> AlarmSummary:
        """The alarms that are not normal, the most important first, at most so many."""
        instances = sorted(self._by_id.values(), key=_display_order)
        alarms = [instance.alarm for instance in instances]
        counts = Counter(alarm.state for alarm in alarms)
        announced: Counter[str] = Counter()
        for alarm in alarms:
            announced[alarm.kind] += alarm.occurrences
        shown = [alarm for alarm in alarms if alarm.state is not AlarmState.NORMAL]
        return AlarmSummary(
            tuple(shown[:most]),
            max(0, len(shown) - most),
            tuple((state, counts[state]) for state in AlarmState),
            tuple((kind, count) for kind, count in announced.items() if count),
            self.newest_change,
        )

    def history(self, after: int = 0, most: int = HISTORY) -> tuple[AlarmChange, ...]:
        """Changes numbered above `after`, the oldest first; a gap in the numbers: older ones are not kept any more."""
        return tuple(change for change in self._history if change.number > after)[:most]

    def _number(self, change: AlarmChange) -> AlarmChange:
        self.newest_change += 1
        numbered = replace(change, number=self.newest_change)
        self._history.append(numbered)
        return numbered


class _AlarmInstance(Generic[Inputs]):
    """One alarm and its delays."""

    __slots__ = ("_pending_ns", "alarm", "kind")

    def __init__(self, kind: AlarmDefinition[Inputs], bay: str | None) -> None:
        self.kind: AlarmDefinition[Inputs] = kind
        self.alarm = Alarm(alarm_id(kind.id, bay), kind.id, bay)
        self._pending_ns: int | None = None  # since when the cause is other than `alarm.active`

    def update(self, inputs: Inputs, now_ns: int) -> list[AlarmChange]:
        changes: list[AlarmChange] = []
        suppressed = bool(inputs.suppressions & self.kind.suppressed_by)
        if suppressed:
            # Afterwards the on-delay starts again: what was suppressed settles before it is evaluated.
            self._pending_ns = None
            if self.alarm.active:
                self.alarm = replace(self.alarm, active=False)
        if self.alarm.state is AlarmState.SHELVED and now_ns >= (self.alarm.shelved_until_ns or 0):
            changes += self.transition(AlarmEvent.UNSHELVE, now_ns)
        if suppressed:
            return changes + self.transition(AlarmEvent.SUPPRESS, now_ns)
        if self.alarm.state is AlarmState.SUPPRESSED:
            changes += self.transition(AlarmEvent.UNSUPPRESS, now_ns)
        return changes + self._evaluate(inputs, now_ns)

    def _evaluate(self, inputs: Inputs, now_ns: int) -> list[AlarmChange]:
        """Does the cause hold, delays counted?"""
        kind = self.kind
        holds = kind.condition(inputs)
        if holds == self.alarm.active:
            self._pending_ns = None
            return []
        if self._pending_ns is None:
            self._pending_ns = now_ns
        if now_ns - self._pending_ns < (kind.on_delay_s if holds else kind.off_delay_s) * NS_PER_S:
            return []
        self._pending_ns = None
        detail = kind.detail(inputs)[:MAX_ALARM_DETAIL_CHARS] if holds else self.alarm.detail
        self.alarm = replace(self.alarm, active=holds, detail=detail)
        return self.transition(AlarmEvent.OCCURS if holds else AlarmEvent.RETURNS, now_ns)

    def transition(self, event: AlarmEvent, now_ns: int, action: OperatorAction | None = None) -> list[AlarmChange]:
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


def _display_order(
    instance: _AlarmInstance[BayInputs] | _AlarmInstance[GatewayInputs],
) -> tuple[int, int, bool, int]:
    """Sorts the most important first: unacknowledged ones, then by priority, then the active, then the newest."""
    alarm = instance.alarm
    return _ORDER[alarm.state], -instance.kind.priority, not alarm.active, -(alarm.raised_ns or 0)
