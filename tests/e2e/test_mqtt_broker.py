"""The publisher against real brokers: mosquitto whole, killed, paused, refusing; and things that are no brokers."""

import asyncio
import contextlib
import gc
import logging
import os
import random
import re
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from gateway.config import Reconnect
from gateway.core.events import EventKind
from gateway.core.state import Reason
from gateway.errors import LinkError
from gateway.sinks.mqtt import broker_link
from gateway.sinks.mqtt.topics import MqttMessage
from tests.e2e.brokers import Mosquitto, Received, Subscriber, program
from tests.e2e.mqtt_plant import Plant
from tests.mqtt_endpoints import at
from tests.mqtt_messages import checked

pytestmark = pytest.mark.timeout(120)
ROOT = Path(__file__).parents[2]
QUICK = Reconnect(min_s=0.05, max_s=0.2)


@pytest.fixture(autouse=True)
def nothing_left_behind(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """No open socket, no error that nobody looked at."""
    gc.collect()
    sockets = len(psutil.Process().net_connections("all"))
    yield
    gc.collect()
    assert len(psutil.Process().net_connections("all")) <= sockets
    records = [*caplog.get_records("call"), *caplog.records]
    assert [record.getMessage() for record in records if record.name == "asyncio" and record.levelno > 20] == []


@pytest.fixture
def mosquitto(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path) as broker:
        yield broker


def first_of_each(subscriber: Subscriber) -> list[dict[str, Any]]:
    """The events, each once, by the rule of docs/mqtt.md: one whose id has arrived before is a repetition."""
    events: dict[str, dict[str, Any]] = {}
    for message in subscriber.on("/event"):
        event = checked(message.topic, message.text)
        events.setdefault(event["id"], event)
    return list(events.values())


def count_of(message: Received) -> int:
    return int(message.json["id"].split("-")[1])


def contains(**wanted: Any) -> Callable[[Received], bool]:
    return lambda message: wanted.items() <= message.json.items()


async def received(subscriber: Subscriber, timeout_s: float = 30.0, **wanted: Any) -> Received:
    return await asyncio.to_thread(subscriber.wait_for, contains(**wanted), timeout_s)


def test_a_late_subscriber_sees_the_retained_state_and_status(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        begun_ms = time.time() * 1000
        plant = Plant(mosquitto.url, "bay1", "bay2")
        async with plant.running():
            await plant.until(lambda: plant.publisher.stats.published >= 5)
            with Subscriber(mosquitto, "loading/#") as late:
                await asyncio.to_thread(late.wait_until, lambda: len(late.messages) >= 5)
            first = late.messages[:5]
            assert {message.topic for message in first} == {
                *(f"loading/site1/{bay}/{name}" for bay in ("bay1", "bay2") for name in ("state", "alarms")),
                "loading/site1/gw/status",
            }
            assert all(message.retained and message.qos == 1 for message in first)
            read_ms = time.time() * 1000
            for message in first:
                said = checked(message.topic, message.text)
                if message.topic.endswith("/state"):
                    assert said["reason"]["name"] == "STARTING"
                    assert said["status_topic"] == "loading/site1/gw/status"
                    assert begun_ms - 5 <= said["timestamp_ms"] <= read_ms + 5
                elif message.topic.endswith("/alarms"):
                    assert said["evaluated"] is False
                else:
                    assert said["status"] == "online"
                    assert said["bays"] == ["bay1", "bay2"]

    asyncio.run(scenario())


def test_a_change_of_stop_is_on_the_wire_at_once(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        plant = Plant(mosquitto.url, state_period_s=60)
        with Subscriber(mosquitto, "loading/#") as subscriber:
            async with asyncio.TaskGroup() as group:
                deliver = group.create_task(plant.publisher.deliver())
                await received(subscriber, status="online")
                plant.happen(EventKind.STOP_CLEARED, stop=False, may_move=True, reason=Reason.NONE)
                message = await received(subscriber, stop=False)  # the next one by its period would come after 60 s
                assert message.topic == "loading/site1/bay1/state"
                deliver.cancel()

    asyncio.run(scenario())


def test_no_event_is_lost_when_the_broker_is_killed(mosquitto: Mosquitto) -> None:
    """In the midst of a stream of events, while the subscriber is there: then what the broker has acknowledged, it has
    passed on. What it queues for an absent subscriber, mosquitto loses with a SIGKILL."""

    async def scenario() -> None:
        plant = Plant(mosquitto.url)
        randomly = random.Random(6)

        async def stream() -> None:
            while True:
                plant.happen(EventKind.STOP_RAISED if len(plant.happened) % 2 else EventKind.STOP_CLEARED)
                await asyncio.sleep(0.003)

        def caught_up() -> bool:
            return bool(subscriber.messages) and count_of(subscriber.messages[-1]) > len(plant.happened) - 10

        def complete() -> bool:
            return bool(subscriber.messages) and count_of(subscriber.messages[-1]) == len(plant.happened)

        with Subscriber(mosquitto, "loading/site1/+/event", session="records") as subscriber:
            mosquitto.stop()
            mosquitto.start()  # which knows the session now, whatever befalls it later
            async with plant.running():
                streaming = asyncio.get_running_loop().create_task(stream())
                for _ in range(4):
                    await asyncio.to_thread(subscriber.wait_until, caught_up, 30)
                    await asyncio.sleep(randomly.uniform(0.0, 0.02))
                    mosquitto.kill()
                    await asyncio.sleep(0.1)
                    await asyncio.to_thread(mosquitto.start)
                streaming.cancel()
                await asyncio.to_thread(subscriber.wait_until, complete, 30)
        events = first_of_each(subscriber)
        assert [int(event["id"].split("-")[1]) for event in events] == list(range(1, len(plant.happened) + 1))
        assert [event["kind"] for event in events] == plant.happened
        assert plant.publisher.stats.reconnects == 4
        assert plant.publisher.stats.dropped == 0
        assert plant.hardly_waited

    asyncio.run(scenario())


@pytest.mark.failure_mode("Q1")
def test_a_paused_broker_is_noticed_and_nothing_is_lost(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        plant = Plant(mosquitto.url, keepalive_s=2)
        with Subscriber(mosquitto, "loading/site1/+/event", session="records") as subscriber:
            async with plant.running():
                await plant.until(lambda: plant.publisher.stats.published >= 3)
                plant.waits.clear()
                mosquitto.pause()
                for _ in range(20):
                    plant.happen(EventKind.STOP_RAISED)
                await plant.until(lambda: plant.link_errors > 0)
                assert "no acknowledgement within 1.5 s" in plant.supervisor.records["deliver"].last_error
                await plant.tick(25, 5)  # into the next connection, which nobody answers
                assert plant.hardly_waited
                mosquitto.resume()
                await asyncio.to_thread(subscriber.wait_until, lambda: len(first_of_each(subscriber)) >= 20)
                await plant.until(lambda: plant.publisher.stats.queued == 0)
        assert [int(event["id"].split("-")[1]) for event in first_of_each(subscriber)] == list(range(1, 21))

    asyncio.run(scenario())


@contextlib.contextmanager
def process(url: str, before: str = "", close_s: float = 30.0) -> Iterator[subprocess.Popen[str]]:
    """The plant in a process of its own, running, killed at the end; it executes `before` first."""
    code = f"{before}\nimport asyncio\nfrom tests.e2e.mqtt_plant import main\nasyncio.run(main({url!r}, {close_s}))"
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        try:
            assert running.stdout is not None
            assert running.stdout.readline() == "running\n"
            yield running
        finally:
            running.kill()


@pytest.mark.failure_mode("Q4")
def test_the_broker_says_offline_when_the_gateway_is_killed(mosquitto: Mosquitto) -> None:
    with Subscriber(mosquitto, "loading/+/+/status") as subscriber, process(mosquitto.url) as gateway:
        online = subscriber.wait_for(contains(status="online"))
        gateway.kill()
        offline = subscriber.wait_for(contains(status="offline"))
        assert offline.json["cause"] == "connection lost"
        assert offline.json["boot"] == online.json["boot"]
        checked(offline.topic, offline.text)
        with Subscriber(mosquitto, "loading/+/+/status") as late:
            assert late.wait_for(contains(status="offline")).retained


def test_the_broker_says_offline_when_the_gateway_hangs(mosquitto: Mosquitto) -> None:
    with Subscriber(mosquitto, "loading/+/+/status") as subscriber, process(mosquitto.url) as gateway:
        subscriber.wait_for(contains(status="online"))
        gateway.send_signal(signal.SIGSTOP)
        # After 1.5 keepalives of 2 s; mosquitto looks every six seconds. By the usual keepalive it would take 90 s.
        offline = subscriber.wait_for(contains(status="offline"), 30)
        assert offline.json["cause"] == "connection lost"
        gateway.send_signal(signal.SIGCONT)
        subscriber.wait_for(
            lambda message: message.arrived_s > offline.arrived_s and contains(status="online")(message)
        )


def test_a_proper_end_leaves_stop_on_and_offline_behind(mosquitto: Mosquitto) -> None:
    with Subscriber(mosquitto, "loading/#") as subscriber, process(mosquitto.url) as gateway:
        subscriber.wait_for(contains(status="online"))
        gateway.terminate()
        assert gateway.communicate(timeout=20)[0] == "True\n"
        assert gateway.returncode == 0
        offline = subscriber.wait_for(contains(status="offline"))
        assert offline.json["cause"] == "shutdown"
        with Subscriber(mosquitto, "loading/#") as late:
            late.wait_until(lambda: {one.topic.rpartition("/")[2] for one in late.messages} >= {"state", "status"})
            left = {message.topic: checked(message.topic, message.text) for message in late.messages}
        assert left["loading/site1/gw/status"]["cause"] == "shutdown"
        state = left["loading/site1/bay1/state"]
        assert (state["stop"], state["may_move"], state["reason"]["name"]) == (True, False, "SHUTDOWN")
        time.sleep(0.2)
    assert [event["kind"] for event in first_of_each(subscriber)] == ["shutdown"]
    assert [m.json["cause"] for m in subscriber.on("/status")][-1] == "shutdown", "the broker has forgotten the will"


def test_a_cancelled_delivery_makes_the_broker_say_offline(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        plant = Plant(mosquitto.url)
        with Subscriber(mosquitto, "loading/+/+/status") as subscriber:
            async with plant.running():
                await received(subscriber, status="online")
            assert (await received(subscriber, status="offline")).json["cause"] == "connection lost"

    asyncio.run(scenario())


@contextlib.asynccontextmanager
async def linked(url: str) -> AsyncIterator[broker_link.BrokerLink]:
    will = MqttMessage("w", b"", retain=False)
    async with broker_link.connect(at(url), client_id="c", will=will, keepalive_s=5, acknowledge_s=5, tls=None) as live:
        yield live


def watched() -> int:
    """What the running loop waits for, besides its own wake-up: sockets, timers and other tasks."""
    loop: Any = asyncio.get_running_loop()
    timers = [timer for timer in loop._scheduled if not timer.cancelled()]
    return len(loop._selector.get_map()) - 1 + len(asyncio.all_tasks()) - 1 + len(timers)


def test_a_cancellation_that_comes_with_the_acknowledgement_is_not_lost(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        async with linked(mosquitto.url) as live:
            task = asyncio.get_running_loop().create_task(live.publish(MqttMessage("t", b"x", retain=False)))
            paho = live._client._client
            told = paho.on_publish
            assert told is not None

            def both(*args: Any) -> None:
                told(*args)
                task.cancel()

            paho.on_publish = both
            with pytest.raises(asyncio.CancelledError):
                await task

    asyncio.run(scenario())


def test_a_connection_that_was_cut_leaves_nothing_in_the_loop(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        with contextlib.suppress(ZeroDivisionError):
            async with linked(mosquitto.url):
                assert watched() >= 2
                raise ZeroDivisionError
        await asyncio.sleep(0)  # the library's housekeeping is cancelled, and ends with its next step
        await asyncio.sleep(0)
        assert watched() == 0

    asyncio.run(scenario())


def test_a_socket_that_closes_under_a_message_leaves_nothing_in_the_loop(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        with contextlib.suppress(LinkError):
            async with linked(mosquitto.url) as live:
                paho = live._client._client
                paho.publish("t", b"x", 1)
                paho._sock_close()  # as the library does when it reads the end, in the same step of the loop
                await live.publish(MqttMessage("t", b"x", retain=False))
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert watched() == 0

    asyncio.run(scenario())


def test_a_loss_that_nobody_watched_is_not_reported_as_forgotten(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        with contextlib.suppress(ZeroDivisionError):
            async with linked(mosquitto.url) as live:
                mosquitto.kill()
                await asyncio.wait([live._client._disconnected], timeout=5)
                raise ZeroDivisionError

    asyncio.run(scenario())  # the fixture looks at the log


def test_two_gateways_of_one_site_live_and_die_apart(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        north = Plant(mosquitto.url, "bay1", instance="north")
        south = Plant(mosquitto.url, "bay2", instance="south")
        with Subscriber(mosquitto, "loading/+/+/status") as subscriber:
            async with north.running():
                async with south.running():
                    await received(subscriber, status="online", instance="north")
                    await received(subscriber, status="online", instance="south")
                await received(subscriber, status="offline", instance="south")
                assert not any(contains(status="offline", instance="north")(message) for message in subscriber.messages)
                assert north.link_errors == 0

    asyncio.run(scenario())


USER, PASSWORD = "plant", "p@ss/w:rd%€"
QUOTED = "p%40ss%2Fw%3Ard%25%E2%82%AC"


def test_user_and_password_open_the_door_and_are_never_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def scenario(broker: Mosquitto, password: str) -> Plant:
        plant = Plant(broker.url.replace("//", f"//{USER}:{password}@"))
        async with plant.running():
            await plant.until(lambda: plant.publisher.stats.published >= 2 or plant.link_errors >= 2)
        return plant

    caplog.set_level(logging.DEBUG)
    logging.getLogger("mqtt").setLevel(logging.DEBUG)
    try:
        with Mosquitto(tmp_path, users={USER: PASSWORD}) as broker:
            assert asyncio.run(scenario(broker, QUOTED)).link_errors == 0
            refused = asyncio.run(scenario(broker, "hunter2")).supervisor.records["deliver"]
    finally:
        logging.getLogger("mqtt").setLevel(logging.NOTSET)
    assert refused.link_errors >= 2
    assert "ot authori" in refused.last_error
    for secret in (PASSWORD, QUOTED, "hunter2"):
        assert secret not in caplog.text
        assert secret not in refused.last_error


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Self-signed, for 127.0.0.1 only."""
    folder = tmp_path_factory.mktemp("tls")
    paths = folder / "certificate.pem", folder / "key.pem"
    subprocess.run(
        [
            *(program("openssl"), "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
            *("-subj", "/CN=test", "-addext", "subjectAltName=IP:127.0.0.1", "-days", "2"),
            *("-out", str(paths[0]), "-keyout", str(paths[1])),
        ],
        check=True,
        capture_output=True,
    )
    return paths


def test_tls_with_a_trusted_certificate(
    tmp_path: Path, certificate: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate[0]))  # the system's authorities, for OpenSSL

    async def scenario(url: str, subscriber: Subscriber) -> None:
        plant = Plant(url)
        async with plant.running():
            await received(subscriber, status="online")
            for _ in range(50):
                plant.happen(EventKind.STOP_RAISED)
            await plant.until(lambda: plant.publisher.stats.queued == 0)
            assert plant.link_errors == 0
            assert await plant.publisher.close(1.0) is True
        await received(subscriber, cause="shutdown")

    with Mosquitto(tmp_path, tls=certificate) as broker:
        args = ("--cafile", str(certificate[0]))
        with Subscriber(broker, "loading/#", args=args) as subscriber:
            asyncio.run(scenario(broker.url, subscriber))


@pytest.mark.parametrize("trusted", [False, True], ids=["untrusted", "of another host"])
def test_tls_with_a_wrong_certificate_is_refused(
    tmp_path: Path, certificate: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, trusted: bool
) -> None:
    if trusted:
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate[0]))

    async def scenario(url: str) -> None:
        plant = Plant(url.replace("127.0.0.1", "localhost") if trusted else url)
        with pytest.raises(
            LinkError, match=r"^mqtts://[\w.]+:\d+(?: \(127\.0\.0\.1\))?: its certificate is not trusted: "
        ):
            await plant.publisher.deliver()

    with Mosquitto(tmp_path, tls=certificate) as broker:
        asyncio.run(scenario(broker.url))


@contextlib.contextmanager
def silent_server(*, accepts: bool) -> Iterator[int]:
    """Takes connections and says nothing; or, with its queue full, does not even take them. Gives its port."""
    with contextlib.ExitStack() as held:
        server = held.enter_context(socket.socket())
        server.bind(("127.0.0.1", 0))
        server.listen(64 if accepts else 0)
        port: int = server.getsockname()[1]
        while not accepts:
            filler = held.enter_context(socket.socket())
            filler.settimeout(0.2)
            try:
                filler.connect(("127.0.0.1", port))
            except TimeoutError:
                break
        yield port


@contextlib.contextmanager
def false_broker(answer: bytes) -> Iterator[int]:
    """Answers every greeting with the same bytes, and keeps the connection open. Gives its port."""
    with contextlib.ExitStack() as held:
        server = held.enter_context(socket.create_server(("127.0.0.1", 0)))

        def serve() -> None:
            with contextlib.suppress(OSError):  # the end of the test
                while True:
                    peer = held.enter_context(server.accept()[0])
                    peer.recv(1)
                    peer.sendall(answer)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)  # wakes `accept`
        thread.join(10)


PATIENT = "from gateway.sinks.mqtt import broker_link; broker_link.CONNECT_S = 600.0"


@pytest.mark.mostly_long
@pytest.mark.parametrize("scheme", ["mqtt", "mqtts"])
@pytest.mark.parametrize("accepts", [True, False], ids=["silent", "unreachable"])
def test_the_process_ends_in_time_whatever_it_waits_for(scheme: str, accepts: bool) -> None:
    with silent_server(accepts=accepts) as port, process(f"{scheme}://127.0.0.1:{port}", PATIENT, 1.0) as gateway:
        time.sleep(0.3)  # into the attempt to connect
        gateway.terminate()
        out, err = gateway.communicate(timeout=30)  # closing has 1 s; waiting for the broker would take 600
    assert (out, gateway.returncode) == ("False\n", 0)
    assert "Traceback" not in err


SILENT_NAME_SERVER = """
import socket, time
true = socket.getaddrinfo
def slow(host, port, *args, **kwargs):
    if not kwargs.get("flags"):
        time.sleep(600)
    return true(host, port, *args, **kwargs)
socket.getaddrinfo = slow
"""


def test_the_process_ends_in_time_when_no_name_server_answers() -> None:
    with process("mqtt://broker.example", SILENT_NAME_SERVER, 1.0) as gateway:
        time.sleep(0.3)
        gateway.terminate()
        out, _ = gateway.communicate(timeout=30)  # closing has 1 s; waiting for the name would take 600
    assert (out, gateway.returncode) == ("False\n", 0)


def test_closing_to_a_paused_broker_ends_in_time_and_the_will_follows(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        plant = Plant(mosquitto.url, keepalive_s=600)
        with Subscriber(mosquitto, "loading/+/+/status") as subscriber:
            async with plant.running():
                await received(subscriber, status="online")
                mosquitto.pause()
                async with asyncio.timeout(20):  # waiting for an acknowledgement would take 450
                    assert await plant.publisher.close(0.5) is False
            mosquitto.resume()
            await received(subscriber, status="offline")

    asyncio.run(scenario())


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
        b"\x20\x02\x00\x05",
        b"\x20\x00",
        b"\xff" * 100,
        b"\x30\xff\xff\xff\x7f",
    ],
    ids=["nothing", "http", "refusal", "short greeting", "noise", "huge packet"],
)
def test_what_is_no_broker_is_a_link_error(answer: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(broker_link, "CONNECT_S", 0.5)

    async def scenario(port: int) -> None:
        plant = Plant(f"mqtt://127.0.0.1:{port}")
        for _ in range(2):
            with pytest.raises(LinkError, match=rf"^mqtt://127\.0\.0\.1:{port}: "):
                await plant.publisher.deliver()
        assert await plant.publisher.close(0.7) is False

    with false_broker(answer) as port:
        asyncio.run(scenario(port))


@pytest.mark.parametrize("host", ["no-such-host.invalid", "x" * 64 + ".invalid"])
def test_a_name_that_leads_nowhere_is_a_link_error(host: str) -> None:
    async def scenario() -> None:
        with pytest.raises(LinkError, match=rf"^mqtt://{host}:1883: ."):
            await Plant(f"mqtt://{host}").publisher.deliver()

    asyncio.run(scenario())


def test_a_name_is_looked_up(mosquitto: Mosquitto) -> None:
    async def scenario() -> None:
        plant = Plant(f"mqtt://localhost:{mosquitto.port}")
        assert await plant.publisher.close(5.0) is True

    asyncio.run(scenario())


def commands() -> list[str]:
    return re.findall(r"^mosquitto_\w+ .*$", (ROOT / "docs" / "mqtt.md").read_text(), re.MULTILINE)


def test_the_page_has_commands_to_try() -> None:
    assert len(commands()) == 3


@pytest.mark.parametrize("command", commands())
def test_the_commands_of_the_page_work(mosquitto: Mosquitto, command: str) -> None:
    async def scenario() -> str:
        name, *args = shlex.split(command)
        assert args[:2] == ["-h", "broker"]
        args[1] = "127.0.0.1"
        if "-W" in args:
            args[args.index("-W") + 1] = "2"
        plant = Plant(mosquitto.url, state_period_s=0.2, instance="gateway")
        async with plant.running():
            await plant.until(lambda: plant.publisher.stats.published >= 2)
            ran = await asyncio.create_subprocess_exec(
                program(name), "-p", str(mosquitto.port), *args, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
            ended = asyncio.get_running_loop().create_task(ran.communicate())
            while not ended.done():  # it may take a while to come up
                plant.happen(EventKind.STOP_RAISED)
                await asyncio.sleep(0.02)
            out, err = await ended
        # 27: mosquitto_sub's word for "the time of -W is over".
        assert ran.returncode in ((0, 27) if "-W" in args else (0,)), err
        return out.decode()

    out = asyncio.run(scenario())
    if command.startswith("mosquitto_sub"):
        for line in out.splitlines():
            assert re.search(r'(^|\S+ )\{"schema_version":1,', line)
        assert len(out.splitlines()) >= (2 if "-C 2" in command or "-W" in command else 1)


def test_a_broker_is_searched_for_where_debian_keeps_it() -> None:
    assert os.access(program("mosquitto"), os.X_OK)
