"""Is every stop transition delivered, whoever is killed? The real publisher, outbox, fusion and broker; and a count.

A child process is a gateway less its sensors: two bays whose D flips as fast as asked, through the real fusion, hub,
outbox and MQTT client. It writes the id of each event to its standard output once the event has happened. The parent
kills the child, and the broker, at random moments with SIGKILL, and compares what was reported with what a subscriber
received and with what the broker acknowledged on the wire: what an acknowledging broker forgets is counted apart.

The gateway reaches the broker through a proxy that lets it in only while the subscriber is connected: mosquitto hands a
message on before it acknowledges it, but a killed one forgets what it held for a subscriber that was away.
"""

import asyncio
import itertools
import os
import random
import shutil
import signal
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import uuid4

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from gateway import shared_state
from gateway.bay import BayControl
from gateway.clock import SystemClock
from gateway.config import BayConfig, FusionConfig, GatewayConfig, MqttConfig, Reconnect
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.hub import Hub
from gateway.sinks.mqtt.publisher import MqttPublisher
from gateway.sinks.outbox.durable import DurableOutbox
from gateway.sinks.outbox.outbox import Outbox, OutboxEntry, OutboxLimits
from gateway.supervisor import Supervisor, Task
from tests.e2e.brokers import Mosquitto
from tests.e2e.mqtt_packets import Stream
from tests.e2e.tcp_proxy import NetworkConditions, Proxy
from tests.sink_context import sink_context

Gateway = tuple[subprocess.Popen[str], threading.Thread]  # and who reads what it tells

BAYS = ("bay1", "bay2")
NO_PROGRESS_S = 10.0
MODULE = "tests.e2e.store_and_forward"
ROOT = Path(__file__).resolve().parents[2]


# The child.


class ReportingOutbox(DurableOutbox):
    """Tells of an entry once it has been taken, in one write that the system keeps whole."""

    def put(self, entry: OutboxEntry) -> None:
        super().put(entry)
        os.write(1, f"{entry.id} {entry.topic.split('/')[2]} {int(entry.drop_last)}\n".encode())


SinkOf = Callable[[Hub, SystemClock, Outbox, Reconnect], Callable[[], Awaitable[None]]]


async def child(deliver_of: SinkOf, name: str, file: str, per_s: float) -> None:
    clock, hub, reconnect = SystemClock(), Hub(BAYS), Reconnect(min_s=0.02, max_s=0.1)
    plain = FusionConfig(decision="plain")  # a stop at every step
    whole = GatewayConfig(bays=tuple(BayConfig(name=bay, unit_id=n + 1, fusion=plain) for n, bay in enumerate(BAYS)))
    with ReportingOutbox(name, Path(file), OutboxLimits(100_000)) as outbox:
        deliver = deliver_of(hub, clock, outbox, reconnect)
        controls = [BayControl(bay, hub, clock, (), whole) for bay in whole.bays]

        async def flip() -> None:
            near = False
            while True:
                near = not near
                for control in controls:
                    now_ns = clock.now_ns()
                    control.on_reading(RangeReading(now_ns, Quality.GOOD, 250.0))
                    control.on_reading(VisionReading(now_ns, Quality.GOOD, Circle(1, 2, 200 if near else 100)))
                await clock.sleep(len(controls) / per_s)

        tasks = [Task(f"{control.name}.control", control.run, vital=True) for control in controls]
        tasks += [Task("flip", flip), Task("deliver", deliver, reconnect)]
        await Supervisor(tasks, clock).run()


def to_brokers(*urls: str) -> SinkOf:
    def deliver_of(hub: Hub, clock: SystemClock, outbox: Outbox, reconnect: Reconnect) -> Callable[[], Awaitable[None]]:
        config = MqttConfig(urls=urls, keepalive_s=4, reconnect=reconnect)
        return MqttPublisher(sink_context(config, hub, clock, site="site1"), outbox=outbox).deliver

    return deliver_of


# The parent.


@dataclass
class Report:
    transitions: int = 0  # changes of stop that were reported of
    events: int = 0  # all events that were reported of
    received: int = 0  # different ones
    duplicates: int = 0
    lost: list[str] = field(default_factory=list)  # reported of, never acknowledged by a broker, never received
    forgotten: int = 0  # acknowledged by a broker that was killed before it had passed them on
    out_of_order: list[str] = field(default_factory=list)
    broker_kills: int = 0
    gateway_kills: int = 0
    seconds: float = 0.0


