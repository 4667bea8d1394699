"""The Sparkplug sink: the edge node's connection with births, data, commands and a regular end. IO.

A separate connection beside that of the plain topics, because a connection has one last will, and here that is the
NDEATH.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from gateway import __version__
from gateway.config import MqttConfig
from gateway.core.events import Event
from gateway.core.state import Reason, StateVector
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.errors import LinkError
from gateway.sinks.contract import LinkStatus, SinkContext
from gateway.sinks.mqtt import payloads
from gateway.sinks.mqtt.broker_link import BrokerLink
from gateway.sinks.mqtt.session import BrokerSession, Connect
from gateway.sinks.mqtt.topics import MqttMessage
from gateway.sinks.outbox.durable import limits, opened_outbox
from gateway.sinks.outbox.outbox import Outbox
from gateway.sinks.sparkplug.bd_seq import BdSeq
from gateway.sinks.sparkplug.history import History
from gateway.sinks.sparkplug.node import EdgeNode, Identity

log = logging.getLogger(__name__)

POLL_S = 0.1  # how often changes other than of stop are checked for


class SparkplugPublisher:
    """One gateway as one edge node."""

    task = "mqtt.sparkplug"

    def __init__(
        self,
        context: SinkContext,
        *,
        outbox: Outbox | None = None,
        connect: Connect | None = None,
        bd_seq: Callable[[], int] | None = None,
    ) -> None:
        config: MqttConfig = context.settings
        site, instance = context.config.site, context.config.instance
        hub, clock = context.bays, context.clock
        if config.sparkplug is None:
            raise ValueError("no [mqtt.sparkplug] in the configuration")
        self.reconnect = config.reconnect
        self._settings = config.sparkplug
        self._hub = hub
        self._clock = clock
        self._bd_seq = bd_seq or BdSeq(instance)
        identity = Identity(
            self._settings.group_id or site,
            self._settings.edge_node_id or instance,
            self._settings.primary_host_id or "",
        )
        changes = self._settings.history
        self._outbox = (
            outbox
            if outbox is not None
            else context.resources.enter_context(
                opened_outbox(
                    replace(limits(config), events=max(1, changes)),
                    _beside(config.outbox_file),
                    f"{instance}.sparkplug",
                    f"sparkplug-{site}-{instance}.sqlite",
                )
            )
        )
        self.node = EdgeNode(
            identity,
            __version__,
            History(self._outbox, changes, context.boot, hub.bays),
            doubt_ms=2000 * config.keepalive_s,  # a dead connection is noticed within 1.5 keepalives
            typed_data=self._settings.datatypes_in_data,
            alarms=lambda bay: context.alarms(bay, clock.now_ns()),
            facts=context.facts,
        )
        client_id = f"{config.client_id or f'gateway-{site}-{instance}'}-sparkplug"
        # A proper end publishes the NDEATH, too: section 6.4.25.
        self._session = BrokerSession(config, client_id, will_at_disconnect=True, connect=connect, clock=clock)
        self._urgent = asyncio.Event()
        self._over = asyncio.Event()  # this session is to end in order: `close`, or the primary host is offline
        self._send_lock = asyncio.Lock()  # messages go out in the order of their sequence numbers
        hub.listen(self._on_event)

    @property
    def link(self) -> LinkStatus:
        """`connected`: births were sent in this session; not while the primary host is awaited."""
        stats, born = self.node.stats, self._session.connected and self.node.born
        dropped = self.node.history.dropped
        figures = {
            **self._session.figures,
            "born": int(self.node.born),
            "births": stats.births,
            "rebirths": stats.rebirths,
            "rebirths_deferred": stats.rebirths_deferred,
            "data_messages": stats.data,
            "commands_refused": stats.refused,
            "history_dropped": dropped,
            "history_waiting": len(self.node.history),
        }
        detail = "session open" if born else "no session"
        session = self._session
        return LinkStatus(
            "sparkplug",
            born,
            detail,
            session.peer,
            dropped,
            figures,
            self._outbox.store,
            fault=session.fault,
            alarms=session.alarms,
        )

    async def deliver(self) -> None:
        """One session, until the link breaks or the primary host is offline (LinkError), or after `close`."""
        if self._session.closing.is_set():
            return
        self._over.clear()
        will = self.node.will(self._bd_seq(), self._now_ms())
        try:
            async with self._session.connection(will, self._received) as link:
                await link.subscribe(self.node.identity.subscriptions)
                await self._send(link, lambda: self.node.connected(self._states(), self._now_ms()))
                async with asyncio.TaskGroup() as group:
                    changes = group.create_task(self._publish_changes(link))
                    await self._over.wait()
                    changes.cancel()
                if self.node.born:
                    await self._send(link, lambda: [self.node.death(self._now_ms())])
        finally:
            self.node.lost()
        if not self._session.closing.is_set():  # after a proper DISCONNECT
            raise LinkError(f"primary host {self._settings.primary_host_id} is offline")

    async def close(self, timeout_s: float) -> None:
        """NDEATH, then DISCONNECT, where there is a session. Takes at most `timeout_s` real seconds."""
        self._over.set()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._session.close()

    async def _received(self, link: BrokerLink, message: MqttMessage) -> None:
        """A command, or the primary host's state."""

        def answer() -> list[MqttMessage]:
            out, offline = self.node.received(message.topic, message.payload, self._states(), self._now_ms())
            if offline:
                self._over.set()
            return out

        if not self._over.is_set():
            await self._send(link, answer)

    async def _publish_changes(self, link: BrokerLink) -> NoReturn:
        """Changes: of stop at once, of the other urgent values within POLL_S, the rest once a period."""
        while True:
            self._urgent.clear()
            published = self._urgent_values()
            await self._send(link, lambda: self.node.states(self._states(), self._now_ms()))
            until_ns = self._clock.now_ns() + self._settings.period_s * NS_PER_S
            while not self._urgent.is_set() and (left_ns := until_ns - self._clock.now_ns()) > 0:
                with contextlib.suppress(TimeoutError):
                    async with self._clock.timeout(min(left_ns / NS_PER_S, POLL_S)):
                        await self._urgent.wait()
                if self._urgent_values() != published or self.node.rebirth_due(self._now_ms()):
                    break

    def _urgent_values(self) -> list[tuple[object, ...] | None]:
        """The values of each bay whose change is published within POLL_S; None: its state is not computed."""
        states = self._states().values()
        return [None if s is None else (s.stop, s.may_move, s.in_place, s.visit.moved, s.reason) for s in states]

    async def _send(self, link: BrokerLink, make: Callable[[], list[MqttMessage]]) -> None:
        """Make and send under one lock: what is numbered first is sent first."""
        async with self._send_lock:
            for message in make():
                await link.publish(message)

    def _on_event(self, event: Event) -> None:
        if event.kind in payloads.DROPPED_LAST:
            self.node.changed(event.state, self._unix_ms(event.t_ns))
            self._urgent.set()
        elif event.summary is not None:
            self.node.visited(event.bay, event.summary, self._unix_ms(event.t_ns))
            self._urgent.set()

    def _states(self) -> Mapping[str, StateVector | None]:
        """None: this bay's state is not computed any more."""
        now_ns = self._clock.now_ns()
        shown = {bay: self._hub.shown(bay, now_ns) for bay in self._hub.bays}
        return {bay: None if s.reason is Reason.GATEWAY_FAULT else s for bay, s in shown.items()}

    def _now_ms(self) -> int:
        return self._unix_ms(self._clock.now_ns())

    def _unix_ms(self, t_ns: int) -> int:
        """Never negative, which a UInt64 can't be: without a battery a wall clock may begin before 1970."""
        return max(0, t_ns + self._clock.wall_ns() - self._clock.now_ns()) // NS_PER_MS


def _beside(file: str) -> str:
    """The history's file, beside that of the events."""
    path = Path(file)
    return file if file in ("", "auto") else str(path.with_name(f"{path.stem}-sparkplug{path.suffix}"))
