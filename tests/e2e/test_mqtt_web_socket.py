"""MQTT over WebSockets and through an HTTP proxy: against mosquitto's own listeners."""

import asyncio
import socket
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from gateway.config import MqttTls
from gateway.core.events import EventKind
from tests.e2e.brokers import Mosquitto, Subscriber, free_port
from tests.e2e.http_proxy import HttpProxy
from tests.e2e.mqtt_plant import Plant
from tests.plant_certs import Plant as Certificates

pytestmark = pytest.mark.timeout(120)
COUNT = 200


def listening(port: int) -> None:
    """Returns when it is; mosquitto opens its second listener after the first."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.02)
    raise AssertionError(f"nothing listens at {port}")


@asynccontextmanager
async def no_proxy() -> AsyncIterator[None]:
    yield


@pytest.mark.mostly_long(short=2)
@pytest.mark.parametrize("proxied", [False, True], ids=["direct", "through a proxy"])
@pytest.mark.parametrize("scheme", ["ws", "wss", "mqtts"])
@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
def test_every_event_arrives_in_order(tmp_path: Path, scheme: str, proxied: bool, protocol: str) -> None:
    made = Certificates(tmp_path / "certs")
    tls = made.folder.certificate_path("gateway"), made.folder.key_path("gateway")
    plain = Mosquitto(tmp_path)
    plain.port = free_port()  # of a second listener, for the subscriber
    lines = [*(["protocol websockets"] if scheme != "mqtts" else []), f"listener {plain.port} 127.0.0.1"]
    proxy = HttpProxy(user="gateway:s@fe")
    (tmp_path / "secret").write_text("s@fe\n")

    async def scenario(url: str) -> None:
        settings: dict[str, Any] = {"protocol": protocol}
        if scheme != "ws":
            settings["tls"] = MqttTls(ca_file=str(made.folder.certificate_path("ca")))
        async with proxy.running() if proxied else no_proxy():
            if proxied:
                settings |= {"proxy": proxy.url, "proxy_username": "gateway"}
                settings |= {"proxy_password_file": str(tmp_path / "secret")}
            plant = Plant(url, **settings)
            async with plant.running():
                for _ in range(COUNT):
                    plant.happen(EventKind.STOP_RAISED)
                await plant.until(lambda: plant.publisher.stats.queued == 0, 60)
            assert plant.link_errors == 0

    with Mosquitto(tmp_path, tls=None if scheme == "ws" else tls, lines=lines) as broker:
        target = f"127.0.0.1:{broker.port}"
        listening(plain.port)
        with Subscriber(plain, "loading/#") as subscriber:
            asyncio.run(scenario(f"{scheme}://{target}"))
            subscriber.wait_until(lambda: len(subscriber.on("/event")) == COUNT)
    assert [int(m.json["id"].split("-")[1]) for m in subscriber.on("/event")] == list(range(1, COUNT + 1))
    assert proxy.targets == ([target] if proxied else [])


@pytest.mark.parametrize(
    ("proxy", "fault"),
    [
        (HttpProxy(user="other:secret"), "requires a user and a password (mqtt.proxy_username), or refuses these"),
        (HttpProxy(status="502 Bad Gateway"), "does not connect to it: 'HTTP/1.1 502 Bad Gateway'"),
        (HttpProxy(status=""), "does not connect to it: 'HTTP/1.1 '"),
    ],
    ids=["credentials", "target", "nonsense"],
)
def test_a_proxy_that_does_not_connect_is_named(proxy: HttpProxy, fault: str) -> None:
    async def scenario() -> str:
        async with proxy.running():
            plant = Plant("mqtt://broker.example", proxy=proxy.url)
            async with plant.running():
                await plant.until(lambda: plant.link_errors >= 1, 30)
            return plant.publisher.link.fault

    found = asyncio.run(scenario())
    assert found == f"mqtt://broker.example:1883 through {proxy.url}: the proxy {proxy.url} {fault}"


@pytest.mark.parametrize(
    ("answer", "fault"),
    [
        (b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n", "no WebSocket: server rejected WebSocket connection"),
        (b"\x20\x02\x00\x00", "no WebSocket: "),
        (b"", "no WebSocket: "),
    ],
    ids=["refusal", "not HTTP", "closed"],
)
def test_what_is_no_web_socket_is_named(answer: bytes, fault: str) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(answer)
        writer.close()

    async def scenario() -> str:
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            plant = Plant(f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}")
            async with plant.running():
                await plant.until(lambda: plant.link_errors >= 1, 30)
            return plant.publisher.link.fault

    assert f"/mqtt: {fault}" in asyncio.run(scenario())
