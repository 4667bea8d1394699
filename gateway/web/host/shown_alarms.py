"""The alarms as the sinks get them: what the monitor has evaluated, for as long as it is of now. Pure."""

from gateway.alarms.definition import AlarmDefinition, BayInputs, GatewayInputs
from gateway.alarms.monitor import PERIOD_S, AlarmMonitor
from gateway.alarms.records import Alarm, AlarmChange
from gateway.alarms.states import AlarmState
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.durations import NS_PER_S
from gateway.sinks.contract import AlarmStep, BayAlarms, ShownAlarm

VALID_NS = round(5 * PERIOD_S * NS_PER_S)  # after the last evaluation
UNACKNOWLEDGED = frozenset({AlarmState.UNACKNOWLEDGED, AlarmState.RETURNED, AlarmState.LATCHED_UNACKNOWLEDGED})


class ShownAlarms:
    """Callable as a sink's AlarmSource."""

    def __init__(self, monitor: AlarmMonitor) -> None:
        self._monitor = monitor
        self._revision = -1
        self._known: dict[tuple[str, bool], BayAlarms] = {}  # of this revision

    def __call__(self, bay: str, now_ns: int) -> BayAlarms:
        monitor = self._monitor
        if monitor.revision != self._revision:
            self._revision = monitor.revision
            self._known.clear()
        evaluated = monitor.scanned_ns is not None and now_ns - monitor.scanned_ns <= VALID_NS
        if (bay, evaluated) not in self._known:
            self._known[bay, evaluated] = BayAlarms(_shown(monitor, bay), _shown(monitor, None), evaluated)
        return self._known[bay, evaluated]


def step_of(change: AlarmChange) -> AlarmStep:
    row = ALARM_DEFINITIONS[change.kind]
    return AlarmStep(
        change.number,
        change.t_ns,
        change.id,
        change.kind,
        change.bay,
        row.title,
        row.priority.name.lower(),
        change.event.value,
        change.before.value,
        change.after.value,
        change.detail,
        change.who,
        change.note,
    )


def _shown(monitor: AlarmMonitor, bay: str | None) -> tuple[ShownAlarm, ...]:
    return tuple(_alarm(alarm, row) for alarm, row in monitor.of(bay))


def _alarm(alarm: Alarm, row: AlarmDefinition[BayInputs] | AlarmDefinition[GatewayInputs]) -> ShownAlarm:
    return ShownAlarm(
        alarm.id,
        alarm.kind,
        row.title,
        row.priority.name.lower(),
        alarm.state.value,
        alarm.state in UNACKNOWLEDGED,
        alarm.active,
        alarm.since_ns,
        alarm.raised_ns,
        alarm.occurrences,
        alarm.detail,
        alarm.who,
        alarm.note,
        alarm.shelved_until_ns,
    )
