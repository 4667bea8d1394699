"""An OPC UA server of the gateway in a thread of the test, on a free port, over a main process that the test plays."""

import asyncio
import threading
from collections import deque
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, TypeVar, cast

from gateway.clock import SystemClock
from gateway.config import GatewayConfig, VisionConfig, parse
from gateway.core.detection import Circle
from gateway.core.fusion import initial
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector
from gateway.durations import NS_PER_S
from gateway.net.listener import listening
from gateway.opcua.process import Served
from gateway.web.ipc.messages import BayStatus, NumberedEvent, SystemStatus
from gateway.web.server.gateway_client import BayReport, GatewayClient

Result = TypeVar("Result")


def good(now_ns: int) -> StateVector:
    """A truck that may move, both sensors good."""
    return replace(
        initial("bay1", now_ns),
        vision=VisionReading(now_ns, Quality.GOOD, Circle(320.25, 240.5, 181.5)),
        range=RangeReading(now_ns, Quality.GOOD, 412.5),
        stop=False,
        may_move=True,
        reason=Reason.NONE,
        d=False,
        valid_until_ns=now_ns + 60 * NS_PER_S,
    )


class Main:
    """What the server sees of the main process. Stands for a GatewayClient."""

    def __init__(self, config: GatewayConfig) -> None:
        self.clock = SystemClock()
        self.bays = tuple(bay.name for bay in config.bays)
        self.links = SystemStatus()
        self.links_ns: int | None = 0
        self.links_known = True
        self.events: deque[NumberedEvent] = deque()
        self.answers = 0
        self.state: StateVector | None = None
        self.after: list[StateVector] = []  # what is reported after a command
        self.commands: list[Any] = []
        self.refusal: Exception | None = None

    def report(self, bay: str) -> BayReport | None:
        if self.state is None or self.state.bay != bay:
            return None
        now_ns = self.clock.now_ns()
        return BayReport(self.answers, BayStatus(self.state, (), VisionConfig()), now_ns, self.clock.wall_ns())

    @contextmanager
    def watching(self, *bays: str, urgent: bool = True) -> Iterator[None]:
        yield

    async def newer(self, bay: str, number: int, seconds: float) -> BayReport | None:
        if not self.after:
            return None
        self.state, self.answers = self.after.pop(0), number + 1
        return self.report(bay)

    async def command(self, action: Any, who: Any) -> None:
        self.commands.append((action, who))
        if self.refusal is not None:
            raise self.refusal


class OpcuaServer:
    """`show`: what the server does every 100 ms."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self.config = parse({"opcua": {"port": 0} | settings.pop("opcua")} | settings)
        self.main = Main(self.config)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._listening = listening("opcua", "127.0.0.1", 0)
        self.sockets = self._listening.__enter__()
        self.url = f"opc.tcp://127.0.0.1:{self.sockets[0].getsockname()[1]}/"
        self._thread.start()
        client = cast(GatewayClient, self.main)
        self.served = self.run(Served.made(self.config, client, list(self.sockets), self.main.clock))

    def run(self, work: Coroutine[Any, Any, Result]) -> Result:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(60)

    def show(self, state: StateVector | None = None) -> None:
        if state is not None:
            self.main.state = state
        self.run(self.served.show())

    def close(self) -> None:
        self.run(self.served.server.stop())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._listening.__exit__(None, None, None)
        self._loop.close()
