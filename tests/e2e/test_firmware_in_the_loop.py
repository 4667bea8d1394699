"""The compiled firmware in the emulated Uno, on a real pty, before the real gateway: faults, resets, cables, trials."""

import asyncio
import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import psutil
import pytest

from gateway.clock import SystemClock
from gateway.core.readings import Quality
from gateway.ranger.hcsr04.protocol import Hello
from gateway.sim.emulator import EmulatedRanger
from gateway.sim.hcsr04 import SensorErrors
from gateway.sim.ranger_board import RangerFault
from gateway.supervisor import Supervisor, Task
from tests.e2e.conftest import Cli
from tests.e2e.played import dated_right, too_fresh_ns
from tests.e2e.processes import Gateway
from tests.e2e.test_ranger_port import QUICK, Host, together
from tests.firmware.bench_runs import built
from tests.virtual_time import in_real_time

EXACT = SensorErrors(0.0, 0.0, 0.0)


@pytest.fixture(autouse=True, scope="module")
def firmware_and_bench() -> None:
    built()


def ranger(clock: SystemClock, mm: float = 520.0, **options: Any) -> EmulatedRanger:
    return EmulatedRanger(lambda t_ns: mm, clock, errors=EXACT, **options)


def plugged(board: EmulatedRanger) -> bool:
    return os.path.lexists(board.port)


@in_real_time
async def test_a_moving_target_is_seen_where_it_is(tmp_path: Path) -> None:
    clock = SystemClock(speed=0.5)  # not faster: what a busy machine is late counts as so many times too fresh
    await asyncio.sleep(0.3)  # a clock that has been running: its time is not the machine's any more
    origin_ns = clock.now_ns()

    def truth(t_ns: int) -> float:
        return 900.0 - 100.0 * (t_ns - origin_ns) / 1e9

    log = tmp_path / "played"
    async with EmulatedRanger(truth, clock, errors=EXACT, log=log) as board:
        host = Host(board.port, clock)
        async with together(board.run, host.supervisor.run):
            await host.until_measured(40)
        assert host.session.stats.damaged == 0
        assert host.session.hello == Hello("hcsr04", 1, 60, 1)
    fresh_ns = too_fresh_ns(log, [r for _, r in host.measured], clock)
    assert dated_right(fresh_ns), fresh_ns


SEEN_AS = {
    RangerFault.SILENT: (0.0, Quality.STALE),
    RangerFault.NO_ECHO: (0.0, Quality.NO_ECHO),
    RangerFault.STUCK: (0.0, Quality.STUCK),
    RangerFault.TOO_NEAR: (0.0, Quality.TOO_NEAR),
    RangerFault.TOO_FAR: (0.0, Quality.TOO_FAR),
    RangerFault.SCATTER: (400.0, Quality.UNSTABLE),
    RangerFault.WILD: (2500.0, Quality.UNSTABLE),
    RangerFault.UNPLUGGED: (0.0, Quality.LINK_DOWN),
    RangerFault.WRONG_VERSION: (99.0, Quality.WRONG_VERSION),
}


@in_real_time
async def test_every_fault_is_seen_as_what_it_is_and_passes() -> None:
    clock = SystemClock(speed=2.0)
    async with ranger(clock) as board:
        host = Host(board.port, clock)
        async with together(board.run, host.supervisor.run):
            await host.until_good()
            for fault, (amount, quality) in SEEN_AS.items():
                board.forced[fault] = amount
                await host.until(lambda r, wanted=quality: r.quality is wanted)  # type: ignore[misc]  # bound now
                board.forced.clear()
                good = await host.until_good()
                assert fault is RangerFault.SCATTER or good.distance_mm == pytest.approx(520, abs=0.2)


@in_real_time
async def test_noise_on_the_wire_is_counted_and_no_distance_is_wrong() -> None:
    clock = SystemClock(speed=2.0)
    async with ranger(clock) as board:
        host = Host(board.port, clock)
        board.forced[RangerFault.LINE_NOISE] = 0.02
        async with together(board.run, host.supervisor.run):
            await host.until(lambda r: r.stats.damaged >= 25)
            board.forced.clear()
            # Every second line was damaged: twenty whole ones in a row, and the noise is over.
            await host.until(lambda _: len({r.stats.damaged for _, r in host.said[-20:]}) == 1, 60)
        said = [r.distance_mm for _, r in host.said if r.distance_mm is not None]
        assert said
        assert all(mm == pytest.approx(520, abs=0.2) for mm in said)


