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

from gateway.sinks.mqtt import broker_link
from gateway.sinks.mqtt.broker import parse
from gateway.sinks.mqtt.topics import Message

ROOT = Path(__file__).parents[3]
SOURCE = Path(inspect.getfile(broker_link)).read_text()
OVERRIDDEN = {  # of aiomqtt.Client, with their parameters
    "_client_connect": ["self"],
    "_on_connect": ["self", "client", "userdata", "flags", "reason_code", "properties"],
    "_on_disconnect": ["self", "client", "userdata", "flags", "reason_code", "properties"],
    "_on_publish": ["self", "client", "userdata", "mid", "reason_code", "properties"],
    "_on_socket_register_write": ["self", "client", "userdata", "sock"],
}
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
                will=Message("w", b""),
                keepalive_s=5,
                version="5",
            )
            assert client._client.socket() is ours
            assert client._client._max_inflight_messages == 20  # until a broker states fewer
            assert not client._connected.done()
            assert not client._disconnected.done()
            assert await asyncio.to_thread(peer.recv, 1) == b"\x10"  # CONNECT
            await client.close()

    asyncio.run(scenario())
