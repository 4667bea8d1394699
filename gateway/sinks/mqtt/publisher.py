"""Every bay's state and events to the broker, for as long as there is one. IO.

An event is rendered and put into the outbox in the moment it happens, so that it outlives the gateway; that takes
microseconds and asks nobody. `deliver`, a row of the task table, is the life of one connection and ends with LinkError.
What must outlive a connection (outbox, counters) lives here. Nothing here can make the control path wait.
"""

import asyncio
import contextlib
import logging
import math
import secrets
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from functools import partial
from typing import NoReturn, Protocol

from gateway import __version__
from gateway.clock import NS_PER_S, Clock
from gateway.config import MqttConfig
from gateway.core.model import Event, Moved, Quality, Reason, StateVector
from gateway.errors import LinkError
from gateway.hub import Hub
from gateway.sinks.mqtt import credentials, home_assistant, messages, payloads
from gateway.sinks.mqtt.broker_connector import Door
from gateway.sinks.mqtt.broker_link import Message
from gateway.sinks.mqtt.link_errors import plain_link_error
from gateway.sinks.mqtt.topics import Topics
from gateway.sinks.outbox.durable import DurableOutbox, limits
from gateway.sinks.outbox.outbox import Entry, MemoryOutbox, Outbox

log = logging.getLogger(__name__)

LOOK_S = 0.1  # so often it is asked whether anybody still decides
LIFE_SHARE = 0.5  # of a keepalive, from one sign of life to the next; see door.ACK_SHARE


class Link(Protocol):
    """What is needed of a connection; see gateway.sinks.mqtt.broker_link.BrokerLink."""

    async def publish(self, message: Message) -> None: ...

    async def lost(self) -> NoReturn: ...


Connect = Callable[[], AbstractAsyncContextManager[Link]]
Marks = tuple[bool, bool, bool, Moved, Reason, Quality, Quality]


@dataclass(frozen=True, slots=True)
class Sent:
    """The state a bay last told the broker: what would make the next one urgent, and when it was told."""

    marks: Marks
    t_ns: int


