"""Brokers that are old, strict or choosy, and networks that are bad: nothing is lost, and the reason is told."""

import asyncio
import contextlib
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.config import MqttTls
from gateway.core.events import EventKind
from tests.e2e.brokers import Mosquitto, Received, Subscriber, program
from tests.e2e.mqtt_plant import Plant
from tests.e2e.tcp_proxy import NetworkConditions, Proxy

CONNECT, LEVEL_AT = 0x10, 8  # of a CONNECT whose remaining length has one or two bytes


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path) as broker:
        yield broker


def deliver(url: str, count: int, **settings: Any) -> Plant:
    """Runs a gateway until `count` events are acknowledged."""

    async def scenario() -> Plant:
        plant = Plant(url, **settings)
        async with plant.running():
            for _ in range(count):
                plant.happen(EventKind.STOP_RAISED)
            await plant.until(lambda: plant.publisher.stats.queued == 0, 60)
        return plant

    return asyncio.run(scenario())


def test_mqtt_5_tells_how_long_a_message_is_worth_something(broker: Mosquitto) -> None:
    with Subscriber(broker, "loading/#", args=("-V", "5", "-F", "| %r %q %t %E %C %p")) as subscriber:
        plant = deliver(broker.url, 3, event_expiry_h=1.5)
        events = [subscriber.wait_for(lambda m: m.topic.endswith("/event")), *subscriber.on("/event")]
        state = subscriber.wait_for(lambda m: m.topic.endswith("/state"))
        status = subscriber.wait_for(lambda m: m.topic.endswith("/status"))
    assert plant.link_errors == 0
    for message, expiry_s in ((events[0], 5400), (state, 3)):
        seconds, content_type, _ = message.text.split(" ", 2)
        assert int(seconds) in (expiry_s, expiry_s - 1)
        assert content_type == "application/json"
    assert status.text.split(" ", 1)[0] in ("", "application/json")  # whether it lives must not be forgotten


def ids(subscriber: Subscriber) -> list[str]:
    """Of the events so far, each once, in the order of their first arrival."""
    return list(dict.fromkeys(message.json["id"] for message in subscriber.on("/event")))


class OldBroker:
    """A context manager: a broker of MQTT 3.1.1 in front of mosquitto; what MQTT 5 is answered with is `answer`."""

    def __init__(self, target: int, answer: bytes) -> None:
        self._target, self._answer = target, answer
        self.levels: list[int] = []

    def __enter__(self) -> "OldBroker":
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                first = near.recv(4096)
                at = first.index(b"\x00\x04MQTT") + 6
                self.levels.append(first[at])
                if first[at] != 4:
                    near.sendall(self._answer)
                    near.close()
                    continue
                far = socket.create_connection(("127.0.0.1", self._target))
                far.sendall(first)
                for source, sink in ((near, far), (far, near)):
                    threading.Thread(target=_pump, args=(source, sink), daemon=True).start()


def _pump(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError), sink:
        while data := source.recv(4096):
            sink.sendall(data)


@pytest.mark.parametrize("answer", [b"\x20\x02\x00\x01", b""], ids=["refused", "hung up on"])
def test_a_broker_that_knows_only_311_gets_311(broker: Mosquitto, answer: bytes) -> None:
    with Subscriber(broker, "loading/#") as subscriber, OldBroker(broker.port, answer) as old:
        deliver(f"mqtt://127.0.0.1:{old.port}", 5)
        subscriber.wait_until(lambda: len(subscriber.on("/event")) == 5)
    assert old.levels[0] == 5
    assert old.levels[-1] == 4


def test_a_client_certificate_opens_the_door(tmp_path: Path) -> None:
    def openssl(*args: str) -> None:
        subprocess.run([program("openssl"), *args], check=True, capture_output=True, cwd=tmp_path)

    new = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256")
    openssl(
        "req", "-x509", *new, "-nodes", "-subj", "/CN=Plant CA", "-days", "2", "-keyout", "ca.key", "-out", "ca.pem"
    )
    (tmp_path / "san").write_text("subjectAltName=IP:127.0.0.1\n")
    (tmp_path / "secret").write_text("open sesame\n")
    for name, key in (("server", ("-nodes",)), ("client", ("-passout", "file:secret"))):
        openssl("req", *new, *key, "-subj", f"/CN={name}", "-keyout", f"{name}.key", "-out", f"{name}.csr")
        openssl(
            *("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial"),
            *("-days", "2", "-extfile", "san", "-out", f"{name}.pem"),
        )
    strict = ("require_certificate true", f"cafile {tmp_path / 'ca.pem'}")
    tls = tmp_path / "server.pem", tmp_path / "server.key"
    ours = MqttTls(
        ca_file=str(tmp_path / "ca.pem"),
        cert_file=str(tmp_path / "client.pem"),
        key_file=str(tmp_path / "client.key"),
        key_password_file=str(tmp_path / "secret"),
    )

    async def without(broker: Mosquitto) -> str:
        plant = Plant(broker.url, tls=MqttTls(ca_file=str(tmp_path / "ca.pem")))
        async with plant.running():
            await plant.until(lambda: plant.link_errors >= 1, 30)
        return plant.supervisor.records["deliver"].last_error

    with Mosquitto(tmp_path, tls=tls, lines=strict) as broker:
        assert deliver(broker.url, 5, tls=ours, unsubscribed_h=0).link_errors == 0
        assert asyncio.run(without(broker)).startswith(broker.url)


