"""Evaluates the alarms once a second, and as soon as a truck in place moves, as a supervised task of the main process:
with and without pages. Pure but for the clock, which is passed in."""

from collections.abc import Callable, Iterable, Mapping
from typing import NoReturn

from gateway.alarms.definition import AlarmDefinition, BayInputs, GatewayConditions, GatewayInputs
from gateway.alarms.engine import AlarmEngine
from gateway.alarms.records import ActionReply, Alarm, AlarmChange, AlarmSummary, OperatorAction
from gateway.clock import Clock
from gateway.config import BayConfig
from gateway.core.state import Moved, StateVector

PERIOD_S = 1.0
MOTION_S = 0.05  # between two looks at whether a truck in place moves: its alarm does not wait for the next second
REPORTED_CHANGES = 20


class AlarmMonitor:
    """A row of the task table. `state`: a bay's state as a PLC would be shown it now; `report` gets every change of an
    alarm, in order."""

    def __init__(
        self,
        bays: Mapping[str, BayConfig],
        state: Callable[[str], StateVector],
        clock: Clock,
        report: Callable[[AlarmChange], None],
    ) -> None:
        self._engine = AlarmEngine(bays)
        self._bays = tuple(bays)
        self._state = state
        self._clock = clock
        self._report = report
        self.scanned_ns: int | None = None  # the last time all were evaluated; None: not yet
        self.revision = 0  # another one: something may have changed since

    async def run(self, conditions: Callable[[], GatewayConditions]) -> NoReturn:
        """`conditions`: those of the gateway itself, now."""
        while True:
            self.scan(conditions())
            seen = self._motion()
            for _ in range(round(PERIOD_S / MOTION_S)):
                await self._clock.sleep(MOTION_S)
                if self._motion() != seen:
                    break

    def _motion(self) -> list[tuple[bool, bool, Moved, bool]]:
        """Of each bay."""
        states = [self._state(bay) for bay in self._bays]
        return [
            (state.visit.rolling, state.unintended_motion, state.visit.moved, state.visit.in_place) for state in states
        ]

    def scan(self, conditions: GatewayConditions) -> None:
        now_ns = self.scanned_ns = self._clock.now_ns()
        self.revision += 1
        for bay in self._bays:
            self._report_all(self._engine.update_bay(self._state(bay), now_ns))
        self._report_all(self._engine.update_gateway(conditions, now_ns))

    def act(self, action: OperatorAction) -> ActionReply:
        """Apply an operator's action to an alarm. It changes what people see, and nothing else."""
        reply, changes = self._engine.act(action, self._clock.now_ns())
        self.revision += 1
        self._report_all(changes)
        return reply

    def of(self, bay: str | None) -> list[tuple[Alarm, AlarmDefinition[BayInputs] | AlarmDefinition[GatewayInputs]]]:
        """All alarms of a bay, or of the gateway itself (None), and their rows; the most important first."""
        return self._engine.of(bay)

    def summary(self, most: int) -> AlarmSummary:
        return self._engine.summary(most)

    def changes(self) -> tuple[AlarmChange, ...]:
        """The newest few, the oldest of them first."""
        return self._engine.history(after=self.newest_change - REPORTED_CHANGES)

    @property
    def newest_change(self) -> int:
        """Its number; 0: none yet."""
        return self._engine.newest_change

    def _report_all(self, changes: Iterable[AlarmChange]) -> None:
        for change in changes:
            self._report(change)
