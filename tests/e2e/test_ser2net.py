"""ser2net, a serial server that we did not write, between the emulated board and the gateway: raw and RFC 2217."""

import asyncio
import contextlib
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from gateway.clock import SystemClock
from gateway.core.readings import Quality
from gateway.ranger.arrival_times import Arrival
from gateway.ranger.hcsr04.protocol import Hello
from gateway.sim.emulator import EmulatedRanger
from gateway.sim.hcsr04 import SensorErrors
from gateway.sim.ranger_board import RangerFault
from tests.e2e.brokers import SEARCH, free_port
from tests.e2e.played import dated_right, lines, too_fresh_ns
from tests.e2e.test_ranger_port import Host, eventually, together
from tests.firmware.bench_runs import built
from tests.virtual_time import in_real_time

EXACT = SensorErrors(0.0, 0.0, 0.0)
SPEED_MM_S = 200.0
ACCEPTER = {"socket": "tcp", "rfc2217": "telnet(rfc2217),tcp"}


@pytest.fixture(autouse=True, scope="module")
def firmware_and_bench() -> None:
    built()


class Ser2net:
    """A context manager: ser2net serving `device` on a free loopback port."""

    def __init__(self, folder: Path, device: str, kind: str) -> None:
        self._folder, self._device, self._kind = folder, device, kind

    @property
    def url(self) -> str:
        return f"{self._kind}://127.0.0.1:{self.port}"

    def __enter__(self) -> Self:
        program = shutil.which("ser2net", path=SEARCH)
        assert program is not None, "ser2net is missing: apt-get install ser2net"
        self.port = free_port()
        config = self._folder / "ser2net.yaml"
        config.write_text(
            "connection: &ranger\n"
            f"  accepter: {ACCEPTER[self._kind]},127.0.0.1,{self.port}\n"
            f"  connector: serialdev,{self._device},9600n81,local\n"
        )
        self._log = (self._folder / "ser2net.log").open("wb")
        self.process = subprocess.Popen([program, "-n", "-d", "-c", str(config)], stdout=self._log, stderr=self._log)
        deadline = time.monotonic() + 30
        while not self._listens():
            log = (self._folder / "ser2net.log").read_text()
            assert self.process.poll() is None, log
            assert time.monotonic() < deadline, log
            time.sleep(0.05)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(5)
        self._log.close()

    def _listens(self) -> bool:
        """Looked up, not tried: a connection would open the device."""
        wanted = f"0100007F:{self.port:04X} 00000000:0000 0A"
        return wanted in Path("/proc/net/tcp").read_text()

    @contextlib.contextmanager
    def stalled(self) -> Iterator[None]:
        """It stands still, as a network does; what comes meanwhile waits in buffers."""
        self.process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self.process.send_signal(signal.SIGCONT)


async def stall(server: Ser2net, log: Path) -> None:
    """While the board sends 25 lines, which takes it 1.5 s where the machine has room."""
    sent = lines(log)
    with server.stalled():
        await eventually(lambda: lines(log) >= sent + 25)


class Approach:
    """A target that comes nearer all the time, so that an old distance is a wrong one."""

    def __init__(self, clock: SystemClock) -> None:
        self._origin_ns = clock.now_ns()

    def __call__(self, t_ns: int) -> float:
        return 3500.0 - SPEED_MM_S * (t_ns - self._origin_ns) / 1e9


@pytest.mark.mostly_long
@pytest.mark.filterwarnings("ignore:set(Daemon|Name)\\(\\) is deprecated:DeprecationWarning")  # pyserial 3.5
@pytest.mark.parametrize("kind", ACCEPTER)
@in_real_time
@pytest.mark.failure_mode("R12")
async def test_distances_come_through_and_a_stall_never_makes_an_old_one_look_fresh(kind: str, tmp_path: Path) -> None:
    clock = SystemClock()
    truth = Approach(clock)
    log = tmp_path / "played"
    async with EmulatedRanger(truth, clock, errors=EXACT, log=log) as board:
        with Ser2net(tmp_path, board.port, kind) as server:
            host = Host(server.url, clock)
            async with together(board.run, host.supervisor.run):
                await host.until_good()
                assert host.session.hello == Hello("hcsr04", 1, 60, 1)  # it asked, through the server
                await host.until_measured(10)
                before = host.session.stats
                assert before.damaged <= 1  # opening an RFC 2217 port empties buffers, perhaps amid a line
                await stall(server, log)
                await host.until_measured(len(host.measured) + 15)
                after = host.session.stats
                assert after.rejected - before.rejected >= 10  # the held-up lines
                assert after.damaged == before.damaged
    fresh_ns = too_fresh_ns(log, [r for _, r in host.measured], clock)
    assert dated_right(fresh_ns), fresh_ns


@in_real_time
async def test_a_stale_backlog_at_the_start_is_not_used(tmp_path: Path) -> None:
    """The server stalls as soon as it has passed the gateway's question on: what it then hands out at once is old."""
    clock = SystemClock()
    truth = Approach(clock)
    log = tmp_path / "played"
    async with EmulatedRanger(truth, clock, errors=EXACT, log=log) as board:
        with Ser2net(tmp_path, board.port, "socket") as server:
            host = Host(server.url, clock)
            async with together(board.run, host.supervisor.run):
                await asyncio.to_thread(wait_for_a_question, log)
                await stall(server, log)
                await host.until_measured(15)
            assert host.session.unused[Arrival.BACKLOG] >= 10
    fresh_ns = too_fresh_ns(log, [r for _, r in host.measured], clock)
    assert dated_right(fresh_ns), fresh_ns


def wait_for_a_question(log: Path) -> None:
    """Until the board has heard the host."""
    deadline = time.monotonic() + 30
    while '"heard"' not in log.read_text():
        assert time.monotonic() < deadline
        time.sleep(0.002)


@in_real_time
async def test_a_board_that_is_unplugged_behind_the_server_is_noticed_and_found_again(tmp_path: Path) -> None:
    clock = SystemClock()
    async with EmulatedRanger(lambda t_ns: 520.0, clock, errors=EXACT) as board:
        with Ser2net(tmp_path, board.port, "socket") as server:
            host = Host(server.url, clock)
            async with together(board.run, host.supervisor.run):
                await host.until_good()
                board.forced[RangerFault.UNPLUGGED] = 0.0
                await host.until(lambda r: r.quality in (Quality.LINK_DOWN, Quality.STALE))
                board.forced.clear()
                good = await host.until_good()
                assert good.distance_mm == pytest.approx(520, abs=0.2)
