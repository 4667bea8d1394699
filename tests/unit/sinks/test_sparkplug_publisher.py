"""What the Sparkplug publisher reports of its link, to pages and metrics."""

import asyncio

import pytest

from gateway.config import MqttConfig, SparkplugConfig
from gateway.errors import LinkError
from gateway.hub import Hub
from gateway.sinks.sparkplug.publisher import SparkplugPublisher
from tests.unit.sinks.mqtt_stand_ins import Broker, in_virtual_time
from tests.virtual_time import LoopClock


@in_virtual_time
async def test_connected_and_born_are_true_for_as_long_as_the_session_lasts() -> None:
    broker = Broker()
    broker.check = lambda topic, payload: {}
    config = MqttConfig(url="mqtt://broker", sparkplug=SparkplugConfig())
    publisher = SparkplugPublisher(
        config, "site", "gw", Hub(["bay1"]), LoopClock(), connect=broker.connect, bd_seq=lambda: 0
    )
    links = [publisher.link]
    async with asyncio.TaskGroup() as group:
        delivering = group.create_task(_until_lost(publisher))
        await asyncio.sleep(1)
        links.append(publisher.link)
        broker.lose()
        await delivering
    links.append(publisher.link)
    assert [[link.figures[key] for key in ("connected", "born", "births")] for link in links] == [
        [False, False, 0],
        [True, True, 1],
        [False, False, 1],
    ]


async def _until_lost(publisher: SparkplugPublisher) -> None:
    with pytest.raises(LinkError, match="connection lost"):
        await publisher.deliver()