class MqttPublisher:
    """One gateway's voice. `boot`: a random number of this start. Raises ConfigError for a URL or a topic root that
    could never work."""

    def __init__(
        self,
        config: MqttConfig,
        site: str,
        instance: str,
        hub: Hub,
        clock: Clock,
        version: str = __version__,
        *,
        outbox: Outbox | None = None,
        connector: Connect | None = None,
        boot: str | None = None,
    ) -> None:
        self._config = config
        self._hub = hub
        self._clock = clock
        self._topics = Topics(config.root, site, instance)
        self._gateway = payloads.Gateway(self._topics, hub.bays, version, boot or secrets.token_hex(8))
        self._broker = credentials.broker_of(config)
        self._connect = connector or self._connector()
        self._event_expiry_s = round(config.event_expiry_h * 3600)
        self._stale_after_ms = round(1000 * (3 * config.state_period_s + 1))
        self._outbox = outbox if outbox is not None else MemoryOutbox(limits(config))
        self._numbered = 0
        self._filled = asyncio.Event()
        self._alone = asyncio.Lock()  # held by whoever has a connection: one client id, one connection
        self._event_turn = asyncio.Lock()  # held from the sending of an event to its acknowledgement
        hub.listen(self._keep)
        self._leaving = asyncio.Event()
        self._said_goodbye = False
        self._published = 0
        self._failed = 0
        self._connections = 0
        self._connected_now = False

    @property
    def connected(self) -> bool:
        """Is there a connection to the broker now?"""
        return self._connected_now

    @property
    def stats(self) -> messages.DeliveryPayload:
        return messages.DeliveryPayload(
            published=self._published,
            failed=self._failed,
            reconnects=max(0, self._connections - 1),
            dropped=self._outbox.dropped,
            queued=len(self._outbox),
            store=self._store_health(),
        )

    async def deliver(self) -> None:
        """Connect and deliver until the link breaks (LinkError), or return after `farewell`."""
        async with self._alone:
            if self._leaving.is_set():
                return
            async with self._connected() as link:
                await self._serve(link)
                await self._say_goodbye(link)

    async def farewell(self, timeout_s: float) -> bool:
        """The last words: final states with stop on, the events still queued, `offline`. True if all were taken.

        Works beside a running `deliver`, which then returns, and without one. Takes at most `timeout_s` real seconds;
        what is not said by then the broker's copy of the last will says when the connection breaks.
        """
        self._leaving.set()
        try:
            async with asyncio.timeout(timeout_s), self._alone:  # `deliver`, where it is connected, says it itself
                if not self._said_goodbye:
                    async with self._connected() as link:
                        await self._say_goodbye(link)
        except TimeoutError:
            log.warning("%s: no answer in %g s; %d events not delivered", self._broker, timeout_s, self.stats.queued)
        except LinkError as error:
            log.warning("%s; %d events not delivered", error, self.stats.queued)
        return self._said_goodbye

    def _connector(self) -> Connect:
        client_id = self._config.client_id or f"gateway-{self._topics.site}-{self._topics.instance}"
        will = payloads.encode(payloads.status_payload(self._gateway, "connection lost"))
        door = Door(self._config, self._broker, client_id)
        return partial(door.open, Message(self._topics.status, will, retain=True))

    @contextlib.asynccontextmanager
    async def _connected(self) -> AsyncIterator[Link]:
        """A connection; when it is lost, the body ends at once, and all that failed with it is one LinkError."""
        with plain_link_error():
            async with self._connect() as link, asyncio.TaskGroup() as group:
                self._connections += 1
                log.info("%s: connected", self._broker)
                self._connected_now = True
                try:
                    watch = group.create_task(link.lost())
                    yield link
                    watch.cancel()
                finally:
                    self._connected_now = False

    async def _serve(self, link: Link) -> None:
        """Until told to leave. `online` is said only once no bay's retained state is an old one any more."""
        sent: dict[str, Sent] = {}

        async def first(bay: str) -> None:
            sent[bay] = await self._send_state(link, bay)
            if self._config.home_assistant:
                await self._publish(link, self._discovery_message(bay))

        async with asyncio.TaskGroup() as group:
            for bay in self._hub.bays:
                group.create_task(first(bay))
        async with asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(self._send_life(link)),
                group.create_task(self._send_events(link)),
                *(group.create_task(self._follow(link, bay, sent[bay])) for bay in self._hub.bays),
            ]
            await self._leaving.wait()
            async with self._event_turn:  # or the event on its way would go out once more
                for task in tasks:
                    task.cancel()

    async def _follow(self, link: Link, bay: str, sent: Sent) -> NoReturn:
        """One bay's state: a change that matters at once, the rest once a period, the newest only."""
        period_ns = self._config.state_period_s * NS_PER_S
        while True:
            seq = -1
            while _marks(self._shown(bay)) == sent.marks and self._clock.now_ns() < sent.t_ns + period_ns:
                wait_s = (sent.t_ns + period_ns - self._clock.now_ns()) / NS_PER_S
                with contextlib.suppress(TimeoutError):
                    # No newer state: nobody decides any more, which must be told, too.
                    async with self._clock.timeout(min(wait_s, LOOK_S)):
                        seq = await self._hub.newer(bay, seq)
            sent = await self._send_state(link, bay)

    async def _send_state(self, link: Link, bay: str) -> Sent:
        state = self._shown(bay)
        sent = Sent(_marks(state), self._clock.now_ns())
        await self._publish(link, self._state_message(state))
        return sent

    async def _send_life(self, link: Link) -> NoReturn:
        """`online`, again and again: it proves the link, and heals a late will of an older connection of ours."""
        while True:
            await self._publish(link, self._status_message("running"))
            await asyncio.sleep(LIFE_SHARE * self._config.keepalive_s)

    async def _send_events(self, link: Link) -> NoReturn:
        while True:
            await self._empty_outbox(link)
            self._filled.clear()
            await self._filled.wait()

    async def _empty_outbox(self, link: Link) -> None:
        """One at a time: a duplicate, if there is one, directly follows its first copy."""
        while True:
            async with self._event_turn:
                if (entry := self._outbox.oldest()) is None:
                    return
                await self._publish(
                    link, Message(entry.topic, entry.payload, retain=False, expiry_s=self._event_expiry_s)
                )
                self._outbox.acknowledge(entry.id)

    async def _say_goodbye(self, link: Link) -> None:
        now_ns = self._clock.now_ns()
        for bay in self._hub.bays:  # first: a dead bay must not look alive, whatever else there is time for
            await self._publish(link, self._state_message(payloads.final(self._hub.shown(bay, now_ns), now_ns)))
        await self._empty_outbox(link)
        await self._publish(link, self._status_message("shutdown"))
        self._said_goodbye = True

    async def _publish(self, link: Link, message: Message) -> None:
        try:
            await link.publish(message)
        except LinkError:
            self._failed += 1
            raise
        self._published += 1

    def _keep(self, event: Event) -> None:
        self._numbered += 1
        payload = payloads.event_payload(event, self._numbered, self._gateway, self._offset_ns())
        topic = self._topics.event(event.bay)
        precious = event.kind in payloads.PRECIOUS
        self._outbox.put(Entry(payload.id, topic, payloads.encode(payload), precious, payload.timestamp_ms))
        self._filled.set()

    def _shown(self, bay: str) -> StateVector:
        return self._hub.shown(bay, self._clock.now_ns())

    def _state_message(self, state: StateVector) -> Message:
        """A live state is forgotten by the broker (MQTT 5) once it is too old to be believed; a last word stays."""
        expiry_s = None if state.reason is Reason.SHUTDOWN else math.ceil(self._stale_after_ms / 1000)
        payload = payloads.state_payload(state, self._gateway, self._offset_ns(), self._stale_after_ms)
        return Message(self._topics.state(state.bay), payloads.encode(payload), retain=True, expiry_s=expiry_s)

    def _discovery_message(self, bay: str) -> Message:
        topic = home_assistant.topic(self._config.home_assistant_prefix, self._gateway, bay)
        return Message(topic, home_assistant.discovery(self._gateway, bay, self._stale_after_ms), retain=True)

    def _status_message(self, cause: messages.Cause) -> Message:
        payload = payloads.status_payload(self._gateway, cause, self._clock.wall_ns(), self.stats)
        return Message(self._topics.status, payloads.encode(payload), retain=True)

    def _store_health(self) -> messages.StorePayload | None:
        if not isinstance(self._outbox, DurableOutbox):
            return None
        health = self._outbox.health
        return messages.StorePayload(
            ok=not health.fault,
            detail=payloads.text(health.fault),
            faults=health.faults,
            recovered=health.recovered,
            unwritten=health.unwritten,
        )

    def _offset_ns(self) -> int:
        return self._clock.wall_ns() - self._clock.now_ns()


def _marks(state: StateVector) -> Marks:
    """What a subscriber must hear of at once."""
    return (
        state.stop,
        state.may_move,
        state.in_place,
        state.visit.moved,
        state.reason,
        state.vision.quality,
        state.range.quality,
    )
