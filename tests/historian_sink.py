"""A sink as another distribution would bring it: everything it needs is in this module. See docs/extending.md."""

import asyncio
from dataclasses import dataclass, field

from pydantic import Field

from gateway.config import Reconnect
from gateway.config.strict.section import Section
from gateway.core.events import Event
from gateway.core.state import StateVector
from gateway.sinks.contract import LinkStatus, SinkContext, SinkType


class HistorianConfig(Section):
    table: str = Field("bays", min_length=1, description="where the rows go")


@dataclass
class Tables:
    """The historian's other system, which is memory here, by the name of the table."""

    states: list[StateVector] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)


TABLES: dict[str, Tables] = {}


class Historian:
    """Keeps every state that it is fast enough for, and every event."""

    task = "historian"
    reconnect = Reconnect()

    def __init__(self, context: SinkContext) -> None:
        self._bays = context.bays
        self._clock = context.clock
        self._events = context.bays.subscribe()
        self._rows = TABLES.setdefault(context.settings.table, Tables())

    @property
    def link(self) -> LinkStatus:
        figures = {"rows": len(self._rows.states) + len(self._rows.events)}
        return LinkStatus("historian", True, "connected", "memory", self._events.dropped, figures)

    async def deliver(self) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(self._keep_events())
            for bay in self._bays.bays:
                group.create_task(self._keep_states(bay))

    async def close(self, timeout_s: float) -> None:
        self._rows.events += self._events.drain()
        self._rows.states += [self._bays.shown(bay, self._clock.now_ns()) for bay in self._bays.bays]

    async def _keep_events(self) -> None:
        while True:
            self._rows.events.append(await self._events.get())

    async def _keep_states(self, bay: str) -> None:
        seq = -1
        while True:
            seq = await self._bays.newer(bay, seq)
            self._rows.states.append(self._bays.shown(bay, self._clock.now_ns()))


HISTORIAN = SinkType("historian", Historian, HistorianConfig)
