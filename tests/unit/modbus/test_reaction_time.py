"""Each guaranteed time of docs/reaction-time.md, played in virtual time with the fault at many phases of the poll."""

from collections.abc import Callable, Iterable
from typing import Any

import pytest

from gateway.config import parse
from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.plc import PlcWrite, Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.shown import shown
from gateway.core.state import StateVector, Tick
from gateway.modbus.exports.diagnosis import HEARTBEAT_TIMEOUT_MS
from gateway.modbus.registers.register_map import decode, encode
from gateway.ranger.hcsr04.protocol import PERIOD_MS
from tools import reaction_time

pytestmark = pytest.mark.one_interpreter

MS = 1_000_000
PLC = Writer("10.0.0.9")
CONFIG = parse({"modbus": {"writes": True, "plc_addresses": [PLC.address]}})
BAY = CONFIG.bays[0]
RULES = Rules.of(BAY, CONFIG)
GUARANTEED = {bound.cause.split(":")[0]: bound for bound in reaction_time.guaranteed(CONFIG, BAY)}
FAULT_MS = 4000  # from then on; the truck stands in place, or is on its way
Dead = frozenset[str]


class Bay:
    """A gateway's bay in virtual time, polled and scanned as a PLC does; what is dead from FAULT_MS on is silent."""

    def __init__(self, z_mm: float, dead: Dead, *, read_phase_ms: int) -> None:
        self.state: StateVector = interlock.initial("bay1", 0, RULES)
        self.z_mm, self.dead, self.read_phase_ms, self.beat = z_mm, dead, read_phase_ms, 0

    def at(self, now_ms: int) -> None:
        dead: Dead = self.dead if now_ms >= FAULT_MS else frozenset()
        for observation in self.seen(now_ms, dead):
            self.state = interlock.step(self.state, observation, now_ms * MS, RULES)

    def seen(self, now_ms: int, dead: Dead) -> Iterable[Observation]:
        if now_ms % 20 == 0 and "decision" not in dead:
            yield Tick()
        if now_ms % 60 == self.read_phase_ms and "decision" not in dead:
            if "camera" not in dead:
                z_mm = 2000.0 if "marker" in dead else self.z_mm  # something else red and round
                yield VisionReading(now_ms * MS, Quality.GOOD, Circle(320, 240, 54_000 / z_mm))
            if "ranger" not in dead:
                yield RangeReading(now_ms * MS, Quality.GOOD, self.z_mm)
        if now_ms % 100 == 5 and "plc" not in dead and "decision" not in dead:
            self.beat += 1
            yield PlcWrite(PLC, heartbeat=self.beat, control=0)


def off_after_ms(z_mm: float, dead: Dead, *, output: str, poll_phase_ms: int, read_phase_ms: int) -> int:
    """From the fault until the PLC's output is off. Its block looks at the image and at the heartbeat's time."""
    bay = Bay(z_mm, dead, read_phase_ms=read_phase_ms)
    image: dict[str, Any] | None = None
    heartbeat = changed_ms = -1
    for now_ms in range(0, FAULT_MS + 3000, 5):
        bay.at(now_ms)
        cut_off = "network" in dead and now_ms >= FAULT_MS
        if now_ms % reaction_time.POLL_MS == poll_phase_ms and not cut_off:
            image = dict(decode(encode(shown(bay.state, now_ms * MS), 0, "big")))
        if now_ms % reaction_time.SCAN_MS == 10 and image is not None:
            if image["heartbeat"] != heartbeat:
                heartbeat, changed_ms = image["heartbeat"], now_ms
            on = image[output] == 1 and now_ms - changed_ms < HEARTBEAT_TIMEOUT_MS
            if now_ms < FAULT_MS:
                assert on or now_ms < FAULT_MS - 500, "the output was never on"
            elif not on:
                return now_ms - FAULT_MS
    raise AssertionError("the output stays on")


def worst_ms(z_mm: float, dead: Dead, output: str) -> int:
    return max(
        off_after_ms(z_mm, dead, output=output, poll_phase_ms=poll, read_phase_ms=read)
        for poll in range(0, reaction_time.POLL_MS, 25)
        for read in (0, 20, 40)
    )


CASES: dict[str, tuple[Dead, tuple[str, ...], Callable[[], float]]] = {
    "camera dead": (frozenset({"camera"}), ("may_move", "in_place"), lambda: BAY.fusion.vision_deadline_s),
    "ranger dead": (frozenset({"ranger"}), ("may_move", "in_place"), lambda: BAY.fusion.range_deadline_s),
    "the gateway's decision has stopped, its server runs": (
        frozenset({"decision"}), ("may_move", "in_place"), lambda: RULES.valid_for_ns / 1e9,
    ),
    "gateway killed, frozen, or cut off from the PLC": (
        frozenset({"network"}), ("may_move", "in_place"), lambda: HEARTBEAT_TIMEOUT_MS / 1e3,
    ),
    "PLC's heartbeat lost (writes on)": (
        frozenset({"plc"}), ("may_move",), lambda: CONFIG.modbus.handshake.heartbeat_deadline_s,
    ),
    "in place, and the sensors contradict each other from then on": (
        frozenset({"marker"}), ("in_place",), lambda: BAY.visit.hold_grace_s,
    ),
}  # fmt: skip


@pytest.mark.mostly_long
@pytest.mark.parametrize("cause", CASES)
@pytest.mark.failure_mode("C2", "G1", "G2", "P1", "P2", "R2")
def test_no_phase_of_a_fault_takes_longer_than_its_bound(cause: str) -> None:
    dead, outputs, deadline_s = CASES[cause]
    bound = GUARANTEED[cause]
    for output in outputs:
        worst = worst_ms(280.0 if output == "in_place" else 900.0, dead, output)
        assert worst <= bound.ms, output
        assert worst >= 1000 * deadline_s() - 100, output  # the case was the right one: its deadline was waited for


def test_every_guaranteed_row_is_played() -> None:
    assert set(CASES) == set(GUARANTEED)


def test_the_defaults_of_the_page() -> None:
    assert {cause: bound.ms for cause, bound in GUARANTEED.items()} == {
        "camera dead": 440,
        "ranger dead": 540,
        "the gateway's decision has stopped, its server runs": 370,
        "gateway killed, frozen, or cut off from the PLC": 520,
        "PLC's heartbeat lost (writes on)": 1140,
        "in place, and the sensors contradict each other from then on": 640,
    }
    assert [bound.ms for bound in reaction_time.at_shipped_rates(BAY, PERIOD_MS)] == [272, 272, 272, 254, 220, 212]


def test_a_longer_deadline_makes_a_longer_bound() -> None:
    slow = parse({"fusion": {"vision_deadline_s": 0.5, "period_s": 0.2}})
    by_cause = {bound.cause: bound.ms for bound in reaction_time.guaranteed(slow, slow.bays[0])}
    assert by_cause["camera dead: unplugged, hung, its process killed"] == 820
    assert by_cause["the gateway's decision has stopped, its server runs"] == 520


def test_the_tables_name_every_share() -> None:
    made = {name: block() for name, block in reaction_time.blocks(PERIOD_MS).items()}
    assert list(made) == ["budget", "guaranteed", "at shipped rates"]
    assert "| the camera's deadline | 300 | `fusion.vision_deadline_s` |" in made["budget"]
    assert "300 deadline + 20 tick + 100 poll + 20 scan | **440** |" in made["guaranteed"]
    assert "2 distances, 60 ms each" in made["at shipped rates"]
