"""From real bytes on a real port to readings: pty, socket:// and rfc2217://, with every cable fault a pty can have.

A pty has no baud rate, so a wrong one cannot be tried here; what it does to the bytes (garbage) can.
"""

import asyncio
import contextlib
import os
import random
import socket
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from typing import Any

import pytest
import serial
import serial.rfc2217

from gateway.clock import Clock, SystemClock
from gateway.config import RangerConfig, Reconnect
from gateway.core.readings import Quality, RangeReading
from gateway.errors import LinkError
from gateway.ranger.hcsr04.protocol import Hello, Measurement, encode_hello, encode_measurement
from gateway.ranger.hcsr04.session import Hcsr04Session
from gateway.ranger.ranger_service import RangerService
from gateway.sim import ranger_board
from gateway.sim.hcsr04 import SensorErrors
from gateway.sim.ranger import SimulatedRanger
from gateway.sim.ranger_board import RangerFault
from gateway.supervisor import Supervisor, Task
from tests.virtual_time import in_real_time

HELLO = encode_hello(Hello("test", 1, 60, 1))
QUICK = Reconnect(min_s=0.05, max_s=0.1)


@pytest.fixture(autouse=True)
def no_thread_survives() -> Iterator[None]:
    yield
    assert [t.name for t in threading.enumerate() if "ranger" in t.name.lower() or "2217" in t.name] == []


class Host:
    """The service under a supervisor, and everything it said, with the time it was said."""

    def __init__(self, port: str, clock: Clock, **config: Any) -> None:
        self.clock = clock
        self.said: list[tuple[int, RangeReading]] = []
        self._changed = asyncio.Event()
        self.service = RangerService(RangerConfig(port=port, **config), clock, self._heard)
        self.supervisor = Supervisor([Task("ranger", self.service.run, QUICK)], clock)

    @property
    def session(self) -> Hcsr04Session:
        assert isinstance(self.service.session, Hcsr04Session)
        return self.service.session

    def _heard(self, reading: RangeReading) -> None:
        self.said.append((self.clock.now_ns(), reading))
        self._changed.set()

    async def until(self, wanted: Callable[[RangeReading], bool], seconds: float = 30.0) -> RangeReading:
        """The first reading from now on that is wanted; `seconds` are the machine's."""
        seen = len(self.said)
        async with asyncio.timeout(seconds):
            while True:
                for _, reading in self.said[seen:]:
                    if wanted(reading):
                        return reading
                seen = len(self.said)
                self._changed.clear()
                await self._changed.wait()

    async def until_good(self, seconds: float = 30.0) -> RangeReading:
        return await self.until(lambda r: r.quality is Quality.GOOD, seconds)

    @property
    def measured(self) -> list[tuple[int, RangeReading]]:
        """The readings with a distance, and when they were said."""
        return [(at, r) for at, r in self.said if r.distance_mm is not None]

    async def until_measured(self, readings: int) -> None:
        """Until there are so many with a distance, from the beginning on."""
        await self.until(lambda _: len(self.measured) >= readings)


@contextlib.asynccontextmanager
async def connected(speed: float = 1.0, **ranger: Any) -> AsyncIterator[tuple[SimulatedRanger, Host]]:
    """A ranger 500 mm before its target, and a host that reads it."""
    clock = SystemClock(speed=speed)
    async with SimulatedRanger(lambda t: 500.0, clock, **ranger) as made:
        host = Host(made.port, clock)
        async with together(made.run, host.supervisor.run):
            yield made, host


@contextlib.asynccontextmanager
async def together(*work: Callable[[], Coroutine[Any, Any, None]]) -> AsyncIterator[None]:
    """Run these beside the test, and cancel them at its end."""
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(each()) for each in work]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()


async def eventually(fact: Callable[[], bool], seconds: float = 30.0) -> None:
    """Until `fact` holds; `seconds` are the machine's."""
    clock = asyncio.get_running_loop().time
    deadline = clock() + seconds
    while not fact():
        assert clock() < deadline, "not in time"
        await asyncio.sleep(0.01)


def line(seq: int, mm: float) -> bytes:
    return encode_measurement(Measurement(seq & 0xFFFF, round(mm * 4000 / 343.42)))


# -- pty --------------------------------------------------------------------------------------------------------------


