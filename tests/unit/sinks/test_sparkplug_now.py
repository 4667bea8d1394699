"""What the Sparkplug publisher tells of itself, to pages and metrics."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence

from gateway.config import MqttConfig, SparkplugConfig
from gateway.errors import LinkError
from gateway.hub import Hub
from gateway.sinks.mqtt.broker_link import Incoming, Message
from gateway.sinks.sparkplug.publisher import SparkplugPublisher
from tests import virtual_time
from tests.virtual_time import LoopClock


class Link:
    """Takes everything; breaks when told to."""

    def __init__(self) -> None:
        self.broken = asyncio.Event()

    async def publish(self, message: Message) -> None:
        pass

    async def subscribe(self, topics: Sequence[tuple[str, int]]) -> None:
        pass

    async def incoming(self) -> AsyncIterator[Incoming]:
        for message in [Incoming("", b"")] * self.broken.is_set():
            yield message
        await self.broken.wait()
        raise LinkError("connection lost")


def test_connected_and_born_are_true_for_as_long_as_the_session_lasts() -> None:
    async def main() -> None:
        links: list[Link] = []

        @contextlib.asynccontextmanager
        async def connect(_: Message) -> AsyncIterator[Link]:
            links.append(Link())
            yield links[-1]

        config = MqttConfig(url="mqtt://broker", sparkplug=SparkplugConfig())
        hub = Hub(["bay1"])
        publisher = SparkplugPublisher(config, "site", "gw", hub, LoopClock(), connector=connect, bd_seq=lambda: 0)
        before = publisher.link
        async with asyncio.TaskGroup() as group:
            delivering = group.create_task(until_lost(publisher))
            await asyncio.sleep(1)
            during = publisher.link
            links[0].broken.set()
            assert await delivering == "connection lost"
        told = [
            (now.figures["connected"], now.figures["born"], now.figures["births"])
            for now in (before, during, publisher.link)
        ]
        assert told == [(False, False, 0), (True, True, 1), (False, False, 1)]

    virtual_time.run(main())


async def until_lost(publisher: SparkplugPublisher) -> str:
    try:
        await publisher.deliver()
    except LinkError as error:
        return str(error)
    return "ended"