@dataclass
class ReportedEvents:
    """The events that the children reported, in order."""

    ids: list[tuple[str, str, bool]] = field(default_factory=list)  # id, bay, precious
    boots: list[str] = field(default_factory=list)

    def add(self, line: str) -> None:
        name, bay, precious = line.split()
        boot = name.split("-")[0]
        if boot not in self.boots:
            self.boots.append(boot)
        self.ids.append((name, bay, precious == "1"))

    @property
    def transitions(self) -> int:
        return sum(precious for _, _, precious in self.ids)


class AcknowledgedEvents:
    """What the broker has acknowledged, read off the wire."""

    def __init__(self) -> None:
        self.acknowledged: set[str] = set()
        self._streams: dict[tuple[int, bool], Stream] = {}
        self._on_the_way: dict[tuple[int, int], str] = {}

    def on_data(self, connection: int, out: bool, data: bytes) -> None:
        level = self._streams[connection, not out].level if (connection, not out) in self._streams else [4]
        stream = self._streams.setdefault((connection, out), Stream(out, connection, level))
        for packet in stream.feed(data):
            key = (connection, packet.mid)
            if packet.kind == "PUBLISH" and packet.topic.endswith("/event"):
                self._on_the_way[key] = _id_of(packet.payload)
            elif packet.kind == "PUBACK" and key in self._on_the_way:
                self.acknowledged.add(self._on_the_way.pop(key))


def _id_of(payload: bytes | bytearray) -> str:
    return bytes(payload).split(b'"id":"', 1)[1].split(b'"', 1)[0].decode()


class RecordingSubscriber:
    """A subscriber with a session; connects again at once, each time to the next of `hosts`."""

    def __init__(
        self,
        port: int,
        hosts: Sequence[str] = ("127.0.0.1",),
        keepalive_s: int = 60,
        topics: Sequence[str] = ("loading/+/+/event",),
        tls: ssl.SSLContext | None = None,
    ) -> None:
        self.got: list[tuple[str, str]] = []  # id, bay
        self.arrived_s: list[float] = []  # of each; time.monotonic()
        self.connected = threading.Event()
        self._port, self._hosts, self._keepalive_s = port, itertools.cycle(hosts), keepalive_s
        self._topics = [(topic, 1) for topic in topics]
        self._closing = False
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, "records", clean_session=False)
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = lambda *_: self._next_host()
        self._client.on_disconnect = lambda *_: self._next_host()
        self._client.on_subscribe = lambda *_: self.connected.set()
        self._client.on_message = self._on_message
        self._client.reconnect_delay_set(0.02, 0.05)  # type: ignore[arg-type]  # it only sleeps this long
        if tls is not None:
            self._client.tls_set_context(tls)
        self._next_host()
        self._client.loop_start()

    def _next_host(self) -> None:
        self.connected.clear()
        if not self._closing:
            self._client.connect_async(next(self._hosts), self._port, self._keepalive_s)

    def _on_connect(self, client: mqtt.Client, _: Any, __: Any, reason: Any, ___: Any) -> None:
        if not reason.is_failure:
            client.subscribe(self._topics)

    def _on_message(self, _: mqtt.Client, __: Any, message: mqtt.MQTTMessage) -> None:
        self.got.append((_id_of(message.payload), message.topic.split("/")[2]))
        self.arrived_s.append(time.monotonic())

    def close(self) -> None:
        self._closing = True
        self._client.disconnect()
        self._client.loop_stop()


