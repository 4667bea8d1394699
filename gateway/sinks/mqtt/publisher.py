"""The MQTT sink: the states and events of every bay to the broker, for as long as there is one. IO.

An event is rendered and put into the outbox when it happens, so that it outlives the gateway; that takes
microseconds and never waits. `deliver` is the life of one connection. What must outlive a connection (outbox,
counters) is kept here.
"""

import asyncio
import contextlib
import logging
import math
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from typing import NoReturn

from gateway import __version__
from gateway.config import MqttConfig
from gateway.core import details
from gateway.core.events import Event
from gateway.core.readings import Quality
from gateway.core.state import Moved, Reason, StateVector
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.sinks.contract import BayAlarms, LinkStatus, SinkContext
from gateway.sinks.mqtt import home_assistant, messages, payloads
from gateway.sinks.mqtt.alarm_topic import alarms_payload
from gateway.sinks.mqtt.broker_link import BrokerLink, PublishRefusedError, UnansweredError
from gateway.sinks.mqtt.event_delivery import EventDelivery
from gateway.sinks.mqtt.ghosts import FormerTopics
from gateway.sinks.mqtt.session import ACKNOWLEDGE_SHARE, BrokerSession, Connect
from gateway.sinks.mqtt.topic_answers import TopicAnswers
from gateway.sinks.mqtt.topic_plan import ALARMS, PLAN, STATE
from gateway.sinks.mqtt.topics import Gateway, MqttMessage, Topics
from gateway.sinks.mqtt.value_topics import ValueTopics
from gateway.sinks.outbox.durable import limits, opened_outbox
from gateway.sinks.outbox.outbox import Outbox
from gateway.values.gateway_values import GatewayFacts

log = logging.getLogger(__name__)

ALARMS_S, ALARMS_PERIOD_S = 0.5, 10.0  # between two looks at the alarms, and from one message to the next
POLL_S = 0.1  # how often it is checked whether the shown state has expired
SLOW_SHARE = 0.5  # of the time for an acknowledgement: after it the broker or the link is slow
BREAKS = 2  # connections in a row that ended within SETTLED_S: one message at a time, to find out after which
SETTLED_S = 10.0
ENDED_AT_ONCE_S = 1.0  # a connection that ends so soon after a refusal ends because of it
STATUS_SHARE = 0.5  # of a keepalive, from one status message to the next; see session.ACKNOWLEDGE_SHARE


Urgent = tuple[bool, bool, bool, Moved, Reason, Quality, Quality]


@dataclass(frozen=True, slots=True)
class Published:
    """The state last published of a bay: the values whose change is urgent, and when it was published."""

    urgent: Urgent
    t_ns: int


