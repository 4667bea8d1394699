"""Three brokers of which one hangs: the others are used, the preferred one again later, and no event is lost."""

import asyncio
import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.core.events import EventKind
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.mqtt_plant import Plant
from tests.mqtt_messages import checked

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def nodes(tmp_path: Path) -> Iterator[list[Mosquitto]]:
    with contextlib.ExitStack() as stack:
        found = []
        for number in range(3):
            folder = tmp_path / str(number)
            folder.mkdir()
            found.append(stack.enter_context(Mosquitto(folder)))
        yield found


def named(nodes: list[Mosquitto], monkeypatch: pytest.MonkeyPatch) -> str:
    """The URL of a name with the addresses of all of them."""
    resolve = socket.getaddrinfo

    def getaddrinfo(host: str, port: int, *args: Any, **kwargs: Any) -> list[Any]:
        if host != "broker.plant":
            return resolve(host, port, *args, **kwargs)
        if kwargs.get("flags"):
            raise socket.gaierror("not a number")
        return [found for node in nodes for found in resolve("127.0.0.1", node.port, *args, **kwargs)]

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    return "mqtt://broker.plant"


def counts(*subscribers: Subscriber) -> list[int]:
    """The numbers of the events, each once, in the order of their arrival at any of them."""
    arrived = sorted((m for subscriber in subscribers for m in subscriber.on("/event")), key=lambda m: m.arrived_s)
    return list(dict.fromkeys(int(checked(m.topic, m.text)["id"].split("-")[1]) for m in arrived))


@pytest.mark.long
def test_a_hung_node_behind_one_name_is_passed_over(nodes: list[Mosquitto], monkeypatch: pytest.MonkeyPatch) -> None:
    nodes[0].pause()

    async def scenario() -> None:
        plant = Plant(named(nodes, monkeypatch))
        async with plant.running():
            for _ in range(5):
                plant.happen(EventKind.STOP_RAISED)
            await plant.until(lambda: plant.publisher.stats.queued == 0, 20)  # 5 s are the time limit of the first
            assert plant.publisher.link.peer == "mqtt://broker.plant:1883 (127.0.0.1)"
            assert plant.publisher.link.figures["broker"] == 1
        assert plant.link_errors == 0

    with Subscriber(nodes[1], "loading/#") as subscriber:
        asyncio.run(scenario())
        subscriber.wait_until(lambda: len(counts(subscriber)) == 5)


def test_events_go_on_at_the_next_broker_in_order_and_later_at_the_preferred_one(nodes: list[Mosquitto]) -> None:
    async def scenario(old: Subscriber, new: Subscriber) -> None:
        plant = Plant(None, urls=tuple(node.url for node in nodes), keepalive_s=2, return_s=1.0)

        async def stream() -> None:
            while True:
                plant.happen(EventKind.STOP_RAISED if len(plant.happened) % 2 else EventKind.STOP_CLEARED)
                await asyncio.sleep(0.01)

        async with plant.running():
            streaming = asyncio.get_running_loop().create_task(stream())
            await plant.until(lambda: plant.publisher.link.figures["broker"] == 1, 20)
            await asyncio.sleep(0.5)
            nodes[0].pause()
            await plant.until(lambda: plant.publisher.link.figures["broker"] == 2, 20)
            await asyncio.sleep(0.5)
            nodes[0].resume()
            await plant.until(lambda: plant.publisher.link.figures["broker"] == 1, 20)
            streaming.cancel()
            await plant.until(lambda: plant.publisher.stats.queued == 0, 20)
            assert plant.publisher.link.figures["failovers"] == 2
            assert plant.publisher.stats.dropped == 0
            # The broker that was left knows it: a state retained there must not look live.
            await asyncio.to_thread(new.wait_until, lambda: new.on("/status")[-1].json["status"] == "offline")
            await asyncio.to_thread(old.wait_until, lambda: old.on("/status")[-1].json["status"] == "online")
        total = len(plant.happened)
        await asyncio.to_thread(old.wait_until, lambda: len(counts(old, new)) == total)
        assert sorted(counts(old, new)) == list(range(1, total + 1))
        # At each of them in order. The paused one delivers what it had taken in when it was paused after it resumes.
        assert counts(old) == sorted(counts(old))
        assert counts(new) == sorted(counts(new))
        assert len(counts(new)) > 20

    with Subscriber(nodes[0], "loading/#") as old, Subscriber(nodes[1], "loading/#") as new:
        asyncio.run(scenario(old, new))
