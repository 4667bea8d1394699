"""Events that nobody subscribed to, topics that the broker refuses, links with a long round trip: against mosquitto."""

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.core.events import EventKind
from gateway.sinks.mqtt import topic_answers
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.mqtt_packets import Tap
from tests.e2e.mqtt_plant import Plant
from tests.e2e.tcp_proxy import NetworkConditions, Proxy

SETTLED_S = 1.0  # long enough for what must not happen


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path) as broker:
        yield broker


def counts(subscriber: Subscriber, bay: str = "bay1") -> list[int]:
    """Numbers of the events of a bay so far, each once, in the order of their first arrival."""
    found = (message.json["id"] for message in subscriber.on(f"{bay}/event"))
    return [int(name.split("-")[1]) for name in dict.fromkeys(found)]


@pytest.mark.failure_mode("Q5")
def test_an_event_that_nobody_had_subscribed_to_arrives_once_somebody_does(broker: Mosquitto) -> None:
    """Bay 2 has a subscriber all the time, and is not held up."""

    async def scenario(other: Subscriber) -> None:
        plant = Plant(broker.url, "bay1", "bay2")
        async with plant.running():
            for _ in range(5):
                plant.happen(EventKind.STOP_RAISED, "bay1")
                plant.happen(EventKind.STOP_RAISED, "bay2")
            await asyncio.to_thread(other.wait_until, lambda: len(counts(other, "bay2")) == 5)
            await asyncio.sleep(SETTLED_S)
            assert plant.publisher.link.figures["events_held"] == 5
            with Subscriber(broker, "loading/+/bay1/event") as late:
                await plant.until(lambda: len(counts(late)) == 5, 40)
                assert counts(late) == [1, 3, 5, 7, 9]
                await plant.until(lambda: plant.publisher.link.figures["events_held"] == 0)
        assert plant.link_errors == 0

    with Subscriber(broker, "loading/+/bay2/event") as other:
        asyncio.run(scenario(other))
    assert counts(other, "bay2") == [2, 4, 6, 8, 10]


def test_a_broker_that_forgets_its_sessions_when_it_is_killed_loses_no_event(broker: Mosquitto) -> None:
    """It saves them when it ends properly, and every half hour; the subscriber is back later than the gateway."""

    async def scenario(subscriber: Subscriber) -> None:
        plant = Plant(broker.url)
        async with plant.running():
            for _ in range(3):
                for _ in range(10):
                    plant.happen(EventKind.STOP_RAISED)
                    await asyncio.sleep(0.02)
                before = plant.publisher.stats.reconnects
                await asyncio.to_thread(broker.kill)
                await asyncio.to_thread(broker.start)
                await plant.until(lambda before=before: plant.publisher.stats.reconnects > before)  # type: ignore[misc]
                for _ in range(5):
                    plant.happen(EventKind.STOP_RAISED)
                    await asyncio.sleep(0.02)
                await plant.until(lambda: plant.publisher.stats.queued == 0, 60)

    with Subscriber(broker, "loading/+/+/event", session="records") as subscriber:
        asyncio.run(scenario(subscriber))
        subscriber.wait_until(lambda: len(counts(subscriber)) == 45)
        assert counts(subscriber) == list(range(1, 46))


@pytest.mark.long
@pytest.mark.failure_mode("Q6")
def test_an_acl_that_denies_events_alone_leaves_the_rest_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mosquitto 2.0.11 ends the connection after such a refusal, later ones don't."""
    monkeypatch.setattr(topic_answers, "CUT_RETRY_S", (4.0, 4.0))
    closed, wide = tmp_path / "closed", tmp_path / "wide"
    allowed = [f"topic readwrite loading/+/+/{name}\n" for name in ("state", "status", "alarms")]
    closed.write_text("".join(allowed) + "topic read loading/#\n")
    wide.write_text("topic readwrite loading/#\n")

    async def scenario(broker: Mosquitto, subscriber: Subscriber) -> None:
        plant = Plant(broker.url, state_period_s=0.1)
        async with plant.running():
            for _ in range(3):
                plant.happen(EventKind.STOP_RAISED)
            await plant.until(lambda: plant.publisher.link.alarms.get("messages_refused"))
            told = plant.publisher.link.alarms["messages_refused"]
            await asyncio.sleep(SETTLED_S)
            states = len(subscriber.on("/state"))
            await asyncio.sleep(SETTLED_S)
            assert len(subscriber.on("/state")) >= states + 5
            assert plant.publisher.stats.queued == 3
            assert plant.link_errors <= 1
            assert "loading/site1/bay1/event" in told
            assert "ot authorized" in told
            assert "0x87" in told
            broker.reload(f"acl_file {wide}")
            await plant.until(lambda: len(counts(subscriber)) == 3, 40)
            assert counts(subscriber) == [1, 2, 3]
            await plant.until(lambda: not plant.publisher.link.alarms.get("messages_refused"))

    with Mosquitto(tmp_path, lines=[f"acl_file {closed}"]) as broker, Subscriber(broker, "loading/#") as subscriber:
        asyncio.run(scenario(broker, subscriber))


@pytest.mark.failure_mode("Q7")
def test_an_announcement_that_is_too_large_for_the_broker_is_not_sent(tmp_path: Path) -> None:
    """Home Assistant's is 5.9 kB, a state 2.1 kB. Mosquitto ends the connection on a larger packet."""

    async def scenario(broker: Mosquitto, subscriber: Subscriber) -> None:
        plant = Plant(broker.url, home_assistant=True, state_period_s=0.1)
        async with plant.running():
            plant.happen(EventKind.STOP_RAISED)
            await plant.until(lambda: plant.publisher.link.alarms.get("messages_refused"))
            await plant.until(lambda: len(subscriber.on("/state")) >= 10)
            await plant.until(lambda: len(counts(subscriber)) == 1)
            link = plant.publisher.link
            assert "homeassistant/device/loading_site1_bay1/config" in link.alarms["messages_refused"]
            assert "the broker accepts 4000" in link.alarms["messages_refused"]
            assert link.figures["refused"] == 1
        assert plant.link_errors == 0

    with (
        Mosquitto(tmp_path, lines=["max_packet_size 4000"]) as broker,
        Subscriber(broker, "loading/#", args=("-V", "5")) as subscriber,
    ):
        asyncio.run(scenario(broker, subscriber))


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
def test_over_a_long_round_trip_several_events_are_on_their_way_at_once(broker: Mosquitto, protocol: str) -> None:
    """One after the other 100 events took 10 s."""

    async def scenario(port: int) -> None:
        plant = Plant(f"mqtt://127.0.0.1:{port}", protocol=protocol)
        async with plant.running():
            for _ in range(100):
                plant.happen(EventKind.STOP_RAISED)
            await plant.until(lambda: plant.publisher.stats.queued == 0, 60)
        assert plant.link_errors == 0

    with (
        Subscriber(broker, "loading/#") as subscriber,
        Proxy(broker.port, conditions=NetworkConditions(delay_s=0.05)) as slow,
        Tap(slow.port) as tap,
    ):
        asyncio.run(scenario(tap.port))
        subscriber.wait_until(lambda: len(counts(subscriber)) == 100)
        sent = waiting = most = 0
        for packet in list(tap.packets):
            if packet.kind == "PUBLISH" and packet.topic.endswith("/event"):
                sent, waiting = sent + 1, waiting + 1
                most = max(most, waiting)
            elif packet.kind == "PUBACK":
                waiting = max(0, waiting - 1)
    assert counts(subscriber) == list(range(1, 101))
    assert sent == 100
    assert most >= 10
