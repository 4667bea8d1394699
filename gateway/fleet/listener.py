"""The roster as the broker's messages make it, and kept on disk. IO. It publishes nothing."""

import asyncio
import logging
import socket
import sqlite3

from gateway.clock import Clock
from gateway.durations import NS_PER_MS
from gateway.fleet.config import FleetConfig
from gateway.fleet.roster import GatewayChange, Key, Known, Roster
from gateway.fleet.store import FleetStore
from gateway.sinks.mqtt.broker_link import BrokerLink
from gateway.sinks.mqtt.session import BrokerSession
from gateway.sinks.mqtt.topics import MqttMessage

log = logging.getLogger(__name__)

LEVELS = 3  # at most between site and `status`: with area, with line
KEEP_S = 2.0  # between two writes to the database
STEP_MS = 500  # by which the clock was set; a smaller one shortens or extends nothing that counts
MAX_WAITING = 10_000  # changes that are not written yet


class Listener:
    """The roster, as the broker's messages make it."""

    def __init__(self, config: FleetConfig, roster: Roster, store: FleetStore, clock: Clock) -> None:
        self.roster = roster
        self._root = config.mqtt.root
        self._store = store
        self._clock = clock
        self._was_ahead_ms = self._ahead_ms()
        self._session = BrokerSession(
            config.mqtt, config.mqtt.client_id or f"fleet-{socket.gethostname()}-{config.hmi.port}", clock=clock
        )
        self._unwritten: dict[Key, None] = {}
        self._changes: list[GatewayChange] = []
        self._failing = False

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
        topics = [(f"{self._root}/{'/'.join(['+'] * n)}/status", 1) for n in range(2, LEVELS + 2)]
        async with self._session.connection(None, self._received) as link:
            await link.subscribe(topics)
            await asyncio.Event().wait()

    async def _received(self, _: BrokerLink, message: MqttMessage) -> None:
        key, changes = self.roster.heard(message.topic, message.payload, self.now_ms(), retained=message.retain)
        if key is not None:
            self._unwritten[key] = None
            self._changes += changes[: max(0, MAX_WAITING - len(self._changes))]

    async def keep(self) -> None:
        """Writes what is new, for ever."""
        while True:
            await self._clock.sleep(KEEP_S)
            keys, changes = tuple(self._unwritten), self._changes
            if keys and not await asyncio.to_thread(self._written, *self._take()):
                self._unwritten |= dict.fromkeys(keys)
                self._changes = (changes + self._changes)[:MAX_WAITING]

    def close(self) -> None:
        """Writes the rest; waits for the disk."""
        self._written(*self._take())

    def _take(self) -> tuple[list[Known], list[GatewayChange], list[Key]]:
        found = {key: self.roster.known.get(key) for key in self._unwritten}
        gone = [key for key, one in found.items() if one is None]
        taken = [one for one in found.values() if one is not None], self._changes, gone
        self._unwritten, self._changes = {}, []
        return taken

    def _written(self, known: list[Known], changes: list[GatewayChange], gone: list[Key]) -> bool:
        """A disk that fails is logged once."""
        try:
            self._store.keep(known, changes, gone)
        except sqlite3.Error as error:
            if not self._failing:
                log.error("database: %s; what is heard is not kept", error)
            self._failing = True
            return False
        self._failing = False
        return True

    async def changes(self, key: Key) -> list[GatewayChange]:
        """What is written of it, and what is not yet; the newest first. A database that another program has locked
        holds up nobody else."""
        waiting = [change for change in reversed(self._changes) if change.key == key]
        try:
            return waiting + await asyncio.to_thread(self._store.changes, key)
        except sqlite3.Error as error:
            log.error("database: %s", error)
            return waiting
