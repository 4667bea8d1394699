"""Retained messages of bays that no gateway serves any more, because they were renamed or removed. IO: awaits the link.

`FormerTopics` clears those of this gateway when it connects; `ghosts` finds and clears those of a whole site.
"""

import asyncio
import contextlib
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from gateway.clock import SystemClock
from gateway.config import MqttConfig
from gateway.durations import NS_PER_MS
from gateway.errors import LinkError
from gateway.sinks.mqtt import home_assistant
from gateway.sinks.mqtt.broker_link import BrokerLink
from gateway.sinks.mqtt.session import BrokerSession
from gateway.sinks.mqtt.topic_plan import ALARMS, STATE
from gateway.sinks.mqtt.topics import Gateway, MqttMessage

ANSWER_S = 2.0  # for a broker to send what it has retained
STATUSES_AT_ONCE = 50
LEVELS = 3  # at most before the bay: with area, with line
OF_BAYS = (STATE.name, ALARMS.name)

log = logging.getLogger(__name__)


class FormerTopics:
    """Of this gateway's earlier starts, once at each broker: its retained status names the bays of those.

    What another gateway has published there since stays: a bay may have moved. A broker that permits no reading keeps
    all of it.
    """

    def __init__(self, gateway: Gateway, prefix: str, *, announced: bool) -> None:
        self._gateway = gateway
        self._prefix = prefix
        self._own = {gateway.topics.of(bay, name) for bay in gateway.bays for name in OF_BAYS}
        if announced:
            self._own |= {home_assistant.topic(prefix, gateway.topics, bay) for bay in gateway.bays}
        self._asked: set[str] = set()  # brokers

    async def ask(self, link: BrokerLink, broker: str) -> None:
        """Not twice, as a broker may end the connection of a client that may not read."""
        if broker not in self._asked:
            self._asked.add(broker)
            with contextlib.suppress(LinkError):
                await self._subscribe(link, {self._gateway.topics.status} | self._former(self._gateway.bays))

    async def received(self, link: BrokerLink, message: MqttMessage) -> None:
        """An answer, or what another gateway publishes."""
        with contextlib.suppress(LinkError):
            await link.unsubscribe(message.topic)
            if message.topic == self._gateway.topics.status:
                await self._subscribe(link, self._former(bays_of(message.payload)))
            elif owner_of(message.payload)[0] == self._gateway.topics.status and message.topic not in self._own:
                await _clear(link, message.topic)

    def _former(self, bays: Sequence[str]) -> set[str]:
        """What this gateway may have published of these bays, and does not now."""
        topics = self._gateway.topics
        found = {topics.of(bay, name) for bay in bays for name in OF_BAYS}
        for places in (topics, replace(topics, levels=())):  # the name of versions without area and line
            found |= {home_assistant.topic(self._prefix, places, bay) for bay in bays}
        return found - self._own

    async def _subscribe(self, link: BrokerLink, topics: set[str]) -> None:
        if topics:
            await link.subscribe([(topic, 1) for topic in sorted(topics)])


async def ghosts(config: MqttConfig, site: str, instance: str, *, clear: bool) -> dict[str, str]:
    """Topics at the connected broker, and why each is a ghost. Raises LinkError, and SettingError as BrokerSession."""
    found: dict[str, bytes] = {}
    session = BrokerSession(config, f"{config.client_id or f'gateway-{site}-{instance}'}-ghosts")

    async def received(_: object, message: MqttMessage) -> None:
        found[message.topic] = message.payload

    async with session.connection(None, received) as link:
        places = ["/".join((config.root, site, *("+" * depth))) for depth in range(1, LEVELS + 1)]
        wanted = [f"{place}/{name}" for place in places for name in OF_BAYS]
        await link.subscribe([(topic, 1) for topic in [*wanted, f"{config.home_assistant_prefix}/device/+/config"]])
        await asyncio.sleep(ANSWER_S)
        begins = f"{config.root}/{site}/"
        owners = {topic: owner_of(payload) for topic, payload in found.items()}
        owners = {topic: owner for topic, owner in owners.items() if owner[0].startswith(begins)}
        statuses = sorted({status for status, _ in owners.values()})
        for at in range(0, len(statuses), STATUSES_AT_ONCE):  # so few that each arrives
            await link.subscribe([(status, 1) for status in statuses[at : at + STATUSES_AT_ONCE]])
            await asyncio.sleep(ANSWER_S)
        now_ms = SystemClock().wall_ns() // NS_PER_MS
        gone = {topic: why for topic, owner in owners.items() if (why := _why(topic, owner, found, now_ms))}
        for topic in gone if clear else ():
            await _clear(link, topic)
    return gone


def _why(topic: str, owner: tuple[str, str], found: Mapping[str, bytes], now_ms: int) -> str:
    """Empty: a gateway serves that bay, or may do so."""
    status, bay = owner
    if status in found:
        return "" if bay in bays_of(found[status]) else f"{status} does not list {bay}"
    about = _object(found[topic])
    times = about.get("timestamp_ms", 0), about.get("stale_after_ms", 0)
    fresh = not all(isinstance(time, int) for time in times) or sum(times) > now_ms
    return "" if fresh else f"there is no {status}"


async def _clear(link: BrokerLink, topic: str) -> None:
    await link.publish(MqttMessage(topic, b"", retain=True, text=False))
    log.info("%s: the retained message of a bay that is not served any more was cleared", topic)


def owner_of(payload: bytes) -> tuple[str, str]:
    """Topic of the status of the gateway that has published a state, alarms or an announcement, and the bay; empty: it
    is none of these."""
    found = _object(payload)
    with contextlib.suppress(KeyError, IndexError, TypeError, AttributeError):
        if "availability" in found:
            return str(found["availability"][0]["topic"]), str(found["state_topic"]).split("/")[-2]
        return str(found["status_topic"]), str(found["bay"])
    return "", ""


def bays_of(status: bytes) -> list[str]:
    """That a status names."""
    bays = _object(status).get("bays")
    named = bays if isinstance(bays, list) else []
    return [bay for bay in named if isinstance(bay, str) and bay and not set(bay) & set("+#/\0")]


def _object(payload: bytes) -> dict[str, Any]:
    with contextlib.suppress(ValueError, RecursionError):
        found = json.loads(payload)
        if isinstance(found, dict):
            return found
    return {}
