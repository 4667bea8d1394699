"""A bay on a Modbus server whose sensors are the test's: no camera, no ranger, the gateway's own control task."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from gateway.bay import BayControl
from gateway.clock import SystemClock
from gateway.config import parse
from gateway.core.detection import Circle
from gateway.core.events import EventKind
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.hub import Hub
from gateway.modbus.registers.bay_unit import unit_of
from gateway.modbus.server.modbus_service import Listening, serving


class ServedBay:
    """Of this configuration. A truck stands `distance_mm` away, its marker in sight."""

    def __init__(self, config: dict[str, Any]) -> None:
        self.config = parse(config)
        self.distance_mm = 900.0
        self.hub = Hub(["bay1"])
        self.events = self.hub.subscribe()
        self.clock = SystemClock()
        self.bay = BayControl(self.config.bays[0], self.hub, self.clock, (), self.config)

    async def _measure(self) -> None:
        while True:
            now_ns = self.clock.now_ns()
            self.bay.on_reading(VisionReading(now_ns, Quality.GOOD, Circle(320, 240, 200.0)))
            self.bay.on_reading(RangeReading(now_ns, Quality.GOOD, self.distance_mm))
            await asyncio.sleep(0.03)

    @asynccontextmanager
    async def open(self) -> AsyncIterator[Listening]:
        unit = unit_of(self.bay, self.config, self.clock)
        async with serving(self.config.modbus, {1: unit}, self.clock) as listening, asyncio.TaskGroup() as group:
            tasks = [group.create_task(self.bay.run()), group.create_task(self._measure())]
            yield listening
            for task in tasks:
                task.cancel()

    def refused(self) -> list[str]:
        return [event.detail for event in self.events.drain() if event.kind is EventKind.WRITE_REFUSED]
