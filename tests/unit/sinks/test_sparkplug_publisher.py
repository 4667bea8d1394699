"""The Sparkplug publisher: what it reports of its link, and its end."""

import asyncio
from typing import Any

import pytest

from gateway.config import MqttConfig, SparkplugConfig
from gateway.core.state import Reason, StateVector
from gateway.errors import LinkError
from gateway.hub import Hub
from gateway.sinks.mqtt.topics import MqttMessage
from gateway.sinks.sparkplug.publisher import SparkplugPublisher
from tests import virtual_time
from tests.e2e.sparkplug_plant import decode, rebirth_request
from tests.permitted import FOREVER_NS
from tests.sink_context import sink_context
from tests.unit.sinks.mqtt_stand_ins import Broker, Link, in_virtual_time
from tests.virtual_time import LoopClock


def connected_to(broker: Broker, hub: Hub | None = None, **settings: Any) -> SparkplugPublisher:
    broker.check = lambda topic, payload: {}
    config = MqttConfig(url="mqtt://192.0.2.1", sparkplug=SparkplugConfig(**settings))
    context = sink_context(config, hub or Hub(["bay1"]), LoopClock())
    return SparkplugPublisher(context, connect=broker.connect, bd_seq=lambda: 0)


@in_virtual_time
async def test_connected_and_born_are_true_for_as_long_as_the_session_lasts() -> None:
    broker = Broker()
    publisher = connected_to(broker)
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


@pytest.mark.parametrize("closed", [False, True])
def test_after_closing_nothing_is_connected_and_no_message_is_answered(closed: bool) -> None:
    """Not even by births: the primary host may come online while the session ends."""

    async def scenario() -> None:
        broker = Broker()
        publisher = connected_to(broker, primary_host_id="scada")
        if closed:
            await publisher.close(1.0)
            await publisher.deliver()
        await publisher._received(Link(broker), MqttMessage("spBv1.0/STATE/scada", b'{"online": true, "timestamp": 1}'))
        assert (broker.connections, len(broker.received)) == (0, 0 if closed else 1)

    virtual_time.run(scenario())


@in_virtual_time
async def test_a_deferred_rebirth_is_sent_when_it_is_due_and_not_a_period_later() -> None:
    broker = Broker()
    publisher = connected_to(broker, period_s=60)
    async with asyncio.TaskGroup() as group:
        delivering = group.create_task(publisher.deliver())
        await asyncio.sleep(1)
        for _ in range(20):
            await publisher._received(Link(broker), MqttMessage("spBv1.0/site/NCMD/gw", rebirth_request()))
        await asyncio.sleep(20)
        await publisher.close(1.0)
        await delivering
    births = [round(message.at_s - broker.received[0].at_s, 1) for message in broker.on("NBIRTH/gw")]
    assert births == [0.0, 1.0, 6.0]
    assert [publisher.link.figures[key] for key in ("births", "rebirths", "rebirths_deferred")] == [3, 20, 19]


@in_virtual_time
async def test_sequence_numbers_arrive_in_order_while_births_data_and_answers_are_sent_at_once() -> None:
    """The broker takes its time for each message; a birth is several."""
    broker, hub = Broker(), Hub(["bay1", "bay2"])
    broker.ack_s = 0.15
    publisher = connected_to(broker, hub, period_s=0.1)
    broker.check = lambda topic, payload: {"seq": decode(payload).seq}
    async with asyncio.TaskGroup() as group:
        delivering = group.create_task(publisher.deliver())
        for n in range(400):
            for bay in hub.bays:
                stop = n % 7 > 2
                reason = Reason.TARGET_REACHED if stop else Reason.NONE
                hub.publish(StateVector(bay, seq=n, valid_until_ns=FOREVER_NS, stop=stop, reason=reason))
            await asyncio.sleep(0.03)
            if n % 50 == 49:
                command = MqttMessage("spBv1.0/site/NCMD/gw", rebirth_request())
                group.create_task(publisher._received(Link(broker), command))
        await publisher.close(1.0)
        await delivering
    kinds = [message.topic.split("/")[2] for message in broker.received]
    assert (kinds.count("NBIRTH") >= 3, kinds.count("DBIRTH") >= 6, kinds.count("DDATA") >= 20) == (True, True, True)
    expected = 0
    for kind, message in zip(kinds, broker.received, strict=True):
        if kind != "NDEATH":
            expected = 0 if kind == "NBIRTH" else (expected + 1) % 256
            assert message.json["seq"] == expected, (kind, message.at_s)
