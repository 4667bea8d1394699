"""Looks at the alarms once a second, in the main process: deeds outlive the web process. IO: the log."""

import logging
from collections.abc import Callable, Iterable, Mapping
from typing import NoReturn

from gateway.alarms.engine import AlarmBoard
from gateway.alarms.records import Change, Deed, Reply, Standing
from gateway.alarms.states import AlarmState
from gateway.alarms.table import Signs
from gateway.clock import Clock
from gateway.config import FusionConfig
from gateway.core.model import StateVector

log = logging.getLogger(__name__)

PERIOD_S = 1.0
TOLD = 20  # changes told with what stands


class Watch:
    """A row of the task table. `state` gives a bay's state as a PLC would be shown it now, `signs` all the rest."""

    def __init__(
        self,
        bays: Mapping[str, FusionConfig],
        state: Callable[[str], StateVector],
        signs: Callable[[], Signs],
        clock: Clock,
    ) -> None:
        self._board = AlarmBoard(bays)
        self._bays = tuple(bays)
        self._state = state
        self._signs = signs
        self._clock = clock

    async def run(self) -> NoReturn:
        while True:
            self.look()
            await self._clock.sleep(PERIOD_S)

    def look(self) -> None:
        now_ns = self._clock.now_ns()
        for bay in self._bays:
            _tell(self._board.look_at_bay(self._state(bay), now_ns))
        _tell(self._board.look_at_gateway(self._signs(), now_ns))

    def act(self, deed: Deed) -> Reply:
        """Do what a person asks of an alarm. It changes what people are told, and nothing else."""
        reply, changes = self._board.act(deed, self._clock.now_ns())
        _tell(changes)
        return reply

    def standing(self, most: int) -> Standing:
        return self._board.standing(most)

    def changes(self) -> tuple[Change, ...]:
        """The newest few, the oldest of them first."""
        newest = self._board.standing(0).newest_change
        return self._board.history(after=newest - TOLD)


def _tell(changes: Iterable[Change]) -> None:
    for change in changes:
        hushed = AlarmState.SUPPRESSED in (change.before, change.after) and AlarmState.NORMAL in (
            change.before,
            change.after,
        )
        said = f": {change.detail}" if change.detail and change.after is AlarmState.UNACKNOWLEDGED else ""
        by = f" by {change.who}{f' ({change.note})' if change.note else ''}" if change.who else ""
        level = logging.DEBUG if hushed else logging.INFO
        log.log(level, "alarm %s: %s, now %s%s%s", change.id, change.cue.value, change.after.value, by, said)
