"""The exported structured text, run in cycles against a live simulated bay.

A parser that we did not write reads the program, tests/structured_text.py runs its tree: no IEC 61131-3 compiler is to
be had from the package registries that this project uses. `./dev iec` compiles it where there is one.
"""

import time
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from gateway.core.state import Reason
from gateway.modbus.exports import structured_text
from gateway.modbus.exports.diagnosis import Diagnosis
from gateway.modbus.exports.structured_text import FUNCTION_BLOCK
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import BLOCK_WORDS, REGISTERS
from tests.e2e.processes import Gateway
from tests.structured_text import Instance, Program

pytestmark = [pytest.mark.xdist_group("structured text"), pytest.mark.timeout(300)]  # the parser takes its time

# Far, on the mark, far again, and once more: a slow machine may miss the first visit.
VISIT = """
seed = 7
duration_s = 100
repeat = true
start = { distance_cm = 60 }
legs = [
  { distance_cm = 60, hold_s = 4 },
  { distance_cm = 27, speed_cm_s = 20, hold_s = 3 },
  { distance_cm = 60, speed_cm_s = 40, hold_s = 4 },
]
"""
CYCLE_MS = 20
# A busy machine may not schedule the gateway for a while; that is not what is tested here.
TIMEOUT_MS = 5000
LIMIT_S = 40.0
ADDRESS = {register.name: register.address for register in REGISTERS}
PAIRS = [register.address for register in REGISTERS if register.words == 2]


class SoftPlc:
    """Polls the block and calls the function block once in a cycle; its time is its cycles'."""

    def __init__(self, block: Instance, gateway: Gateway) -> None:
        started = gateway.started()
        port, instance = started["modbus_port"], started["instance"]  # another one where several simulations run
        known = Target(site="simulated", gateway=instance).identity
        self.block = block
        self._known = {"UnitId": known.unit_id, "BayIdentity": known.number}
        self.words = [0] * BLOCK_WORDS
        self._client = ModbusTcpClient("127.0.0.1", port=port, timeout=2, retries=0)
        self._now_ms = 0

    def cycle(self) -> Diagnosis:
        """A poll, a call, a short sleep."""
        ok = False
        try:
            answer = self._client.read_holding_registers(0, count=BLOCK_WORDS, device_id=1)
            ok = not answer.isError()
        except (ModbusException, OSError):
            pass
        if ok:
            self.words = list(answer.registers)
        found = self.call(self.words, ok=ok)
        time.sleep(CYCLE_MS / 1000)
        return found

    def call(self, words: list[int], *, ok: bool = True, after_ms: int = CYCLE_MS) -> Diagnosis:
        self._now_ms += after_ms
        self.block.call(self._now_ms, PollOk=ok, Words=list(words), HeartbeatTimeout=TIMEOUT_MS, **self._known)
        found = Diagnosis(self.block["Diagnostic"])
        said = tuple(words[ADDRESS[name]] for name in ("stop", "may_move", "in_place"))
        # Whatever comes: no output that the image does not name, and no running truck without an image to believe in.
        assert (self.block["MayMove"] or self.block["InPlace"]) is (found is Diagnosis.OK)
        assert not self.block["MayMove"] or (ok and said == (0, 1, 0))
        assert not self.block["InPlace"] or (ok and said == (1, 0, 1))
        assert self.block["MustStop"] or self.block["Alive"]
        return found

    def until(self, wanted: Diagnosis | str) -> None:
        """Cycles until a diagnosis, or until an output is on."""
        deadline = time.monotonic() + LIMIT_S
        seen: list[str] = []
        while (found := self.cycle()) is not wanted and not (isinstance(wanted, str) and self.block[wanted]):
            seen = [*seen[-20:], found.name]
            assert time.monotonic() < deadline, f"{wanted} not seen; last: {seen}"

    def close(self) -> None:
        self._client.close()  # type: ignore[no-untyped-call]  # pymodbus's own


@pytest.fixture(scope="module")
def program() -> Program:
    return Program(structured_text.declarations((Target(),)))


@pytest.mark.long
def test_the_outputs_follow_a_live_bay_and_fall_on_every_doubt(program: Program, tmp_path: Path) -> None:
    scenario = tmp_path / "visit.toml"
    scenario.write_text(VISIT)
    with Gateway("simulate", "--scenario", str(scenario), "--modbus-port", "0", "--json") as gateway:
        plc = SoftPlc(program.instance(FUNCTION_BLOCK), gateway)
        try:
            follow(plc)
            gateway.end()
            plc.until(Diagnosis.POLL_FAILED)
            assert (plc.block["MustStop"], plc.block["Data"]["stop"]) == (True, 1)
        finally:
            plc.close()


def follow(plc: SoftPlc) -> None:
    """May move while far, stop on the mark, in place once it stands, may move again when it leaves."""
    plc.until("MayMove")
    data = plc.block["Data"]
    assert 250 < data["distance"] < 650
    assert data["distance"] == plc.words[ADDRESS["distance"]]
    assert data["distance_f32"] == pytest.approx(data["distance"], abs=0.51)
    assert data["known_f32"] == 123456.0
    plc.until(Diagnosis.STOP)
    while plc.block["Reason"] != Reason.TARGET_REACHED:  # a glimpse without a distance may come first
        plc.until(Diagnosis.STOP)
    assert (plc.block["MustStop"], plc.block["InPlace"]) == (True, False)
    plc.until("InPlace")
    assert plc.block["MustStop"] is True
    plc.until("MayMove")
