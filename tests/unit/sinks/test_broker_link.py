"""What is used of the MQTT client library beyond its public interface: an upgrade fails here, not in a plant."""

import asyncio
import inspect
import re
import socket
import tomllib
from importlib.metadata import version
from pathlib import Path

import paho.mqtt.client as paho
import pytest

from gateway.errors import LinkError
from gateway.sinks.mqtt import broker_link
from gateway.sinks.mqtt.broker import parse
from gateway.sinks.mqtt.endpoints import Endpoint, Version
from gateway.sinks.mqtt.topics import MqttMessage
from tests.mqtt_endpoints import at

ROOT = Path(__file__).parents[3]
SOURCE = Path(inspect.getfile(broker_link)).read_text()


def test_the_library_is_pinned() -> None:
    pins = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert f"paho-mqtt=={version('paho-mqtt')}" in pins


def test_what_is_used_of_paho_is_there() -> None:
    assert set(re.findall(r"client\.(_\w+)", SOURCE)) == {"_create_socket_connection"}
    assert list(inspect.signature(paho.Client._create_socket_connection).parameters) == ["self"]


def test_the_client_uses_the_socket_it_is_given() -> None:
    """Else it would look the name up. A connection that ends before a CONNACK is not accepted."""

    async def scenario() -> None:
        ours, peer = socket.socketpair()
        ours.setblocking(False)
        with ours, peer:
            endpoint = Endpoint(parse("mqtt://never.looked.up.invalid"), (0, 0, 0, "", ("192.0.2.1", 1883)))
            client = broker_link._client(endpoint.broker, "c", MqttMessage("w", b""), "5")
            link = broker_link.BrokerLink(client, broker_link._BoundedSocket(ours), endpoint, "5")
            opening = asyncio.ensure_future(link.open(5, 5, "; a hint"))
            assert await asyncio.to_thread(peer.recv, 1) == b"\x10"  # CONNECT
            assert client.socket().fileno() == ours.fileno()  # type: ignore[union-attr]
            peer.close()
            with pytest.raises(broker_link.NotAcceptedError, match="before a CONNACK arrived; a hint"):
                await opening
            link.close()

    asyncio.run(scenario())


@pytest.mark.parametrize("version", ["5", "3.1.1"])
def test_a_packet_that_a_broker_announces_as_huge_ends_the_connection_and_takes_no_memory(
    version: Version,
) -> None:
    """A hostile broker raised the process's memory by 90 MiB with each: it was kept until it was complete."""

    async def scenario() -> None:
        sent = 0

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            nonlocal sent
            connect = await reader.read(1000)
            assert (b"\x27\x00\x01\x00\x00" in connect) == (version == "5")  # Maximum Packet Size
            writer.write(b"\x20\x02\x00\x00" if version == "3.1.1" else b"\x20\x03\x00\x00\x00")
            writer.write(b"\x30\xff\xff\xff\x7f\x00\x01x")  # PUBLISH of 268,435,455 bytes
            try:
                while sent < 50_000_000:
                    writer.write(bytes(60_000))
                    sent += 60_000
                    await writer.drain()
            except OSError:
                pass
            writer.transport.abort()

        async def listen(port: int) -> None:
            endpoint = at(f"mqtt://127.0.0.1:{port}")
            about = {"client_id": "c", "will": MqttMessage("w", b""), "keepalive_s": 5, "acknowledge_s": 5, "tls": None}
            async with broker_link.connect(endpoint, version=version, **about) as link:  # type: ignore[arg-type]
                async for _ in link.incoming():
                    pass

        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server, asyncio.timeout(30):
            with pytest.raises(LinkError, match="connection lost"):
                await listen(server.sockets[0].getsockname()[1])
        assert sent < 50_000_000

    asyncio.run(scenario())
