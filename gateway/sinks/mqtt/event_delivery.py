"""Events from the outbox to the broker: several on their way at once, in order, until each is acknowledged. IO.

The first event of a topic on a connection goes alone, and so does every one after an answer that was not good: what
follows it then cannot overtake it. How many are on their way grows from one with every acknowledgement that comes
soon, and is halved by one that comes late, so that a slow link is never full of them.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable

from gateway.clock import Clock
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.sinks.mqtt.broker_link import BrokerLink, PublishRefusedError
from gateway.sinks.mqtt.topic_answers import TopicAnswers
from gateway.sinks.mqtt.topics import MqttMessage
from gateway.sinks.outbox.outbox import Outbox, OutboxEntry

EXPIRED_AT_ONCE = 100  # before others on the event loop have their turn
LATE_S = 0.001  # a timer may end a moment too soon, and its topic is held then
SHARE = 0.75  # of what may be on its way at once: states must not wait for events

log = logging.getLogger(__name__)

Send = Callable[[BrokerLink, MqttMessage], Awaitable[bool]]


class Window:
    """How many events may be on their way at once. `slow_ns`: an acknowledgement that takes this long comes late."""

    def __init__(self, limit: int, slow_ns: int) -> None:
        self._limit = max(1, limit)
        self._slow_ns = slow_ns
        self.size = 1

    def acknowledged(self, took_ns: int) -> None:
        self.size = min(self._limit, self.size + 1) if took_ns < self._slow_ns else max(1, self.size // 2)


class EventDelivery:
    """`send` publishes; it returns whether anybody subscribes, and raises as `BrokerLink.publish`. `expiry_s`: for how
    long the broker keeps an event. `in_flight`: how many may be on their way at most. `unsubscribed_s`: an event that
    nobody subscribed to is kept for this time; 0: it counts as delivered. `slow_s`: see `Window`."""

    def __init__(
        self,
        outbox: Outbox,
        answers: TopicAnswers,
        clock: Clock,
        send: Send,
        *,
        expiry_s: int,
        in_flight: int,
        unsubscribed_s: float,
        slow_s: float,
    ) -> None:
        self._outbox = outbox
        self._answers = answers
        self._clock = clock
        self._send = send
        self._expiry_s = expiry_s
        self._in_flight = in_flight
        self._unsubscribed_ns = round(unsubscribed_s * NS_PER_S)
        self._slow_ns = round(slow_s * NS_PER_S)
        self._on_its_way: dict[str, str] = {}  # id -> topic
        self._changed = asyncio.Event()
        self._ending = False

    def put(self, entry: OutboxEntry) -> None:
        """Never waits."""
        self._outbox.put(entry)
        self._changed.set()

    def end(self) -> None:
        """Send no more; `deliver` returns once what is on its way is acknowledged."""
        self._ending = True
        self._changed.set()

    @property
    def held(self) -> int:
        """Events of topics that are refused, or that nobody subscribes to."""
        return self._outbox.count(self._answers.not_delivered)

    async def deliver(self, link: BrokerLink, *, rest: bool = False) -> None:
        """Until `end`; or, for the `rest`, until nothing is left that may be sent. Raises LinkError in a group."""
        window = Window(min(self._in_flight, int(SHARE * link.in_flight)), self._slow_ns)
        self._on_its_way.clear()  # of the connection before
        async with asyncio.TaskGroup() as group:
            while True:
                self._changed.clear()
                if rest or not self._ending:
                    for entry in self._next(window.size):
                        group.create_task(self._deliver(link, entry, window))
                if not self._on_its_way and (rest or self._ending):
                    return
                await self._wait()

    def _next(self, size: int) -> list[OutboxEntry]:
        """What is to be sent now, in order; it counts as on its way."""
        found: list[OutboxEntry] = []
        while len(self._on_its_way) < size and (entry := self._following()) is not None:
            self._on_its_way[entry.id] = entry.topic
            found.append(entry)
        return found

    def _following(self) -> OutboxEntry | None:
        busy = {topic for topic in self._on_its_way.values() if not self._answers.pipelined(topic)}
        without = busy | self._answers.held(self._clock.now_ns())
        for entry in self._outbox.batch(len(self._on_its_way) + 1, without):
            if entry.id not in self._on_its_way:
                return entry
        return None

    async def _deliver(self, link: BrokerLink, entry: OutboxEntry, window: Window) -> None:
        begun_ns = self._clock.now_ns()
        try:
            subscribed = await self._send(link, MqttMessage(entry.topic, entry.payload, False, self._expiry_s))
            window.acknowledged(self._clock.now_ns() - begun_ns)
            if subscribed or not self._unsubscribed_ns:
                self._answers.taken(entry.topic)
                self._outbox.set_unused(entry.topic, False)
                self._outbox.acknowledge(entry.id)
            else:
                await self._passed_to_nobody(entry.topic)
        except PublishRefusedError as error:
            self._answers.refused(entry.topic, error.fault, self._clock.now_ns())
        finally:
            self._on_its_way.pop(entry.id, None)
            self._changed.set()

    async def _passed_to_nobody(self, topic: str) -> None:
        """Keep what waits of it, for long enough. A topic that nobody uses must not take the room of others."""
        now_ns = self._clock.now_ns()
        self._answers.passed_to_nobody(topic, now_ns)
        if self._answers.unsubscribed_ns(topic, now_ns) >= self._unsubscribed_ns:
            self._answers.unused(topic)
            age_ms, now_ms = self._unsubscribed_ns // NS_PER_MS, self._clock.wall_ns() // NS_PER_MS
            self._outbox.set_unused(topic, True)
            while gone := self._outbox.expire(topic, age_ms, now_ms, EXPIRED_AT_ONCE):
                log.info("%s: %d events given up: nobody has subscribed to them", topic, len(gone))
                await asyncio.sleep(0)
        self._outbox.set_unused(topic, not self._answers.is_used(topic))

    async def _wait(self) -> None:
        """Until an event was put or answered, or a held topic is to be tried again."""
        now_ns = self._clock.now_ns()
        waiting = [topic for topic in self._answers.held(now_ns) if self._outbox.count([topic])]
        with contextlib.suppress(TimeoutError):
            if waiting:
                wait_ns = min(map(self._answers.until_ns, waiting)) - now_ns
                async with self._clock.timeout(wait_ns / NS_PER_S + LATE_S):
                    await self._changed.wait()
            else:
                await self._changed.wait()