@in_real_time
async def test_distances_arrive_dated_and_in_time() -> None:
    clock = SystemClock()
    origin_ns = clock.now_ns()

    def truth(t_ns: int) -> float:
        return 520.0 - 60.0 * (t_ns - origin_ns) / 1e9

    exact = SensorErrors(0.0, 0.0, 0.0)
    async with SimulatedRanger(truth, clock, errors=exact) as ranger:
        host = Host(ranger.port, clock)
        async with together(ranger.run, host.supervisor.run):
            await host.until_measured(40)
        # Too fresh a date makes the distance look too long. A busy machine does that to some, by 150 ms at most.
        errors = [(r.distance_mm or 0) - truth(r.t_ns) for _, r in host.measured]
        assert min(errors) == pytest.approx(0.0, abs=0.5)
        assert max(errors) < 0.15 * 60.0 + 0.5
        flight_ns = len(line(1, 500.0)) * 10 * 1e9 / 9600
        assert min(at - r.t_ns for at, r in host.measured) >= flight_ns
        assert host.measured[-1][1].stats.damaged == 0
        assert host.session.hello == Hello("hcsr04-sim", 1, 60, 1)


@in_real_time
async def test_cancelling_ends_the_thread_and_frees_the_port() -> None:
    clock = SystemClock()
    async with SimulatedRanger(lambda t: 500.0, clock) as ranger:
        host = Host(ranger.port, clock)
        async with together(ranger.run):
            async with together(host.supervisor.run):
                await host.until_good()
                said = len(host.said)
            assert [t.name for t in threading.enumerate() if t.name.startswith("ranger")] == []
            await eventually(lambda: not ranger.opened)  # the far end looks up now and then
            assert len(host.said) <= said + 2


@in_real_time
async def test_a_released_port_is_free_for_this_time_and_link_down() -> None:
    clock = SystemClock()
    async with SimulatedRanger(lambda _: 500.0, clock) as ranger:
        host = Host(ranger.port, clock)
        async with together(ranger.run, host.supervisor.run):
            await host.until_measured(3)
            released_ns = clock.now_ns()
            host.service.release(0.8)
            lost = await host.until(lambda r: r.quality is Quality.LINK_DOWN)
            assert "released, for the board's firmware" in lost.detail
            with serial.Serial(ranger.port, exclusive=True):
                pass
            await host.until_measured(3)
            assert clock.now_ns() - released_ns > 0.8e9


@in_real_time
async def test_unplug_and_replug() -> None:
    async with connected(speed=2.0) as (ranger, host):
        before = await host.until_good()
        for n in (1, 2, 3):
            ranger.forced[RangerFault.UNPLUGGED] = 0.0
            down = await host.until(lambda r: r.quality is Quality.LINK_DOWN)
            assert down.detail.startswith(f"ranger port {ranger.port}")
            missing = await host.until(lambda r: "no such device" in r.detail)
            assert missing.quality is Quality.LINK_DOWN
            del ranger.forced[RangerFault.UNPLUGGED]
            after = await host.until_good()
            assert after.distance_mm == pytest.approx(500.0, abs=12.1)
            assert after.stats.reopens == n
        assert after.stats.lines > before.stats.lines
        assert after.stats.gaps == 0  # another connection is not a gap
    assert host.supervisor.records["ranger"].crashes == 0


