"""The ranger's shell: one thread reads the port and stamps what comes; the session decides; readings go to the loop.

The session lives on while `run` is called again and again by the supervisor, so its counters survive a pulled cable.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Callable

from gateway.clock import Clock
from gateway.config import RangerConfig
from gateway.core.model import RangeReading
from gateway.errors import LinkError
from gateway.ranger.hcsr04.protocol import QUESTION
from gateway.ranger.hcsr04.session import Session
from gateway.ranger.port import READ_BYTES, Port, check_url

FLOOD_PAUSE_S = 0.01
"""After a full read buffer: no ranger sends so much, and the other bays need the processor too."""
PENDING = 64
"""Readings waiting for the event loop: four seconds of them."""
END_S = 0.5
"""A cancelled `run` waits so long for its thread. Only a network connection that is still being made outlasts it; the
thread then closes it by itself."""


class RangerService:
    """Reads one ranger and hands every reading to `emit`, on the event loop.

    `port` overrides the configured URL. Raises ConfigError at once for a URL that no machine can open.
    """

    def __init__(
        self, config: RangerConfig, clock: Clock, emit: Callable[[RangeReading], None], port: str | None = None
    ) -> None:
        self._url = port or config.port
        check_url(self._url)
        self._baud = config.baud
        self._clock = clock
        self._emit = emit
        self.session = Session(config)

    async def run(self) -> None:
        """Read until cancelled. Emits LINK_DOWN and raises LinkError when the port cannot be opened or is lost."""
        reader = _Reader(self._url, self._baud, self._clock, self.session, self._emit)
        try:
            await reader.ended.wait()
        finally:
            await reader.stop()
        error = reader.error or LinkError(f"ranger port {self._url}: the reading thread died")
        self._emit(self.session.lost(self._clock.now_ns(), str(error)))
        raise error


class _Reader:
    """One connection and its thread."""

    def __init__(
        self, url: str, baud: int, clock: Clock, session: Session, emit: Callable[[RangeReading], None]
    ) -> None:
        self.ended = asyncio.Event()
        self.error: LinkError | None = None
        self._url, self._baud, self._clock, self._session, self._emit = url, baud, clock, session, emit
        self._pending: deque[RangeReading] = deque(maxlen=PENDING)
        self._scheduled = False
        self._loop = asyncio.get_running_loop()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"ranger {url}", daemon=True)
        self._thread.start()

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
            port = Port(self._url, self._baud)
            try:
                self._read(port)
            finally:
                port.close()
        except LinkError as error:
            self.error = error
        finally:
            self._to_loop(self.ended.set)

    def _read(self, port: Port) -> None:
        session, clock = self._session, self._clock
        if self._stop.is_set():
            return  # the connection came too late: a newer reader may own the session
        self._deliver(session.opened(clock.now_ns()))
        while not self._stop.is_set():
            if session.question_due(clock.now_ns()):
                port.write(QUESTION)
            data = port.read()
            now_ns = clock.now_ns()
            self._deliver(session.feed(data, now_ns) + session.tick(now_ns))
            if len(data) >= READ_BYTES:
                clock.block(FLOOD_PAUSE_S)

    def _deliver(self, readings: list[RangeReading]) -> None:
        for reading in readings:
            # A loop too busy to take them gets the newest; nothing piles up.
            self._session.undelivered += len(self._pending) == PENDING
            self._pending.append(reading)
        if readings and not self._scheduled:
            self._scheduled = True
            self._to_loop(self._hand_over)

    def _hand_over(self) -> None:
        self._scheduled = False  # before looking, so that nothing appended meanwhile is forgotten
        while self._pending and not self._stop.is_set():
            self._emit(self._pending.popleft())

    def _to_loop(self, callback: Callable[[], None]) -> None:
        try:
            self._loop.call_soon_threadsafe(callback)
        except RuntimeError:  # the loop is closed: the program ends
            self._stop.set()
