"""A connection against a broker that is played here, where a real one is too kind to tell the difference."""

import asyncio
import json
from asyncio import StreamReader, StreamWriter
from typing import Any

import pytest

from gateway import event_loop
from gateway.core.events import EventKind
from gateway.sinks.mqtt.broker_link import MAX_IN_FLIGHT, connect
from gateway.sinks.mqtt.topics import MqttMessage
from tests.e2e.mqtt_packets import Packet, Stream
from tests.e2e.mqtt_plant import Plant
from tests.mqtt_endpoints import at

PUBLISH, DISCONNECT = 3, 14


class SlowBroker:
    """An MQTT 5 broker that says how many messages it receive_maximum at once, and is slow to acknowledge."""

    def __init__(self, receive_maximum: int) -> None:
        self._receive_maximum = receive_maximum
        self._mids: list[bytes] = []
        self.most = 0  # unacknowledged at once
        self.taken = 0

    async def serve(self, reader: StreamReader, writer: StreamWriter) -> None:
        await self._packet(reader)  # CONNECT
        writer.write(b"\x20\x06\x00\x00\x03\x21" + self._receive_maximum.to_bytes(2, "big"))  # 0x21: Receive Maximum
        acknowledging = asyncio.create_task(self._acknowledge(writer))
        while True:
            kind, body = await self._packet(reader)
            if kind == DISCONNECT:
                break
            if kind == PUBLISH:
                topic = int.from_bytes(body[:2], "big")
                self._mids.append(body[2 + topic : 4 + topic])
                self.most = max(self.most, len(self._mids))
        acknowledging.cancel()
        writer.close()

    async def _packet(self, reader: StreamReader) -> tuple[int, bytes]:
        head, size = await reader.readexactly(2)  # nothing here is as long as 128 bytes
        return head >> 4, await reader.readexactly(size)

    async def _acknowledge(self, writer: StreamWriter) -> None:
        while True:
            await asyncio.sleep(0.05)
            while self._mids:
                writer.write(b"\x40\x02" + self._mids.pop(0))
                self.taken += 1


