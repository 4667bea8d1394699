"""The relay's wire, from a running gateway to the pin of the emulated board: on with the truck in place, and off by
itself when nothing renews it."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gateway.sim.emulator import ELF
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway, Row
from tests.e2e.test_doctor import draw_truck
from tests.e2e.test_run import port_of
from tests.firmware.bench_runs import built

MS = 1_000_000
IN_PLACE = 1
DROPS_MS = 300
PATIENCE_S = 60.0


class Board:
    """The bench in real time, which outlives the gateway."""

    def __init__(self, folder: Path) -> None:
        self.port, self._played = folder / "ranger", folder / "played"

    @contextmanager
    def running(self, distance_mm: float) -> Iterator[None]:
        line = [str(built()), "--elf", str(ELF), "--port", str(self.port), "--truth", str(self._played), "--stdin"]
        with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as bench:
            assert bench.stdin is not None
            assert bench.stdout is not None
            bench.stdin.write(f"distance {distance_mm}\n")
            bench.stdin.flush()
            assert bench.stdout.readline().startswith("ready")
            try:
                yield
            finally:
                bench.stdin.close()
                bench.wait(10)

    @property
    def rows(self) -> list[Row]:
        return [json.loads(line) for line in self._played.read_text().splitlines(keepends=True) if line.endswith("\n")]

    def until(self, wanted: int) -> int:
        """Waits until this is what the pins are. Since when, in the board's time."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            changes = [row for row in self.rows if row["type"] == "relay"]
            if changes and changes[-1]["pins"] == wanted:
                return int(changes[-1]["t_ns"])
            time.sleep(0.02)
        raise AssertionError(f"pins {wanted} not within {PATIENCE_S:g} s")

    def time_of(self, monotonic_ns: int) -> int:
        """A moment of the machine in the board's time, which may lag on a busy machine, but is never ahead."""
        return monotonic_ns - int(self.rows[0]["origin_ns"])


def test_the_wire_is_on_in_place_and_drops_when_the_gateway_stands_still_or_is_killed(tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    board, config = Board(tmp_path), tmp_path / "bay.toml"
    config.write_text(f"""
instance = "test-{os.getpid()}"
state_dir = ""
[modbus]
host = "127.0.0.1"
port = 0
[camera]
url = "{draw_truck(tmp_path / "pictures", 27)}"
loop = true
fps = 10
deadline_s = 5.0
[fusion]
vision_deadline_s = 3.0
[ranger]
port = "{board.port}"
[ranger.hcsr04]
relay = true
""")
    with board.running(270.0), Gateway("run", str(config)) as gateway:
        with Plc(port_of(gateway)) as plc:
            shown = plc.wait_for(lambda image: image["relay_status"] == 0b001011, PATIENCE_S).image
            assert (shown["in_place"], shown["stop"], shown["may_move"]) == (1, 1, 0)
        for number in (signal.SIGSTOP, signal.SIGKILL):
            board.until(IN_PLACE)
            os.kill(gateway.process.pid, number)
            at_ns = board.time_of(time.monotonic_ns())
            assert board.until(0) - at_ns < DROPS_MS * MS
            if number is signal.SIGSTOP:
                os.kill(gateway.process.pid, signal.SIGCONT)
    assert {row["pins"] for row in board.rows if row["type"] == "relay"} == {0, IN_PLACE}
