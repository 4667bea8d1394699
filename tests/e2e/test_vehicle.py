"""`gateway simulate --vehicle`: what a PLC writes to the simulated drive moves the vehicle, and nothing else does."""

from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from gateway.sim.drive import ACTUAL, CONTROL, RUN, SPEED, STATUS, TIMED_OUT, WORDS
from tests.e2e.plc import CyclicProgram, Plc
from tests.e2e.processes import Gateway, Row

pytestmark = pytest.mark.one_interpreter

STANDING = "seed = 3\nstart = { distance_cm = 60 }\nvibration = { amplitude_mm = 0 }\n"


class SlowUntilStop(CyclicProgram):
    """Runs at 100 mm/s while the gateway's `may_move` is on; else not."""

    def __init__(self, plc: Plc, drive_port: int) -> None:
        super().__init__(0.05)
        self._plc = plc
        self._client = ModbusTcpClient("127.0.0.1", port=drive_port, timeout=2, retries=0)
        assert self._client.connect()  # type: ignore[no-untyped-call]  # pymodbus's own
        self.seen = [0] * WORDS

    def cycle(self) -> None:
        runs = bool(self._plc.polls) and self._plc.last["may_move"] == 1
        self._client.write_registers(CONTROL, [RUN * runs, 100 * runs])
        self.seen = self.read()

    def read(self) -> list[int]:
        return list(self._client.read_holding_registers(CONTROL, count=WORDS).registers)

    def close(self) -> None:
        """It stops writing, and keeps its connection."""


def moves(row: Row) -> bool:
    return bool(row["type"] == "state" and row["truth"]["speed_mm_s"] > 0)


def stands(row: Row, nearest_mm: float, farthest_mm: float) -> bool:
    if row["type"] != "state" or row["truth"]["speed_mm_s"]:
        return False
    return bool(nearest_mm <= row["truth"]["z_mm"] <= farthest_mm)


def test_a_program_drives_a_tractor_to_the_mark_and_without_it_nothing_moves(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(STANDING)
    args = ("--scenario", str(scenario), "--vehicle", "tractor", "--modbus-port", "0", "--no-hmi", "--json")
    with Gateway("simulate", *args, "--method", "paper") as gateway:
        started = gateway.started()
        with Plc(started["modbus_port"]) as plc:
            plc.wait_for(lambda image: image["may_move"] == 1, 60)
            plc.wait_for(lambda image: image["speed_setpoint"] > 0, 30)  # its drive is configured
            assert not any(map(moves, gateway.rows))
            with SlowUntilStop(plc, started["drive_port"]) as program:
                plc.wait_for(lambda image: image["d"] == 1, 60)
                gateway.wait_for(lambda row: stands(row, 45.0, 310.0), 30)
                assert program.seen[CONTROL : SPEED + 1] == [0, 0]
            client = program._client
            client.write_registers(CONTROL, [RUN, 40])
            gateway.wait_for(moves, 30)
            gateway.wait_for(lambda row: stands(row, 45.0, 310.0), 30)
            assert (program.read()[STATUS], program.read()[ACTUAL]) == (TIMED_OUT, 0)
            client.close()  # type: ignore[no-untyped-call]
