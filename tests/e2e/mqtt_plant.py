"""What the gateway runs, less the sensors: bays that are computed, a publisher, the supervisor. Also as a process."""

import asyncio
import resource
import signal
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from typing import Any

from gateway.clock import SystemClock
from gateway.config import FusionConfig, MqttConfig, Reconnect
from gateway.core import fusion
from gateway.core.events import Event, EventKind
from gateway.core.state import StateVector, Tick
from gateway.hub import Hub
from gateway.sinks.mqtt.publisher import MqttPublisher
from gateway.supervisor import Supervisor, Task
from tests import fused
from tests.e2e.supervised import Supervised
from tests.permitted import FOREVER_NS
from tests.sink_context import sink_context

QUICK = Reconnect(min_s=0.05, max_s=0.2)


class ComputedBays(Supervised):
    """Bays without sensors, and a task `deliver`, which whoever derives from it gives to `supervise`."""

    watched = "deliver"

    def __init__(self, *bays: str) -> None:
        self.clock = SystemClock()
        self.hub = Hub(bays or ("bay1",))
        self.waits: list[int] = []  # how often the control path had to wait for anything in each Hub.publish
        self.ticks = 0
        for bay in self.hub.bays:
            self._publish(fusion.initial(bay, self.clock.now_ns()))
        self.happened: list[str] = []

    def supervise(self, deliver: Callable[[], Awaitable[None]]) -> None:
        self.supervisor = Supervisor([Task("compute", self.compute), Task("deliver", deliver, QUICK)], self.clock)

    @property
    def link_errors(self) -> int:
        return self.supervisor.records["deliver"].link_errors

    def happen(self, kind: EventKind, bay: str = "bay1", **values: Any) -> StateVector:
        state = replace(self.hub.state(bay), **values)
        state = replace(state, seq=state.seq + 1, t_ns=self.clock.now_ns())
        self._publish(state, [Event(kind, bay, state.t_ns, state)])
        self.happened.append(kind.value)
        return state

    def report(self, kind: EventKind, state: StateVector, **more: Any) -> None:
        """An event with all that it may carry, of a given state."""
        self._publish(state, [Event(kind, state.bay, state.t_ns, state, **more)])

    async def compute(self) -> None:
        config = FusionConfig()
        while True:
            for bay in self.hub.bays:
                self._publish(fused.step(self.hub.state(bay), Tick(), self.clock.now_ns(), config))
            await asyncio.sleep(0.02)
            self.ticks += 1

    async def tick(self, times: int, timeout_s: float) -> None:
        """Until the control path has gone round so often."""
        goal = self.ticks + times
        await self.until(lambda: self.ticks >= goal, timeout_s)

    @property
    def hardly_waited(self) -> bool:
        """99 in 100 did not; now and then the interpreter's other threads want their turn."""
        return sum(1 for waits in self.waits if waits) <= 0.01 * len(self.waits)

    def _publish(self, state: StateVector, events: Sequence[Event] = ()) -> None:
        state = replace(state, valid_until_ns=FOREVER_NS)
        before = _waits()
        self.hub.publish(state, events)
        self.waits.append(_waits() - before)


class Plant(ComputedBays):
    def __init__(self, url: str | None, *bays: str, instance: str = "gw", **settings: Any) -> None:
        super().__init__(*bays)
        config = MqttConfig(url=url, root="loading", **settings)
        context = sink_context(config, self.hub, self.clock, site="site1", instance=instance)
        self.publisher = MqttPublisher(context)
        self.supervise(self.publisher.deliver)


def _waits() -> int:
    """How often this thread has given the processor back because it had to wait, for a disk, a socket or a lock: that
    it was taken away by other programs does not count."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw


async def main(url: str, close_s: float) -> None:
    """Runs until SIGTERM, then closes the publisher as the gateway does, within `close_s`."""
    plant, stop = Plant(url, keepalive_s=2), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    async with plant.running():
        print("running", flush=True)
        await stop.wait()
        plant.happen(EventKind.SHUTDOWN)
        print(await plant.publisher.close(close_s), flush=True)