class MqttPublisher:
    """Raises SettingError for a URL or a topic root that could never work. `outbox`: instead of the configured one."""

    task = "mqtt.deliver"

    def __init__(self, context: SinkContext, *, outbox: Outbox | None = None, connect: Connect | None = None) -> None:
        config: MqttConfig = context.settings
        site, instance = context.config.site, context.config.instance
        hub, clock = context.bays, context.clock
        self.reconnect = config.reconnect
        self._config = config
        self._hub = hub
        self._clock = clock
        self._topics = Topics.of_config(config, site, instance)
        self._gateway = Gateway(self._topics, hub.bays, __version__, context.boot)
        self._alarms = context.alarms
        self._facts = context.facts
        self._titles = {bay.name: bay.title for bay in context.config.bays}
        self._state_topics = [(kind, kind.build) for kind in PLAN if kind.build is not None]
        self._values = {bay: ValueTopics(self._topics, bay, config.values_period_s) for bay in hub.bays}
        self._session = BrokerSession(
            config, config.client_id or f"gateway-{site}-{instance}", connect=connect, clock=clock
        )
        will = payloads.status_payload(self._gateway, "connection lost")
        self._will = MqttMessage(self._topics.status, payloads.encode(will), retain=True)
        self._stale_after_ms = round(1000 * (3 * config.state_period_s + 1))
        self._outbox = (
            outbox
            if outbox is not None
            else context.resources.enter_context(
                opened_outbox(limits(config), config.outbox_file, instance, f"outbox-{site}-{instance}.sqlite")
            )
        )
        self._numbered = 0
        self._answers = TopicAnswers()
        self._events = EventDelivery(
            self._outbox,
            self._answers,
            clock,
            self._send,
            expiry_s=round(config.event_expiry_h * 3600),
            in_flight=config.events_in_flight,
            unsubscribed_s=config.unsubscribed_h * 3600,
            slow_s=SLOW_SHARE * ACKNOWLEDGE_SHARE * config.keepalive_s,
        )
        hub.listen(self._queue_event)
        self._former = FormerTopics(self._gateway, config.home_assistant_prefix, announced=config.home_assistant)
        self._final_published = False
        self._published = 0
        self._failed = 0
        self._refused = 0
        self._breaks = 0  # connections in a row that ended soon, and not by silence, with messages unanswered

    @property
    def link(self) -> LinkStatus:
        stats, store = self.stats, self._outbox.store
        figures = {
            **self._session.figures,
            "published": stats.published,
            "failed": stats.failed,
            "reconnects": stats.reconnects,
            "events_dropped": stats.dropped,
            "outbox_events": stats.queued,
            "events_held": self._events.held,
            "events_unsubscribed": self._outbox.unused_dropped,
            "refused": self._refused,
        }
        if store is not None:
            figures |= {"store_ok": int(not store.fault), "store_faults": store.faults}
            figures["store_unwritten_events"] = store.unwritten
        detail = "connected" if self._session.connected else "no connection"
        session = self._session
        return LinkStatus(
            "mqtt",
            session.connected,
            detail,
            session.peer,
            stats.dropped,
            figures,
            store,
            fault=session.fault,
            alarms=session.alarms | self._answers.alarms,
        )

    @property
    def stats(self) -> messages.DeliveryPayload:
        return messages.DeliveryPayload(
            published=self._published,
            failed=self._failed,
            reconnects=max(0, self._session.connections - 1),
            dropped=self._outbox.dropped,
            queued=len(self._outbox),
            store=payloads.store_payload(self._outbox.store),
        )

    async def deliver(self) -> None:
        """Connect and deliver until the link breaks (LinkError), or return after `close`."""
        if self._session.closing.is_set():
            return
        async with self._connection() as link:
            await self._serve(link)
            await self._publish_final(link)

    async def close(self, timeout_s: float) -> bool:
        """Publish the final states with stop on, the events still queued, and `offline`. True if all were acknowledged.

        Works beside a running `deliver`, which then returns, and without one. Takes at most `timeout_s` real seconds;
        if that is not enough, the broker publishes the last will when the connection breaks.
        """
        try:
            async with asyncio.timeout(timeout_s):
                await self._session.close()  # where `deliver` is connected, it publishes them itself
                if not self._final_published:
                    async with self._connection() as link:
                        await self._publish_final(link)
        except TimeoutError:
            queued = self.stats.queued
            log.warning("%s: no answer in %g s; %d events not delivered", self._session.peer, timeout_s, queued)
        except LinkError as error:
            log.warning("%s; %d events not delivered", error, self.stats.queued)
        return self._final_published

    @contextlib.asynccontextmanager
    async def _connection(self) -> AsyncIterator[BrokerLink]:
        """After connections that ended soon one after the other, with one message at a time: then it is known after
        which one the broker ends them."""
        begun_ns, link = self._clock.now_ns(), None
        try:
            async with self._session.connection(self._will, self._former.received) as link:
                self._answers.connected()
                if self._breaks >= BREAKS:
                    link.narrow()
                yield link
        except LinkError as error:
            if link is not None and not isinstance(error.__cause__ or error, UnansweredError):
                self._ended(link, self._clock.now_ns() - begun_ns, str(error))
            raise

    def _ended(self, link: BrokerLink, lived_ns: int, text: str) -> None:
        """By the broker or the network."""
        unanswered, narrow, now_ns = link.unanswered, self._breaks >= BREAKS, self._clock.now_ns()
        if link.newest_refusal is not None:  # mosquitto 2.0.11 refuses, and ends the connection all the same
            topic, fault, refused_s = link.newest_refusal
            if asyncio.get_running_loop().time() - refused_s < ENDED_AT_ONCE_S:
                self._answers.cut(topic, details.ENDS_AFTER(fault), now_ns, certain=True)
                return
        soon = bool(unanswered) and lived_ns < SETTLED_S * NS_PER_S
        self._breaks = self._breaks + 1 if soon else 0
        for topic in set(unanswered):
            if self._answers.cuts_connections(topic) or (soon and narrow):
                self._answers.cut(topic, details.ENDS_AFTER_WHY(text), now_ns)

    async def _widen(self, link: BrokerLink) -> None:
        if self._breaks >= BREAKS:
            await self._clock.sleep(SETTLED_S)
            self._breaks = 0
            link.widen()

    async def _serve(self, link: BrokerLink) -> None:
        """Until `close`. `online` is published only once no bay's retained state is an old one any more."""
        sent: dict[str, Published] = {}
        alarms: dict[str, BayAlarms] = {}

        async def first(bay: str) -> None:
            sent[bay] = await self._publish_state(link, bay)
            alarms[bay] = self._alarms(bay, self._clock.now_ns())
            await self._publish(link, self._alarms_message(bay, alarms[bay]))
            if self._config.home_assistant:
                await self._publish(link, self._discovery_message(bay))

        async with asyncio.TaskGroup() as group:
            for bay in self._hub.bays:
                group.create_task(first(bay))
        async with asyncio.TaskGroup() as group:
            events = group.create_task(self._events.deliver(link))
            tasks = [
                group.create_task(self._former.ask(link, self._session.peer)),  # before its answer is replaced
                group.create_task(self._publish_status(link)),
                group.create_task(self._widen(link)),
                *(group.create_task(self._publish_states(link, bay, sent[bay])) for bay in self._hub.bays),
                *(group.create_task(self._publish_alarms(link, bay, alarms[bay])) for bay in self._hub.bays),
            ]
            await self._session.closing.wait()
            self._events.end()
            await events  # or the events on their way would go out once more
            for task in tasks:
                task.cancel()

    async def _publish_states(self, link: BrokerLink, bay: str, sent: Published) -> NoReturn:
        """One bay's state: a change that matters at once, the rest once a period, the newest only."""
        period_ns = self._config.state_period_s * NS_PER_S
        while True:
            seq = -1
            while _urgent(self._shown(bay)) == sent.urgent and self._clock.now_ns() < sent.t_ns + period_ns:
                wait_s = (sent.t_ns + period_ns - self._clock.now_ns()) / NS_PER_S
                with contextlib.suppress(TimeoutError):
                    # No newer state: the shown one may expire, which must be published, too.
                    async with self._clock.timeout(min(wait_s, POLL_S)):
                        seq = await self._hub.newer(bay, seq)
            sent = await self._publish_state(link, bay)

    async def _publish_state(self, link: BrokerLink, bay: str) -> Published:
        state = self._shown(bay)
        published = Published(_urgent(state), self._clock.now_ns())
        await self._publish_all(link, self._state_messages(state))
        return published

    def _state_messages(self, state: StateVector) -> list[MqttMessage]:
        """One for each topic of a bay. The broker drops a live state (MQTT 5) once it is too old; the final one
        stays."""
        expiry_s = None if state.reason is Reason.SHUTDOWN else math.ceil(self._stale_after_ms / 1000)
        found = []
        for kind, build in self._state_topics:
            built = build(state, self._gateway, self._offset_ns(), self._stale_after_ms)
            topic = self._topics.of(state.bay, kind.name)
            found.append(MqttMessage(topic, payloads.encode(built), kind.retained, expiry_s, kind.qos))
            if kind is STATE and self._config.values:
                found += self._values[state.bay].messages(built, self._clock.now_ns())
        return found

    async def _publish_all(self, link: BrokerLink, found: Sequence[MqttMessage]) -> None:
        for message in found:
            await self._publish(link, message)

    async def _publish_alarms(self, link: BrokerLink, bay: str, sent: BayAlarms) -> NoReturn:
        """One bay's alarms: a change within ALARMS_S, and once a period."""
        sent_ns = self._clock.now_ns()
        while True:
            await self._clock.sleep(ALARMS_S)
            now_ns = self._clock.now_ns()
            known = self._alarms(bay, now_ns)
            if known != sent or now_ns - sent_ns >= ALARMS_PERIOD_S * NS_PER_S:
                sent, sent_ns = known, now_ns
                await self._publish(link, self._alarms_message(bay, known))

    def _alarms_message(self, bay: str, known: BayAlarms) -> MqttMessage:
        stale_after_ms = round(1000 * (3 * ALARMS_PERIOD_S + 1))
        payload = alarms_payload(known, bay, self._gateway, self._clock.now_ns(), self._offset_ns(), stale_after_ms)
        expiry_s = math.ceil(stale_after_ms / 1000) if known.evaluated else None
        return MqttMessage(self._topics.of(bay, ALARMS.name), payloads.encode(payload), ALARMS.retained, expiry_s)

    async def _publish_status(self, link: BrokerLink) -> NoReturn:
        """`online`, again and again: it proves the link, and heals a late will of an older connection of ours."""
        while True:
            await self._publish(link, self._status_message("running"))
            await asyncio.sleep(STATUS_SHARE * self._config.keepalive_s)

    async def _publish_final(self, link: BrokerLink) -> None:
        now_ns = self._clock.now_ns()
        for bay in self._hub.bays:  # first: a dead bay must not look alive, if there is time for nothing else
            await self._publish_all(link, self._state_messages(payloads.final(self._hub.shown(bay, now_ns), now_ns)))
        await self._events.deliver(link, rest=True)
        for bay in self._hub.bays:
            await self._publish(link, self._alarms_message(bay, BayAlarms()))
        await self._publish(link, self._status_message("shutdown"))
        self._final_published = True

    async def _publish(self, link: BrokerLink, message: MqttMessage) -> None:
        """A state, a status or an announcement. What the broker does not take is dropped, and counted: there will be a
        newer one."""
        if message.topic in self._answers.held(self._clock.now_ns()):
            self._refused += 1
            return
        try:
            await self._send(link, message)
        except PublishRefusedError as error:
            self._refused += 1
            self._answers.refused(message.topic, error.fault, self._clock.now_ns())
        else:
            self._answers.taken(message.topic)

    async def _send(self, link: BrokerLink, message: MqttMessage) -> bool:
        """See `BrokerLink.publish`."""
        try:
            subscribed = await link.publish(message)
        except LinkError:
            self._failed += 1
            raise
        self._published += 1
        return subscribed

    def _queue_event(self, event: Event) -> None:
        self._numbered += 1
        self._events.put(payloads.outbox_entry(event, self._numbered, self._gateway, self._offset_ns()))

    def _shown(self, bay: str) -> StateVector:
        return self._hub.shown(bay, self._clock.now_ns())

    def _discovery_message(self, bay: str) -> MqttMessage:
        topic = home_assistant.topic(self._config.home_assistant_prefix, self._topics, bay)
        return MqttMessage(topic, home_assistant.discovery(self._gateway, bay, self._stale_after_ms), retain=True)

    def _status_message(self, cause: messages.Cause) -> MqttMessage:
        facts = self._facts()
        own = payloads.gateway_payload(facts, self._session.figures.get("certificate_days"))
        health = [self._health(bay, facts) for bay in self._hub.bays]
        payload = payloads.status_payload(self._gateway, cause, self._clock.wall_ns(), self.stats, own, health)
        return MqttMessage(self._topics.status, payloads.encode(payload), retain=True)

    def _health(self, bay: str, facts: GatewayFacts) -> messages.BayHealthPayload:
        state, alarms = self._shown(bay), self._alarms(bay, self._clock.now_ns())
        visit = facts.last_visits.get(bay)
        return payloads.bay_health(state, self._titles.get(bay, ""), alarms, visit, self._offset_ns())

    def _offset_ns(self) -> int:
        return self._clock.wall_ns() - self._clock.now_ns()


def _urgent(state: StateVector) -> Urgent:
    """The values whose change is published at once."""
    return (
        state.stop,
        state.may_move,
        state.in_place,
        state.visit.moved,
        state.reason,
        state.vision.quality,
        state.range.quality,
    )