@in_real_time
@pytest.mark.failure_mode("R11")
async def test_opening_resets_an_uno_and_pulling_the_cable_takes_its_power() -> None:
    clock = SystemClock()
    async with ranger(clock, resets_on_open=True) as board:
        host = Host(board.port, clock)
        async with together(board.run, host.supervisor.run):
            await host.until_good()
            assert host.session.hello == Hello("hcsr04", 1, 60, 2)  # the reset line
            board.forced[RangerFault.UNPLUGGED] = 0.0
            await host.until(lambda r: r.quality is Quality.LINK_DOWN)
            assert not plugged(board)
            board.forced.clear()
            await host.until_good()
            assert host.session.stats.reopens >= 1


@in_real_time
@pytest.mark.failure_mode("R14")
async def test_a_wrong_baud_rate_is_named_and_never_a_distance() -> None:
    """The pty tells the bench the rate that the host has set; the bench samples the line at that rate."""
    clock = SystemClock(speed=2.0)
    async with ranger(clock) as board:
        wrong = Host(board.port, clock, baud=4800)
        async with together(board.run):
            async with together(wrong.supervisor.run):
                stale = await wrong.until(lambda r: r.quality is Quality.STALE)
                assert "wrong baud rate" in stale.detail
                await asyncio.sleep(0.5)
            assert [r for _, r in wrong.said if r.distance_mm is not None] == []
            right = Host(board.port, clock)
            async with together(right.supervisor.run):
                await right.until_good()


@in_real_time
async def test_a_killed_emulator_is_a_lost_port_and_comes_back() -> None:
    clock = SystemClock()
    async with ranger(clock) as board:
        host = Host(board.port, clock)
        far_end = Supervisor([Task("board", board.run, QUICK)], clock)
        async with together(far_end.run, host.supervisor.run):
            await host.until_good()
            (bench,) = benches(os.getpid())
            bench.kill()
            await host.until(lambda r: r.quality is Quality.LINK_DOWN)
            await host.until_good()
    assert benches(os.getpid()) == []
    assert not plugged(board)


def benches(pid: int) -> list[psutil.Process]:
    return [p for p in psutil.Process(pid).children(recursive=True) if p.name() == "bench"]


def test_nothing_survives_a_killed_gateway() -> None:
    with Gateway("simulate", "--ranger", "firmware", "--modbus-port", "0", "--json") as gateway:
        gateway.started()
        (bench,) = benches(gateway.process.pid)
        folder = Path(bench.cmdline()[bench.cmdline().index("--port") + 1]).parent
        assert folder.exists()
        gateway.process.send_signal(signal.SIGKILL)
        gateway.process.wait(10)
        deadline = time.monotonic() + 30
        while (bench.is_running() or folder.exists()) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not bench.is_running()
        assert not folder.exists()


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_papers_trials_pass_with_the_real_firmware(tmp_path: Path) -> None:
    """Three of the ten; every decision right, and an error that stays within the module's own steps and jitter.

    A busy machine may hold the emulated board back for longer than the range deadline: then the truck stands longer.
    """
    log = tmp_path / "played.jsonl"
    with Gateway(
        *("simulate", "--trials", "3", "--modbus-port", "0"),
        *("--no-hmi", "--json", "--ranger", "firmware", "--ranger-log", str(log)),
    ) as gateway:
        code = gateway.finish(280)
    (report,) = (row for row in gateway.rows if row["type"] == "trials")
    assert (report["number"], report["false_stops"], report["missed_stops"], report["undecided"]) == (3, 0, 0, 0)
    assert code == 0, gateway.stderr[-2000:]
    for trial in report["trials"]:
        assert trial["decision"] == trial["expected"] or trial["expected"] is None, trial
    assert report["worst_error_mm"] < 17.0
    played = [json.loads(line) for line in log.read_text().splitlines()]
    assert sum(row["type"] == "line" for row in played) > 200
    assert [row["mcusr"] for row in played if row["type"] == "reset"] == [1]


def test_a_log_needs_the_firmware(tmp_path: Path, cli: Cli) -> None:
    done = cli("simulate", "--ranger-log", str(tmp_path / "log"))
    assert (done.code, done.out) == (2, "")
    assert "--ranger firmware" in done.err
