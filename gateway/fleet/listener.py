"""The roster as the broker's messages make it. IO. It publishes nothing."""

import asyncio
import socket
from functools import partial

from gateway.clock import Clock
from gateway.durations import NS_PER_MS
from gateway.fleet.config import FleetConfig
from gateway.fleet.keeper import Keeper
from gateway.fleet.roster import Roster
from gateway.fleet.store import FleetStore
from gateway.sinks.mqtt import broker_link
from gateway.sinks.mqtt.broker_link import BrokerLink
from gateway.sinks.mqtt.session import BrokerSession
from gateway.sinks.mqtt.topic_plan import STATUS
from gateway.sinks.mqtt.topics import MqttMessage, everywhere

# One of more ends a connection of MQTT 3.1.1: more than nats-server passes on, so that nobody ends it for all.
MAX_PACKET_BYTES = 1_100_000
STEP_MS = 500  # by which the clock was set; a smaller one shortens or extends nothing that counts


class Listener:
    """The roster, as the broker's messages make it."""

    def __init__(self, config: FleetConfig, roster: Roster, store: FleetStore, clock: Clock) -> None:
        self.roster = roster
        self.keeper = Keeper(roster, store, clock, self.now_ms)
        self._root = config.mqtt.root
        self._clock = clock
        self._was_ahead_ms = self._ahead_ms()
        self._session = BrokerSession(
            config.mqtt,
            config.mqtt.client_id or f"fleet-{socket.gethostname()}-{config.hmi.port}",
            connect=partial(broker_link.connect, max_packet_bytes=MAX_PACKET_BYTES),
            clock=clock,
        )

    @property
    def connected(self) -> bool:
        return self._session.connected

    @property
    def broker(self) -> str:
        return self._session.peer

    def now_ms(self) -> int:
        ahead_ms = self._ahead_ms()
        if abs(by_ms := ahead_ms - self._was_ahead_ms) > STEP_MS:
            self.roster.clock_set(by_ms)
            self._was_ahead_ms = ahead_ms
        return self._was_ahead_ms + self._clock.now_ns() // NS_PER_MS

    def _ahead_ms(self) -> int:
        """Of Unix time before the time that nobody can set."""
        return (self._clock.wall_ns() - self._clock.now_ns()) // NS_PER_MS

    async def listen(self) -> None:
        """One connection. Raises LinkError when it is lost."""
        topics = [(topic, 1) for topic in everywhere(self._root, "+", STATUS.name)]
        async with self._session.connection(None, self._received) as link:
            await link.subscribe(topics)
            await asyncio.Event().wait()

    async def _received(self, _: BrokerLink, message: MqttMessage) -> None:
        now_ms = self.now_ms()
        key, changes = self.roster.heard(message.topic, message.payload, now_ms, retained=message.retain)
        if key is not None:
            self.keeper.heard(key, changes, now_ms, retained=message.retain)
