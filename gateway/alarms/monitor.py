"""Looks at the alarms once a second, in the main process: actions outlive the web process. IO: the log."""

import logging
from collections.abc import Callable, Iterable, Mapping
from typing import NoReturn

from gateway.alarms.engine import AlarmEngine
from gateway.alarms.records import ActionReply, AlarmChange, AlarmSummary, OperatorAction
from gateway.alarms.states import AlarmState
from gateway.alarms.table import GatewayConditions
from gateway.clock import Clock
from gateway.config import FusionConfig
from gateway.core.model import StateVector

log = logging.getLogger(__name__)

PERIOD_S = 1.0
REPORTED_CHANGES = 20  # changes told with what stands


class AlarmMonitor:
    """A row of the task table. `state`: a bay's state as a PLC would be shown it now; `conditions`: all the rest."""

    def __init__(
        self,
        bays: Mapping[str, FusionConfig],
        state: Callable[[str], StateVector],
        conditions: Callable[[], GatewayConditions],
        clock: Clock,
    ) -> None:
        self._engine = AlarmEngine(bays)
        self._bays = tuple(bays)
        self._state = state
        self._conditions = conditions
        self._clock = clock

    async def run(self) -> NoReturn:
        while True:
            self.scan()
            await self._clock.sleep(PERIOD_S)

    def scan(self) -> None:
        now_ns = self._clock.now_ns()
        for bay in self._bays:
            _log_changes(self._engine.update_bay(self._state(bay), now_ns))
        _log_changes(self._engine.update_gateway(self._conditions(), now_ns))

    def act(self, action: OperatorAction) -> ActionReply:
        """Do what a person asks of an alarm. It changes what people are told, and nothing else."""
        reply, changes = self._engine.act(action, self._clock.now_ns())
        _log_changes(changes)
        return reply

    def summary(self, most: int) -> AlarmSummary:
        return self._engine.summary(most)

    def changes(self) -> tuple[AlarmChange, ...]:
        """The newest few, the oldest of them first."""
        newest = self._engine.summary(0).newest_change
        return self._engine.history(after=newest - REPORTED_CHANGES)


def _log_changes(changes: Iterable[AlarmChange]) -> None:
    for change in changes:
        hushed = AlarmState.SUPPRESSED in (change.before, change.after) and AlarmState.NORMAL in (
            change.before,
            change.after,
        )
        said = f": {change.detail}" if change.detail and change.after is AlarmState.UNACKNOWLEDGED else ""
        by = f" by {change.who}{f' ({change.note})' if change.note else ''}" if change.who else ""
        level = logging.DEBUG if hushed else logging.INFO
        log.log(level, "alarm %s: %s, now %s%s%s", change.id, change.event.value, change.after.value, by, said)
