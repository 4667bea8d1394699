"""Which retained message is of a bay that is gone, and what a gateway clears while another one publishes."""

import asyncio
import json
from typing import cast

import pytest

from gateway.sinks.mqtt import home_assistant
from gateway.sinks.mqtt.broker_link import BrokerLink
from gateway.sinks.mqtt.ghosts import FormerTopics, why_ghost
from gateway.sinks.mqtt.topics import Gateway, MqttMessage, Topics
from tests.unit.sinks.mqtt_stand_ins import in_virtual_time

NOW_MS, STALE_MS = 1_795_000_000_000, 2500
STATE, STATUS, CONFIG = "r/s/bay1/state", "r/s/a/status", "homeassistant/device/loading_s_bay1/config"


def gateway(instance: str, *bays: str) -> Gateway:
    return Gateway(Topics("r", "s", instance), bays, "1", "b")


def announced(instance: str) -> bytes:
    return home_assistant.discovery(gateway(instance, "bay1"), "bay1", STALE_MS)


def state(age_ms: int, status: str = STATUS) -> bytes:
    about = {"timestamp_ms": NOW_MS - age_ms, "stale_after_ms": STALE_MS, "status_topic": status, "bay": "bay1"}
    return json.dumps(about).encode()


def status(online: str, *bays: str) -> bytes:
    return json.dumps({"status": online, "bays": bays}).encode()


@pytest.mark.parametrize(
    ("others", "why"),
    [
        ({STATE: state(1000)}, ""),
        ({STATE: state(3000)}, f"there is no {STATUS}"),
        ({}, f"there is no {STATUS}"),
        ({STATUS: status("offline", "bay1")}, ""),
        ({STATE: state(1000), STATUS: status("online", "bay2")}, f"{STATUS} does not list bay1"),
        ({STATE: state(1000), STATUS: b""}, ""),  # cleared while it is read
        ({STATE: state(1000), STATUS: b"damaged"}, ""),
        ({STATE: state(3000), STATUS: b"damaged"}, f"there is no {STATUS}"),
    ],
)
def test_an_announcement_without_a_status_is_judged_by_the_state_that_it_names(
    others: dict[str, bytes], why: str
) -> None:
    assert why_ghost(CONFIG, "r/s/", {CONFIG: announced("a"), **others}, NOW_MS) == why


@pytest.mark.parametrize(
    ("online", "serving", "why"),
    [
        ("offline", "r/s/new/status", "its bays are those of r/s/new/status"),
        ("offline", STATUS, ""),
        ("online", "r/s/new/status", ""),
    ],
)
def test_a_status_is_a_ghost_where_another_instance_has_its_bays(online: str, serving: str, why: str) -> None:
    found = {STATUS: status(online, "bay1"), STATE: state(1000, serving)}
    assert why_ghost(STATUS, "r/s/", found, NOW_MS) == why


@in_virtual_time
async def test_a_bay_that_moves_meanwhile_keeps_its_new_announcement() -> None:
    done: list[tuple[str, bytes]] = []
    former = FormerTopics(gateway("a", "bay2"), "homeassistant", announced=True)

    class Link:
        async def subscribe(self, topics: list[tuple[str, int]]) -> None:
            if topics[0][0] != STATUS and (CONFIG, 1) in topics:
                await former.received(link, MqttMessage(CONFIG, announced("a")))

        async def publish(self, message: MqttMessage) -> None:
            done.append((message.topic, message.payload))
            if not message.payload:  # the other gateway was faster; both arrive here before the acknowledgement
                await former.received(link, MqttMessage(CONFIG, announced("b")))
                await former.received(link, message)

        async def unsubscribe(self, topic: str) -> None:
            done.append((topic, b"unsubscribed"))

    link = cast(BrokerLink, Link())
    task = asyncio.create_task(former.ask(link, "broker"))
    await asyncio.sleep(1)
    await former.received(link, MqttMessage(STATUS, status("online", "bay1", "bay2")))
    await former.received(link, MqttMessage(STATUS, status("online", "bay2")))  # its own, of this start
    await asyncio.sleep(1)
    task.cancel()
    assert [one for one in done if one[0] == CONFIG] == [
        (CONFIG, b""),
        (CONFIG, announced("b")),
        (CONFIG, b"unsubscribed"),
    ]
