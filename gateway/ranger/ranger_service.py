"""Runs any ranger: one thread reads the port and stamps the bytes, the session decides, readings go to the event loop.

The session lives on while `run` is called again and again by the supervisor, so its counters survive a pulled cable.
"""

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Callable

from gateway.clock import Clock
from gateway.config import RangerConfig
from gateway.config.sections.ranger import RANGERS
from gateway.core.readings import RangeReading
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.ranger.contract import Connection, RangerType
from gateway.ranger.port import READ_BYTES, Port, check_url

log = logging.getLogger(__name__)

FLOOD_PAUSE_S = 0.01
"""After a full read buffer: no ranger sends so much, and the other bays need the processor too."""
PENDING = 64
"""Readings waiting for the event loop: four seconds of them."""
END_S = 0.5
"""A cancelled `run` waits this long for its thread. Only a network connection that is still being made outlasts it; the
thread then closes it by itself."""


def ranger_type(config: RangerConfig) -> RangerType:
    """The ranger type of `[ranger] type`. Raises ConfigError for a name that is not registered."""
    found: RangerType = RANGERS.load(config.type)
    return found


def check_port(config: RangerConfig) -> None:
    """Raise ConfigError for a type or a port that can never work on any machine."""
    (ranger_type(config).check_url or check_url)(config.port)


class RangerService:
    """Reads one ranger and hands every reading to `emit`, on the event loop.

    `port` overrides the configured URL. Raises ConfigError at once for a port that no machine can open.
    """

    def __init__(
        self, config: RangerConfig, clock: Clock, emit: Callable[[RangeReading], None], port: str | None = None
    ) -> None:
        self.config = config.model_copy(update={"port": port}) if port else config
        check_port(self.config)
        self.clock = clock
        self.emit = emit
        self._type = ranger_type(config)
        self.session = self._type.session(config)
        self.undelivered = 0
        """Readings that a busy event loop did not take in time."""
        self._reader: _Reader | None = None
        self._released_until_ns = 0

    def connect(self) -> Connection:
        """Open the port. Blocks; raises LinkError."""
        connect = self._type.connect
        if connect is not None:
            return connect(self.config)
        return Port(self.config.port, self.config.baud, self.config.parity, self.config.stop_bits)

    def released(self) -> bool:
        """Is the port closed for others?"""
        return self.clock.now_ns() < self._released_until_ns

    def release(self, seconds: float) -> None:
        """Close the port for this time, LINK_DOWN: its board is given a firmware."""
        self._released_until_ns = self.clock.now_ns() + round(seconds * NS_PER_S)
        if self._reader is not None:
            self._reader.end(LinkError(f"ranger port {self.config.port}: released, for the board's firmware"))

    async def run(self) -> None:
        """Read until cancelled. Emits LINK_DOWN and raises LinkError when the port cannot be opened or is lost."""
        while (rest_ns := self._released_until_ns - self.clock.now_ns()) > 0:
            await self.clock.sleep(rest_ns / NS_PER_S)
        reader = self._reader = _Reader(self)
        try:
            await reader.ended.wait()
        finally:
            self._reader = None
            await reader.stop()
        error = reader.error or LinkError(f"ranger port {self.config.port}: the reading thread died")
        self.emit(self.session.lost(self.clock.now_ns(), str(error)))
        raise error


class _Reader:
    """One connection of a service, and its thread."""

    def __init__(self, service: RangerService) -> None:
        self.ended = asyncio.Event()
        self.error: LinkError | None = None
        self._service, self._session, self._clock = service, service.session, service.clock
        self._pending: deque[RangeReading] = deque(maxlen=PENDING)
        self._scheduled = False
        self._identity = ""
        self._loop = asyncio.get_running_loop()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"ranger {service.config.port}", daemon=True)
        self._thread.start()

    def end(self, error: LinkError) -> None:
        """The thread closes the port within READ_S; nothing is emitted any more."""
        self.error = error
        self._stop.set()

    async def stop(self) -> None:
        """End the thread; nothing is emitted any more."""
        self._stop.set()
        try:
            async with asyncio.timeout(END_S):
                await self.ended.wait()
        except TimeoutError:
            return  # still connecting, see END_S
        self._thread.join()

    def _work(self) -> None:
        try:
            connection = self._service.connect()
            try:
                self._read(connection)
            finally:
                connection.close()
        except LinkError as error:
            self.error = error
        finally:
            self._to_loop(self.ended.set)

    def _read(self, connection: Connection) -> None:
        session, clock = self._session, self._clock
        if self._stop.is_set():
            return  # the connection was made too late: a newer reader may own the session
        self._deliver(session.opened(clock.now_ns()))
        while not self._stop.is_set():
            if request := session.request(clock.now_ns()):
                connection.write(request)
            data = connection.read()
            now_ns = clock.now_ns()
            self._deliver(session.feed(data, now_ns) + session.tick(now_ns))
            if (identity := session.identity) != self._identity:
                self._identity = identity
                log.info("ranger port %s: %s", self._service.config.port, identity)
            if len(data) >= READ_BYTES:
                clock.block(FLOOD_PAUSE_S)

    def _deliver(self, readings: list[RangeReading]) -> None:
        for reading in readings:
            # A loop too busy to take them gets the newest; nothing piles up.
            self._service.undelivered += len(self._pending) == PENDING
            self._pending.append(reading)
        if readings and not self._scheduled:
            self._scheduled = True
            self._to_loop(self._hand_over)

    def _hand_over(self) -> None:
        self._scheduled = False  # before looking, so that nothing appended meanwhile is forgotten
        while self._pending and not self._stop.is_set():
            self._service.emit(self._pending.popleft())

    def _to_loop(self, callback: Callable[[], None]) -> None:
        try:
            self._loop.call_soon_threadsafe(callback)
        except RuntimeError:  # the loop is closed: the program ends
            self._stop.set()
