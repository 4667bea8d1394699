"""What the gateway runs, less the sensors: bays that are computed, a publisher, the supervisor. Also as a process."""

import asyncio
import signal
import sys
import time
from dataclasses import replace
from typing import Any

from gateway import fusion
from gateway.clock import SystemClock
from gateway.config import FusionConfig, MqttConfig, Reconnect
from gateway.hub import Hub
from gateway.model import Event, EventKind, StateVector, Tick
from gateway.mqtt.publisher import MqttPublisher
from gateway.supervisor import Supervisor, Task
from tests.e2e.supervised import Supervised

QUICK = Reconnect(min_s=0.05, max_s=0.2)


class Plant(Supervised):
    watched = "deliver"

    def __init__(self, url: str, *bays: str, instance: str = "gw", **settings: Any) -> None:
        self.clock = SystemClock()
        self.hub = Hub(bays or ("bay1",))
        for bay in self.hub.bays:
            self.hub.publish(fusion.initial(bay, self.clock.now_ns()))
        config = MqttConfig(url=url, root="loading", **settings)
        self.publisher = MqttPublisher(config, "site1", instance, self.hub, self.clock, "1.0")
        self.supervisor = Supervisor(
            [
                Task("compute", self.compute),
                Task("deliver", self.publisher.deliver, QUICK),
            ],
            self.clock,
        )
        self.happened: list[str] = []
        self.publish_s: list[float] = []  # how long the control path was kept by each Hub.publish
        self.late_s: list[float] = []  # how late each tick came

    @property
    def link_errors(self) -> int:
        return self.supervisor.records["deliver"].link_errors

    def happen(self, kind: EventKind, bay: str = "bay1", **values: Any) -> StateVector:
        state = replace(self.hub.state(bay), **values)
        state = replace(state, seq=state.seq + 1, t_ns=self.clock.now_ns())
        begun = time.perf_counter()
        self.hub.publish(state, [Event(kind, bay, state.t_ns, state)])
        self.publish_s.append(time.perf_counter() - begun)
        self.happened.append(kind.value)
        return state

    async def compute(self) -> None:
        config = FusionConfig()
        while True:
            for bay in self.hub.bays:
                state = fusion.step(self.hub.state(bay), Tick(), self.clock.now_ns(), config)
                begun = time.perf_counter()
                self.hub.publish(state)
                self.publish_s.append(time.perf_counter() - begun)
            begun = time.perf_counter()
            await asyncio.sleep(0.02)
            self.late_s.append(time.perf_counter() - begun - 0.02)


async def main(url: str) -> None:
    """Runs until SIGTERM, then says farewell, as the real one does."""
    plant, stop = Plant(url, keepalive_s=2), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    async with plant.running():
        print("running", flush=True)
        await stop.wait()
        plant.happen(EventKind.SHUTDOWN)
        print(await plant.publisher.farewell(1.0), flush=True)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
