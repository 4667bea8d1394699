"""What is used of the MQTT client library beyond its public interface."""

import inspect
import re
import socket
import tomllib
from importlib.metadata import version
from pathlib import Path

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from gateway.sinks.mqtt import broker_link

ROOT = Path(__file__).parents[3]


def test_one_private_method_of_paho_is_overridden_and_its_version_is_pinned() -> None:
    """An upgrade that renames it, calls it otherwise or no longer calls it must fail here, not in a plant."""
    private = [name for name in vars(broker_link._Client) if name.startswith("_") and not name.startswith("__")]
    assert private == ["_create_socket_connection"]
    signature = inspect.signature(paho.Client._create_socket_connection)
    assert list(signature.parameters) == ["self"]
    source = Path(inspect.getfile(broker_link)).read_text()
    assert re.findall(r"self\._client\.(_\w+)", source) == []
    pins = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert f"paho-mqtt=={version('paho-mqtt')}" in pins


def test_paho_connects_on_the_socket_that_the_method_returns() -> None:
    ours, peer = socket.socketpair()

    class Client(paho.Client):
        def _create_socket_connection(self) -> socket.socket:
            return ours

    with ours, peer:
        client = Client(CallbackAPIVersion.VERSION2, "c")
        client.connect("never.looked.up.invalid", 1883)
        assert client.socket() is ours
        assert peer.recv(1) == b"\x10"  # CONNECT
