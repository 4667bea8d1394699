"""The current state of every bay: latest wins. Events queue, bounded, and every drop is counted. Readings pass through.

Single event loop, no locks: `publish` never waits. It runs no consumer but the functions that listen.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Sequence

from gateway.core.events import Event
from gateway.core.readings import RangeReading, VisionReading
from gateway.core.shown import shown
from gateway.core.state import StateVector

ReadingListener = Callable[[VisionReading | RangeReading], None]


class EventQueue:
    """One subscriber's bounded queue; the oldest event is dropped when it is full, and counted."""

    def __init__(self, limit: int) -> None:
        self._events: deque[Event] = deque(maxlen=limit)
        self._filled = asyncio.Event()
        self.dropped = 0

    def put(self, event: Event) -> None:
        if len(self._events) == self._events.maxlen:
            self.dropped += 1
        self._events.append(event)
        self._filled.set()

    async def get(self) -> Event:
        """The oldest event; waits for one."""
        while not self._events:
            self._filled.clear()
            await self._filled.wait()
        return self._events.popleft()

    def drain(self) -> list[Event]:
        """Everything queued now, oldest first; never waits."""
        events = list(self._events)
        self._events.clear()
        return events

    def __len__(self) -> int:
        return len(self._events)


class Hub:
    """Latest state per bay, and a fan-out of events."""

    def __init__(self, bays: Iterable[str]) -> None:
        self._states = {bay: StateVector(bay=bay) for bay in bays}
        self._changed: dict[str, asyncio.Event] = {bay: asyncio.Event() for bay in self._states}
        self._queues: list[EventQueue] = []
        self._listeners: list[Callable[[Event], None]] = []
        self._reading_listeners: dict[str, list[ReadingListener]] = {bay: [] for bay in self._states}

    @property
    def bays(self) -> tuple[str, ...]:
        return tuple(self._states)

    @property
    def dropped(self) -> int:
        """Events dropped because a subscriber's queue was full."""
        return sum(queue.dropped for queue in self._queues)

    def state(self, bay: str) -> StateVector:
        """The newest state, however old: for its control task only. All others call `shown`."""
        return self._states[bay]

    def shown(self, bay: str, now_ns: int) -> StateVector:
        """The newest state as it may be shown at `now_ns` (monotonic)."""
        return shown(self._states[bay], now_ns)

    def publish(self, state: StateVector, events: Sequence[Event] = ()) -> None:
        self._changed[state.bay].set()  # a KeyError here: no such bay
        self._changed[state.bay] = asyncio.Event()
        self._states[state.bay] = state
        for event in events:
            for listener in self._listeners:
                listener(event)
            for queue in self._queues:
                queue.put(event)

    async def newer(self, bay: str, seq: int) -> int:
        """Wait for a state with a sequence number above `seq`; the newest one's. States in between are skipped."""
        while (state := self._states[bay]).seq <= seq:
            await self._changed[bay].wait()
        return state.seq

    def listen(self, listener: Callable[[Event], None]) -> None:
        """`listener` is called with every event before `publish` returns: it must not wait, and must not raise."""
        self._listeners.append(listener)

    def offer(self, bay: str, reading: VisionReading | RangeReading) -> None:
        """A sensor's newest reading: to the bay's control task, and to whoever else listens."""
        for listener in self._reading_listeners[bay]:
            listener(reading)

    def listen_to_readings(self, bay: str, listener: ReadingListener) -> None:
        """`listener` is called with every reading, after those that were given before it: the control task comes first.
        It must not wait, and must not raise."""
        self._reading_listeners[bay].append(listener)

    def subscribe(self, limit: int = 1000) -> EventQueue:
        queue = EventQueue(limit)
        self._queues.append(queue)
        return queue