def test_two_gateways_with_one_client_id_throw_each_other_out_and_lose_nothing(broker: Mosquitto) -> None:
    async def scenario(subscriber: Subscriber) -> None:
        first, second = (Plant(broker.url, bay, instance=bay, client_id="same") for bay in ("bay1", "bay2"))
        async with second.running():
            async with first.running():
                await first.until(lambda: first.link_errors >= 2 and second.link_errors >= 2, 30)
                for _ in range(10):
                    first.happen(EventKind.STOP_RAISED, "bay1")
                    second.happen(EventKind.STOP_RAISED, "bay2")
                await first.until(lambda: first.publisher.stats.queued == 0, 60)
            await second.until(lambda: second.publisher.stats.queued == 0, 60)
        subscriber.wait_until(lambda: len(ids(subscriber)) == 20)

    with Subscriber(broker, "loading/#") as subscriber:
        asyncio.run(scenario(subscriber))


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    "conditions",
    [
        NetworkConditions(delay_s=0.03, jitter_s=0.03),
        NetworkConditions(bytes_per_s=60_000),
        NetworkConditions(cut_share=0.1),
    ],
    ids=["long delay", "low bandwidth", "interrupted"],
)
def test_over_a_bad_network_everything_arrives_in_order(broker: Mosquitto, conditions: NetworkConditions) -> None:
    with Subscriber(broker, "loading/#") as subscriber, Proxy(broker.port, conditions=conditions, seed=7) as proxy:
        deliver(f"mqtt://127.0.0.1:{proxy.port}", 60)
        subscriber.wait_until(lambda: len(ids(subscriber)) == 60)
        assert proxy.cuts > 0 or not conditions.cut_share
        assert [int(name.split("-")[1]) for name in ids(subscriber)] == list(range(1, 61))


def test_a_network_that_swallows_everything_is_noticed_and_nothing_is_lost(broker: Mosquitto) -> None:
    async def scenario(proxy: Proxy) -> None:
        plant = Plant(f"mqtt://127.0.0.1:{proxy.port}", keepalive_s=2)
        async with plant.running():
            await plant.until(lambda: plant.publisher.stats.published > 2)
            proxy.conditions = NetworkConditions(swallow=True)
            for _ in range(5):
                plant.happen(EventKind.STOP_RAISED)
            await plant.until(lambda: plant.link_errors >= 1, 30)
            assert plant.publisher.stats.queued == 5
            proxy.conditions = NetworkConditions()
            proxy.cut()
            await plant.until(lambda: plant.publisher.stats.queued == 0, 30)

    with Subscriber(broker, "loading/#") as subscriber, Proxy(broker.port) as proxy:
        asyncio.run(scenario(proxy))
        subscriber.wait_until(lambda: len(ids(subscriber)) == 5)


def test_home_assistant_finds_every_bay_retained(broker: Mosquitto) -> None:
    async def scenario() -> None:
        plant = Plant(broker.url, "bay1", "bay2", home_assistant=True, home_assistant_prefix="ha")
        async with plant.running():
            await plant.until(lambda: plant.publisher.stats.published >= 5, 30)

    asyncio.run(scenario())

    def at(topic: str) -> Callable[[Received], bool]:
        return lambda message: message.topic == topic

    with Subscriber(broker, "ha/#", "loading/#") as late:
        found = [late.wait_for(at(f"ha/device/loading_site1_{bay}/config")) for bay in ("bay1", "bay2")]
        for message, bay in zip(found, ("bay1", "bay2"), strict=True):
            assert message.retained
            assert late.wait_for(at(f"loading/site1/{bay}/state")).topic == message.json["state_topic"]
