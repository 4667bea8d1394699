"""A connection against a broker that is played here, where a real one is too kind to tell the difference."""

import asyncio
from asyncio import StreamReader, StreamWriter

import pytest

from gateway import event_loop
from gateway.sinks.mqtt.broker_link import MAX_IN_FLIGHT, connect
from gateway.sinks.mqtt.topics import MqttMessage
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