def run(
    folder: Path,
    *,
    transitions: int,
    broker_kills: int,
    gateway_kills: int,
    per_s: float,
    seed: int,
    progress: Callable[[Report], None] = lambda _: None,
) -> Report:
    """Until so many transitions were reported of and so many kills done; then until everything is delivered."""
    randomly, report, reported = random.Random(seed), Report(), ReportedEvents()
    begun = time.monotonic()
    name, file = f"test-{uuid4().hex}", folder / "outbox.sqlite"
    with Mosquitto(folder) as broker, Proxy(broker.port, conditions=NetworkConditions(refuse=True)) as proxy:
        records, acknowledged_events = RecordingSubscriber(broker.port), AcknowledgedEvents()
        url = f"mqtt://127.0.0.1:{proxy.port}"
        proxy.on_data = acknowledged_events.on_data
        try:
            _admit(records, proxy)
            broker.stop()  # once: it remembers the subscription from now on
            broker.start()
            _admit(records, proxy)
            gateway = start(MODULE, url, name, file, per_s, reported)
            while (
                reported.transitions < transitions
                or report.broker_kills < broker_kills
                or report.gateway_kills < gateway_kills
            ):
                time.sleep(randomly.uniform(0.0, 0.3))
                left_b, left_g = broker_kills - report.broker_kills, gateway_kills - report.gateway_kills
                if left_b + left_g and randomly.random() * (left_b + left_g) < left_g:
                    gateway[0].send_signal(signal.SIGKILL)
                    wait(gateway)
                    report.gateway_kills += 1
                    gateway = start(MODULE, url, name, file, per_s, reported)
                elif left_b:
                    broker.kill()
                    records.connected.clear()  # it hears of it later, and must not be taken for subscribed till then
                    proxy.conditions = NetworkConditions(refuse=True)
                    proxy.cut()
                    report.broker_kills += 1
                    time.sleep(randomly.uniform(0.0, 0.1))
                    broker.start()
                    _admit(records, proxy)
                report.transitions, report.events = reported.transitions, len(reported.ids)
                progress(report)
            gateway[0].send_signal(signal.SIGKILL)
            wait(gateway)
            report.gateway_kills += 1
            deliver_the_rest(MODULE, url, name, file, reported, records)
        finally:
            records.close()
            shutil.rmtree(
                shared_state.folder() / f"loading-gateway-journal.{name}", ignore_errors=True
            )  # of a killed one
    report.seconds = time.monotonic() - begun
    return judge(report, reported, records.got, acknowledged_events.acknowledged)


def _admit(records: RecordingSubscriber, proxy: Proxy) -> None:
    assert records.connected.wait(20)
    proxy.conditions = NetworkConditions()


def start(
    module: str, url: str, name: str, file: Path, per_s: float, reported: ReportedEvents, *more: str
) -> tuple[subprocess.Popen[str], threading.Thread]:
    """A child that runs `module`; what it reports is added to `reported`."""
    process = subprocess.Popen(
        [sys.executable, "-m", module, url, name, str(file), str(per_s), *more],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    first = process.stdout.readline()
    assert first, "the gateway did not start"
    reported.add(first)

    def read() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            reported.add(line)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    return process, reader


def wait(gateway: Gateway) -> None:
    process, reader = gateway
    process.wait(20)
    reader.join(20)
    assert process.stdout is not None
    process.stdout.close()


def deliver_the_rest(
    module: str,
    url: str,
    name: str,
    file: Path,
    reported: ReportedEvents,
    records: RecordingSubscriber,
    no_progress_s: float = NO_PROGRESS_S,
) -> None:
    """One more start, which makes hardly any events, until nothing is missing or nothing gets better any more."""
    gateway = start(module, url, name, file, 0.2, reported)
    try:
        fewest, since = len(reported.ids) + 1, time.monotonic()
        while (missing := len({i for i, _, _ in reported.ids} - {i for i, _ in records.got})) and (
            time.monotonic() - since < no_progress_s
        ):
            if missing < fewest:
                fewest, since = missing, time.monotonic()
            time.sleep(0.05)
    finally:
        gateway[0].send_signal(signal.SIGKILL)
        wait(gateway)


def judge(report: Report, reported: ReportedEvents, got: list[tuple[str, str]], acknowledged: set[str]) -> Report:
    report.transitions, report.events = reported.transitions, len(reported.ids)
    seen = {name for name, _ in got}
    report.received, report.duplicates = len(seen), len(got) - len(seen)
    # The very last events, of the start that only delivers, may still be on their way.
    missing = [name for name, _, _ in reported.ids if name not in seen and not name.startswith(reported.boots[-1])]
    report.lost = [name for name in missing if name not in acknowledged]
    report.forgotten = len(missing) - len(report.lost)
    for bay in BAYS:
        highest, known = (-1, 0), set()
        for name, where in got:
            boot, number = name.split("-")
            if where != bay or name in known or boot not in reported.boots:
                continue
            known.add(name)
            place = (reported.boots.index(boot), int(number))
            if place <= highest:
                report.out_of_order.append(name)
            highest = max(highest, place)
    return report


if __name__ == "__main__":
    asyncio.run(child(to_brokers(sys.argv[1]), sys.argv[2], sys.argv[3], float(sys.argv[4])))