@in_real_time
async def test_a_question_is_answered_over_the_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hello at boot went unheard; without the question the next one would come after ten minutes."""
    monkeypatch.setattr(ranger_board, "HELLO_NS", 600_000_000_000)
    clock = SystemClock()
    async with SimulatedRanger(lambda t: 500.0, clock) as ranger, together(ranger.run):
        await eventually(lambda: ranger.dropped_bytes > 100)  # nobody listens, nothing piles up
        host = Host(ranger.port, clock)
        async with together(host.supervisor.run):
            await host.until_good()


@in_real_time
async def test_a_second_program_cannot_steal_the_port() -> None:
    clock = SystemClock()
    async with SimulatedRanger(lambda t: 500.0, clock) as ranger:
        first, second = Host(ranger.port, clock), Host(ranger.port, clock)
        async with together(ranger.run, first.supervisor.run):
            await first.until_good()
            with pytest.raises(LinkError, match="another program uses it"):
                await second.service.run()
            await first.until_good()


@in_real_time
async def test_a_host_that_never_reads_costs_bytes_and_nothing_else() -> None:
    clock = SystemClock(speed=50.0)
    async with SimulatedRanger(lambda t: 500.0, clock) as ranger, together(ranger.run):
        lazy = os.open(ranger.port, os.O_RDWR | os.O_NOCTTY)
        try:
            await eventually(lambda: ranger.dropped_bytes > 1000)
            assert ranger.opened
        finally:
            os.close(lazy)
        host = Host(ranger.port, SystemClock())
        async with together(host.supervisor.run):
            await host.until(lambda r: r.quality is Quality.WAITING)  # still opens, still alive


@in_real_time
async def test_a_terminal_program_sees_the_bytes_as_they_are_sent() -> None:
    """Opened without any setting of the line: no echo, CR LF untouched."""
    wanted = encode_hello(Hello("hcsr04-sim", 1, 60, 1)) + line(0, 250.0) + line(1, 250.0)
    clock = SystemClock()
    async with SimulatedRanger(lambda t: 250.0, clock, errors=SensorErrors(0.0, 0.0, 0.0)) as ranger:
        terminal = os.open(ranger.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            async with together(ranger.run):
                seen = bytearray()

                def complete() -> bool:
                    with contextlib.suppress(BlockingIOError):
                        seen.extend(os.read(terminal, 4096))
                    return len(seen) >= len(wanted)

                await eventually(complete)
        finally:
            os.close(terminal)
    assert seen.startswith(wanted)


# -- network ----------------------------------------------------------------------------------------------------------


class Server:
    """A serial server on a free loopback port."""

    def __init__(self, flood: bool = False) -> None:
        self._flood = flood
        self.connections = 0

    async def __aenter__(self) -> "Server":
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.url = f"socket://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"
        self._writers: list[asyncio.StreamWriter] = []
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        await self.hang_up()

    async def hang_up(self) -> None:
        for writer in self._writers:
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()
        self._writers = []

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self._writers.append(writer)
        try:
            while self._flood:
                writer.write(random.randbytes(65_536))
                await writer.drain()
            await asyncio.sleep(0.02)
            for n in range(5000, 6000):
                writer.write(HELLO if n % 20 == 0 else b"")
                writer.write(line(n, 500.0))
                await writer.drain()
                await asyncio.sleep(0.06)
        except (OSError, asyncio.CancelledError):
            writer.close()


@in_real_time
async def test_a_serial_server_that_hangs_up_is_called_again() -> None:
    async with Server() as server:
        host = Host(server.url, SystemClock())
        async with together(host.supervisor.run):
            await host.until_good()
            await server.hang_up()
            down = await host.until(lambda r: r.quality is Quality.LINK_DOWN)
            assert "was lost" in down.detail
            await host.until_good()
            assert server.connections == 2


@in_real_time
@pytest.mark.failure_mode("R13")
async def test_a_flooding_serial_server_does_not_hold_up_the_gateway() -> None:
    async with Server(flood=True) as server:
        host = Host(server.url, SystemClock())
        async with together(host.supervisor.run):
            await host.until(lambda r: r.quality is Quality.WAITING)
            async with asyncio.timeout(20):  # it takes 1; a flood that holds up each would hold them up for ever
                for _ in range(100):
                    await asyncio.sleep(0.01)
        assert host.session.stats.lines == 0


@pytest.mark.filterwarnings("ignore:set(Daemon|Name)\\(\\) is deprecated:DeprecationWarning")  # pyserial 3.5
@in_real_time
async def test_rfc2217_onto_a_pty() -> None:
    """A remote port whose server never answers SET_CONTROL."""
    clock = SystemClock()
    async with SimulatedRanger(lambda t: 500.0, clock) as ranger, together(ranger.run):
        with rfc2217_server(ranger.port) as url:
            host = Host(url, clock)
            async with together(host.supervisor.run):
                reading = await host.until_good()
                assert reading.distance_mm == pytest.approx(500.0, abs=12.1)


@contextlib.contextmanager
def rfc2217_server(path: str) -> Iterator[str]:
    """One connection, served by two threads with pyserial's own server side."""
    listener = socket.create_server(("127.0.0.1", 0))
    stop = threading.Event()

    class Connection:
        def __init__(self, peer: socket.socket) -> None:
            self._peer = peer

        def write(self, data: bytes) -> None:
            with contextlib.suppress(OSError):
                self._peer.sendall(data)

    class Deaf(serial.rfc2217.PortManager):
        def check_modem_lines(self, force_notification: bool = False) -> None:
            """A pty has none."""

        def _telnet_process_subnegotiation(self, suboption: bytes) -> None:
            if suboption[1:2] != serial.rfc2217.SET_CONTROL:
                super()._telnet_process_subnegotiation(suboption)  # type: ignore[misc]  # not in the stubs

    def serve() -> None:
        with contextlib.suppress(OSError):
            peer, _ = listener.accept()
            peer.settimeout(0.02)
            with peer, serial.Serial(path, timeout=0) as port:
                manager = Deaf(port, Connection(peer))  # type: ignore[arg-type]  # the stubs ask for ports
                while not stop.is_set():
                    if data := port.read(256):
                        peer.sendall(b"".join(manager.escape(data)))
                    try:
                        got = peer.recv(256)
                    except TimeoutError:
                        continue
                    if not got:
                        return
                    port.write(b"".join(manager.filter(got)))

    thread = threading.Thread(target=serve, name="serial server")
    thread.start()
    try:
        yield f"rfc2217://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        stop.set()
        listener.close()
        thread.join(5)
