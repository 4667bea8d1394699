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
from gateway.sinks.mqtt.topic_plan import ALARMS, STATE, STATUS
from gateway.sinks.mqtt.topics import Gateway, MqttMessage, everywhere

ANSWER_S = 2.0  # without another topic: then a broker has sent what it has retained
SURE_S = 10.0  # the same, before anything is deleted
ROUND_TRIPS = 3.0  # at least: a broker may send only so many messages before each is acknowledged
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
        self._found: dict[str, bytes] = {}  # the newest of each topic, until it is looked at
        self._arrived = asyncio.Event()

    async def ask(self, link: BrokerLink, broker: str) -> None:
        """Until cancelled, as another gateway may publish while its topic is cleared. Not twice, as a broker may end
        the connection of a client that may not read."""
        if broker in self._asked:
            return
        self._asked.add(broker)
        self._found.clear()
        with contextlib.suppress(LinkError):
            await self._subscribe(link, {self._gateway.topics.status} | self._former(self._gateway.bays))
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            while self._found:
                with contextlib.suppress(LinkError):
                    await self._judge(link, *self._found.popitem())

    async def received(self, _: BrokerLink, message: MqttMessage) -> None:
        """An answer, or what is published since; at once, as messages that wait are few. Of the own status the first is
        the retained one."""
        if message.payload and not (message.topic == self._gateway.topics.status and message.topic in self._found):
            self._found[message.topic] = message.payload
            self._arrived.set()

    async def _judge(self, link: BrokerLink, topic: str, payload: bytes) -> None:
        own = self._gateway.topics.status
        if topic == own:
            await self._subscribe(link, self._former(bays_of(payload)))
        elif owner_of(payload)[0] == own and topic not in self._own:
            await _clear(link, topic)
            newer = self._found.pop(topic, b"")  # another gateway's: it may have arrived before the deletion
            if topic.endswith("/config") and owner_of(newer)[0] not in ("", own):  # the others are published often
                await link.publish(MqttMessage(topic, newer, retain=True))
        await link.unsubscribe(topic)

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
    begins = f"{config.root}/{site}/"
    wanted = [topic for name in (*OF_BAYS, STATUS.name) for topic in everywhere(config.root, site, name)]
    wanted.append(f"{config.home_assistant_prefix}/device/+/config")

    async def received(_: object, message: MqttMessage) -> None:
        found[message.topic] = message.payload

    async def seen(link: BrokerLink, answer_s: float) -> dict[str, str]:
        await _answered(link, wanted, found, answer_s)
        if link.overflowed:
            raise LinkError(f"{session.peer}: messages arrived faster than they were read: some are not known")
        now_ms = SystemClock().wall_ns() // NS_PER_MS
        return {topic: why for topic in found if (why := why_ghost(topic, begins, found, now_ms))}

    async with session.connection(None, received) as link:
        gone = await seen(link, ANSWER_S)
        if gone and clear:
            found.clear()
            gone = await seen(link, SURE_S)
            for topic in gone:
                await _clear(link, topic)
    return gone


async def _answered(link: BrokerLink, topics: Sequence[str], found: Mapping[str, bytes], answer_s: float) -> None:
    """Until no topic more has arrived for this time, or for some round trips of a slow broker."""
    begun_s = asyncio.get_running_loop().time()
    await link.subscribe([(topic, 1) for topic in topics])
    answer_s = max(answer_s, ROUND_TRIPS * (asyncio.get_running_loop().time() - begun_s))
    known = -1
    while known != len(found):
        known = len(found)
        await asyncio.sleep(answer_s)


def why_ghost(topic: str, begins: str, found: Mapping[str, bytes], now_ms: int) -> str:
    """Empty: a gateway serves that bay, or may do so."""
    if topic.startswith(begins) and topic.endswith(f"/{STATUS.name}"):
        return _renamed(topic, found)
    status, bay = owner_of(found[topic])
    if not status.startswith(begins):
        return ""
    if listed := bays_of(found.get(status, b"")):  # none: cleared meanwhile, or damaged
        return "" if bay in listed else f"{status} does not list {bay}"
    about = _object(found[topic])
    if "availability" in about:  # an announcement has no time of its own
        about = _object(found.get(str(about["state_topic"]), b""))
    times = about.get("timestamp_ms", 0), about.get("stale_after_ms", 0)
    fresh = not all(isinstance(time, int) for time in times) or sum(times) > now_ms
    return "" if fresh else f"there is no {status}"


def _renamed(status: str, found: Mapping[str, bytes]) -> str:
    """Of the status of a gateway that is off: another one serves all its bays."""
    place, bays = status.rsplit("/", 2)[0], bays_of(found[status])
    owners = {owner_of(found.get(f"{place}/{bay}/{STATE.name}", b""))[0] for bay in bays}
    if _object(found[status]).get("status") == "online" or not bays or owners & {"", status}:
        return ""
    return f"its bays are those of {', '.join(sorted(owners))}"


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