@pytest.mark.parametrize(("receive_maximum", "most"), [(1, 1), (3, 3), (65535, MAX_IN_FLIGHT)])
def test_never_more_messages_are_on_their_way_than_the_broker_receive_maximum(receive_maximum: int, most: int) -> None:
    broker = SlowBroker(receive_maximum)

    async def scenario() -> None:
        server = await asyncio.start_server(broker.serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        async with (
            server,
            asyncio.timeout(30),
            connect(
                at(f"mqtt://127.0.0.1:{port}"),
                client_id="gateway",
                will=MqttMessage("will", b"", retain=False),
                keepalive_s=30,
                acknowledge_s=30,
                tls=None,
                version="5",
            ) as link,
            asyncio.TaskGroup() as group,
        ):
            for _ in range(20):
                group.create_task(link.publish(MqttMessage("t", b"", retain=False)))

    event_loop.run(scenario())
    assert broker.taken == 20
    assert 1 <= broker.most <= most


class SwallowingBroker:
    """An MQTT 5 broker that takes each of these events once without a trace. `passed`: the others, by connection.

    `simple`: it accepts QoS 0 only and retains nothing, also of last wills. `unreadable`: it ends the connection of a
    client that subscribes.
    """

    def __init__(self, *swallowed: int, simple: bool = False, unreadable: bool = False) -> None:
        self._swallowed = set(swallowed)
        self._simple = simple
        self._unreadable = unreadable
        self.passed: list[list[int]] = []
        self.packets: list[Packet] = []
        self.connections = 0

    async def serve(self, reader: StreamReader, writer: StreamWriter) -> None:
        self.connections += 1
        stream, passed = Stream(True, len(self.passed), [5]), list[int]()
        self.passed.append(passed)
        while data := await reader.read(65_536):
            answers = b""
            self.packets += (packets := stream.feed(data))
            for packet in packets:
                if packet.kind == "CONNECT" and self._simple and packet.will_qos:
                    answers += b"\x20\x03\x00\x9b\x00"  # QoS not supported
                elif packet.kind == "CONNECT" and self._simple and packet.will_retain:
                    answers += b"\x20\x03\x00\x9a\x00"  # Retain not supported
                elif packet.kind == "CONNECT" and self._simple:
                    answers += b"\x20\x07\x00\x00\x04\x24\x00\x25\x00"  # Maximum QoS, Retain Available
                elif packet.kind == "CONNECT":
                    answers += b"\x20\x03\x00\x00\x00"
                elif packet.kind == "PUBLISH":
                    number = int(json.loads(packet.payload)["id"].split("-")[1]) if "/event" in packet.topic else 0
                    if number in self._swallowed:
                        self._swallowed.remove(number)
                        continue
                    passed += [number] if number else []
                    answers += b"\x40\x02" + packet.mid.to_bytes(2, "big") if packet.qos else b""
            await asyncio.sleep(0.02)  # a round trip: several are on their way
            writer.write(answers)
            if self._unreadable and any(packet.kind == "SUBSCRIBE" for packet in packets):
                break
        writer.close()
        self.connections -= 1


def delivered(broker: SwallowingBroker, count: int, timeout_s: float, **settings: Any) -> Plant:
    async def scenario() -> Plant:
        server = await asyncio.start_server(broker.serve, "127.0.0.1", 0)
        plant = Plant(f"mqtt://127.0.0.1:{server.sockets[0].getsockname()[1]}", **settings)
        async with server, plant.running():
            for _ in range(count):
                plant.happen(EventKind.STOP_RAISED)
            await plant.until(lambda: plant.publisher.stats.queued == 0, timeout_s)
            await plant.until(lambda: sum(map(len, broker.passed)) >= count)
        await plant.until(lambda: broker.connections == 0)
        return plant

    return event_loop.run(scenario())


def test_behind_a_message_that_a_broker_loses_all_are_sent_again_at_once_and_in_order() -> None:
    """The next acknowledgement shows it; the time limit for one is 45 s here."""
    broker = SwallowingBroker(*range(40, 48))
    delivered(broker, 60, 30, keepalive_s=60)
    assert broker.passed[0][:39] == list(range(1, 40))
    assert [number for again in broker.passed[1:] for number in again] == list(range(40, 61))


def test_with_one_event_on_its_way_none_overtakes_one_that_a_broker_loses() -> None:
    broker = SwallowingBroker(3, 7)
    delivered(broker, 10, 60, keepalive_s=2, events_in_flight=1)
    assert broker.passed == [[1, 2], [3, 4, 5, 6], [7, 8, 9, 10]]


def test_a_broker_without_qos_1_and_retained_messages_gets_neither(caplog: pytest.LogCaptureFixture) -> None:
    """Each of them would end the connection (0x9A, 0x9B)."""
    broker = SwallowingBroker(simple=True)
    delivered(broker, 3, 30)
    wills = [(packet.will_qos, packet.will_retain) for packet in broker.packets if packet.kind == "CONNECT"]
    assert wills == [(1, True), (0, True), (0, False)]
    (said,) = [line for line in caplog.messages if "QoS" in line]
    assert said.startswith("mqtt://127.0.0.1:")
    assert said.endswith(": supports QoS 0 only, no retained messages")
    published = [packet for packet in broker.packets if packet.kind == "PUBLISH"]
    assert {(packet.qos, packet.retain) for packet in published} == {(0, False)}
    assert [number for passed in broker.passed for number in passed] == [1, 2, 3]


def test_a_broker_that_permits_no_reading_is_asked_once() -> None:
    """It ends the connection of a client that asks what an earlier start has left."""
    broker = SwallowingBroker(unreadable=True)
    plant = delivered(broker, 3, 30)
    assert (plant.link_errors, sum(packet.kind == "SUBSCRIBE" for packet in broker.packets)) == (1, 1)
    assert sorted({number for passed in broker.passed for number in passed}) == [1, 2, 3]
