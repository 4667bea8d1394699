"""What is used of the MQTT client libraries beyond their public interface: an upgrade fails here, not in a plant."""

import asyncio
import inspect
import re
import socket
import tomllib
from importlib.metadata import version
from pathlib import Path

import aiomqtt
import paho.mqtt.client as paho
import pytest

from gateway.errors import LinkError
from gateway.sinks.mqtt import broker_link
from gateway.sinks.mqtt.broker import parse
from gateway.sinks.mqtt.endpoints import Version
from gateway.sinks.mqtt.topics import MqttMessage
from tests.mqtt_endpoints import at

ROOT = Path(__file__).parents[3]
SOURCE = Path(inspect.getfile(broker_link)).read_text()
OVERRIDDEN = {"_client_connect": ["self"]}  # of aiomqtt.Client, with their parameters
USED_OF_AIOMQTT = ["_client", "_connected", "_disconnected", "_loop", "_misc_loop", "_misc_task"]
USED_OF_PAHO = ["_create_socket_connection", "_max_inflight_messages", "_sock_close"]


@pytest.mark.parametrize("package", ["aiomqtt", "paho-mqtt"])
def test_the_libraries_are_pinned(package: str) -> None:
    pins = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert f"{package}=={version(package)}" in pins


def test_what_is_overridden_of_aiomqtt_exists_with_the_same_parameters() -> None:
    private = [name for name in vars(broker_link._Client) if name.startswith("_") and not name.startswith("__")]
    assert sorted(private) == sorted(OVERRIDDEN)
    for name, parameters in OVERRIDDEN.items():
        assert list(inspect.signature(getattr(aiomqtt.Client, name)).parameters) == parameters


def test_what_is_used_of_aiomqtts_attributes_is_there() -> None:
    ours = {"_answers", "_given", "_told", "_link", "_waited"}
    of_client = SOURCE[SOURCE.index("class _Client") :]
    assert sorted(set(re.findall(r"self\.(_[a-z]\w*)", of_client)) - ours) == USED_OF_AIOMQTT
    text = inspect.getsource(aiomqtt.Client)
    assert [name for name in USED_OF_AIOMQTT if f"self.{name}" not in text] == []


def test_what_is_used_of_paho_is_there() -> None:
    assert sorted(set(re.findall(r"self\._client\.(_\w+)", SOURCE))) == USED_OF_PAHO
    assert list(inspect.signature(paho.Client._create_socket_connection).parameters) == ["self"]
    assert list(inspect.signature(paho.Client._sock_close).parameters) == ["self"]


def test_the_client_uses_the_socket_it_is_given() -> None:
    """Without the override it would look the name up."""

    async def scenario() -> None:
        ours, peer = socket.socketpair()
        ours.setblocking(False)
        with ours, peer:
            client = broker_link._Client(
                ours,
                parse("mqtt://never.looked.up.invalid"),
                client_id="c",
                will=MqttMessage("w", b""),
                keepalive_s=5,
                version="5",
            )
            assert client._client.socket().fileno() == ours.fileno()  # type: ignore[union-attr]
            assert client._client._max_inflight_messages == broker_link.MAX_IN_FLIGHT  # until a broker states fewer
            assert not client._connected.done()
            assert not client._disconnected.done()
            assert await asyncio.to_thread(peer.recv, 1) == b"\x10"  # CONNECT
            await client.close()

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


def test_more_retained_messages_than_the_queue_holds_arrive_all() -> None:
    """As after a subscription to the statuses of a fleet: aiomqtt reads three while it hands over one."""
    sent = 10 * broker_link.MAX_INCOMING

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1000)
        writer.write(b"\x20\x02\x00\x00")
        for n in range(sent):  # PUBLISH, every other one retained
            writer.write(bytes([0x30 + n % 2, 3 + 100]) + b"\x00\x01t" + b"%100d" % n)
        await writer.drain()
        await reader.read()
        writer.close()

    async def scenario() -> None:
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server, asyncio.timeout(30):
            endpoint = at(f"mqtt://127.0.0.1:{server.sockets[0].getsockname()[1]}")
            about = {"client_id": "c", "will": None, "keepalive_s": 5, "acknowledge_s": 5, "tls": None}
            async with broker_link.connect(endpoint, **about) as link:  # type: ignore[arg-type]
                found = []
                async for message in link.incoming():
                    found.append((int(message.payload), message.retain))
                    if len(found) == sent:
                        break
                assert found == [(n, n % 2 == 1) for n in range(sent)]
                assert not link.overflowed

    asyncio.run(scenario())
