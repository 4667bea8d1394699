"""The MQTT publisher's surroundings in virtual time: a broker made of memory, and bays that are computed."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gateway.config import MqttConfig
from gateway.core import fusion
from gateway.core.events import Event, EventKind
from gateway.core.state import StateVector
from gateway.errors import LinkError
from gateway.hub import Hub
from gateway.sinks.mqtt.broker_link import BrokerLink, PublishRefusedError, UnansweredError
from gateway.sinks.mqtt.publisher import MqttPublisher
from gateway.sinks.mqtt.topics import MqttMessage
from tests import virtual_time
from tests.mqtt_messages import checked
from tests.sink_context import sink_context
from tests.virtual_time import LoopClock


@dataclass
class ReceivedMessage:
    at_s: float
    topic: str
    retain: bool
    json: dict[str, Any]


class Broker:
    """What arrives is kept in `received` at once and acknowledged `ack_s` later; never, while `hung`."""

    def __init__(self) -> None:
        self.ack_s = 0.0
        self.hung = False
        self.refuses = False
        self.in_flight = 20
        self.unsubscribed: set[str] = set()  # topics without a subscriber
        self.faults: dict[str, str] = {}  # topic -> why it is refused
        self.ends_after_refusal = False
        self.ending: set[str] = set()  # topics whose messages end the connection
        self.received: list[ReceivedMessage] = []
        self.unacknowledged = 0
        self.connections = 0
        self.ends: list[str] = []  # how each connection ended
        self.lost = asyncio.Event()
        self.bug: Exception | None = None
        self.check: Callable[[str, bytes], dict[str, Any]] = checked  # against the schema of the topic

    @contextlib.asynccontextmanager
    async def connect(self, *_: object, **__: object) -> AsyncIterator["Link"]:
        if self.refuses:
            raise LinkError("refused")
        assert self.connections == len(self.ends), "two connections with one client id"
        self.connections += 1
        self.lost = asyncio.Event()
        try:
            yield Link(self)
        except BaseException:
            self.ends.append("cut")
            raise
        self.ends.append("disconnected")

    def lose(self) -> None:
        """Break the connection there is."""
        self.lost.set()

    def on(self, suffix: str) -> list[ReceivedMessage]:
        return [message for message in self.received if message.topic.endswith(suffix)]

    def ids(self) -> list[str]:
        return [message.json["id"] for message in self.on("/event")]

    def kinds(self) -> list[str]:
        return [message.json["kind"] for message in self.on("/event")]


class Link(BrokerLink):
    def __init__(self, broker: Broker) -> None:
        self._memory = broker
        self.in_flight = broker.in_flight
        self.unanswered = []
        self._refusal: tuple[str, str, float] | None = None
        self._turns = asyncio.Semaphore(self.in_flight)

    @property
    def newest_refusal(self) -> tuple[str, str, float] | None:
        return self._refusal

    async def publish(self, message: MqttMessage) -> bool:
        async with self._turns:
            self.unanswered.append(message.topic)
            taken = await self._publish(message)
            self.unanswered.remove(message.topic)
            return taken

    async def _publish(self, message: MqttMessage) -> bool:
        broker = self._memory
        if broker.bug is not None:
            raise broker.bug
        broker.received.append(
            ReceivedMessage(now_s(), message.topic, message.retain, broker.check(message.topic, message.payload))
        )
        if message.topic in broker.ending:
            broker.lose()
        broker.unacknowledged += 1
        try:
            async with asyncio.timeout(7.5):
                await (asyncio.Event().wait() if broker.hung else asyncio.sleep(broker.ack_s))
        except TimeoutError:
            raise UnansweredError("no acknowledgement") from None
        finally:
            broker.unacknowledged -= 1
        if broker.lost.is_set():
            raise LinkError("connection lost")
        if message.topic in broker.faults:
            self._refusal = message.topic, broker.faults[message.topic], now_s()
            if broker.ends_after_refusal:
                self.unanswered.remove(message.topic)
                raise LinkError("connection lost")
            raise PublishRefusedError("broker", message.topic, broker.faults[message.topic])
        return message.topic not in broker.unsubscribed

    async def quiet(self) -> None:
        pass

    async def subscribe(self, topics: Sequence[tuple[str, int]]) -> None:
        pass

    async def incoming(self) -> AsyncIterator[MqttMessage]:
        for message in [MqttMessage("", b"")] * self._memory.lost.is_set():
            yield message
        await self._memory.lost.wait()
        raise LinkError("connection lost")


def now_s() -> float:
    return asyncio.get_running_loop().time()


VALID_NS = 3_000_000_000  # after its last state a bay counts as dead


class Plant:
    """A hub whose bays are computed every 20 ms, a publisher, and the supervisor's part in small."""

    def __init__(self, *bays: str, **settings: Any) -> None:
        self.clock = LoopClock()
        self.broker = Broker()
        self.hub = Hub(bays or ("bay1",))
        for bay in self.hub.bays:
            self.hub.publish(fusion.initial(bay, self.clock.now_ns()))
        config = MqttConfig(**({"url": "mqtt://192.0.2.1", "root": "r"} | settings))
        self.publisher = MqttPublisher(sink_context(config, self.hub, self.clock), connect=self.broker.connect)
        self.link_errors: list[str] = []
        self.failed = asyncio.Event()
        self.computing = set(self.hub.bays)
        for bay in self.hub.bays:
            self.hub.publish(replace(self.hub.state(bay), valid_until_ns=self.clock.now_ns() + VALID_NS))

    def change(self, bay: str = "bay1", **values: Any) -> StateVector:
        old = self.hub.state(bay)
        now_ns = self.clock.now_ns()
        new = replace(old, seq=old.seq + 1, t_ns=now_ns, valid_until_ns=now_ns + VALID_NS, **values)
        self.hub.publish(new)
        return new

    def happen(self, kind: EventKind, bay: str = "bay1") -> None:
        state = self.hub.state(bay)
        self.hub.publish(state, [Event(kind, bay, self.clock.now_ns(), state)])

    async def compute(self) -> None:
        while True:
            await asyncio.sleep(0.02)
            for bay in self.computing:
                self.change(bay)

    async def keep_delivering(self) -> None:
        while True:
            try:
                return await self.publisher.deliver()
            except LinkError as error:
                self.link_errors.append(str(error))
                self.failed.set()
                await asyncio.sleep(1)

    @contextlib.asynccontextmanager
    async def running(self, *parts: Callable[[], Awaitable[None]]) -> AsyncIterator[None]:
        async with asyncio.TaskGroup() as group:
            chosen = parts or (self.compute, self.keep_delivering)
            tasks = [group.create_task(as_coroutine(part())) for part in chosen]
            yield
            for task in tasks:
                task.cancel()


async def as_coroutine(awaitable: Awaitable[None]) -> None:
    await awaitable


def in_virtual_time(test: Callable[[], Coroutine[Any, Any, None]]) -> Callable[[], None]:
    def run() -> None:
        virtual_time.run(test())

    run.__name__ = test.__name__
    run.__doc__ = test.__doc__
    return run
