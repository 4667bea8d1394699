"""The bench's model of the PLC (bench/closed_loop/plc.py) does what the exported blocks do, scan by scan.

The blocks run in the tree walk, which ./dev iec compares with compiled ones.
"""

from collections import Counter
from dataclasses import replace
from random import Random
from typing import Any

import pytest

from bench.closed_loop.approach import Aid, Approach, limits, settings
from bench.closed_loop.plc import SCAN_S, ApproachBlock, Image, StartAgain, image_of
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.setpoint import DriveState, Setpoint
from gateway.core.shown import shown
from gateway.core.state import Reason, StateVector, Visit, VisitPhase
from gateway.modbus.exports import structured_text
from gateway.modbus.exports.approach import ApproachEnd
from gateway.modbus.exports.target import Target
from gateway.sim.vehicles import VehicleKind
from tests.long import mostly_long
from tests.permitted import permitted, standing
from tests.plc_images import block_of, words
from tests.structured_text import Program

pytestmark = [pytest.mark.xdist_group("structured text"), pytest.mark.timeout(600)]  # the parser takes its time

Polled = tuple[Image, list[int]]


@pytest.fixture(scope="module")
def program() -> Program:
    return Program(structured_text.declarations((Target(),)))


class Both:
    """The model, and beside it the exported blocks on the same polls; they must agree at each scan."""

    def __init__(self, program: Program, acceleration_mm_s2: float, deceleration_mm_s2: float) -> None:
        self.block, self.approach = block_of(program), program.instance("FB_Approach")
        self.model = ApproachBlock(acceleration_mm_s2, deceleration_mm_s2)
        self.approach.values |= {
            "DriveReady": True, "CycleMs": round(1000 * SCAN_S),
            "Acceleration": acceleration_mm_s2, "Deceleration": deceleration_mm_s2,
        }  # fmt: skip
        self.start = StartAgain()
        self.words = [0] * len(words(permitted()))
        self.seen: Counter[Any] = Counter()

    def scan(self, now_s: float, polled: Polled | None) -> float:
        now_ms = round(1000 * now_s)
        image, self.words = (None, self.words) if polled is None else polled
        block, approach, sequence = self.block, self.approach, self.model.sequence
        block.call(now_ms, PollOk=True, Words=self.words)
        given = {name: block[name] for name in ("Data", "Alive", "MayMove", "InPlace")}
        approach.call(now_ms, **given, Start=self.start(now_ms, block["MayMove"], approach["Busy"]))
        speed_mm_s = self.model.scan(now_s, image)
        told = (sequence.alive, sequence.may_move, sequence.in_place, sequence.busy, sequence.done, sequence.fault)
        names = ("Busy", "Done", "Fault")
        assert told == (*(given[n] for n in ("Alive", "MayMove", "InPlace")), *(approach[n] for n in names)), now_s
        assert sequence.cause == approach["Cause"], now_s
        assert speed_mm_s == pytest.approx(approach["Velocity"], abs=1e-3), now_s
        self.seen.update((ApproachEnd(sequence.cause), *(name for name in names if approach[name])))
        self.seen["fast"] += speed_mm_s > 50
        return speed_mm_s


class Driven(Approach):
    """The PLC writes what the exported block has it write."""

    program: Both  # type: ignore[assignment]

    def heartbeat(self) -> int:
        return int(self.program.block["PlcHeartbeat"])

    def polled(self, state: StateVector) -> Polled:  # type: ignore[override]
        told = shown(state, self.now_ns)
        return image_of(told), words(told)


@pytest.mark.parametrize(
    ("kind", "seed"),
    mostly_long(((kind, seed) for seed in range(2, 5) for kind in VehicleKind), short=0),
)
def test_an_approach_with_faults_is_driven_alike(program: Program, kind: VehicleKind, seed: int) -> None:
    one = Driven(kind, Aid.SETPOINT, seed, settings(kind, Aid.SETPOINT), with_faults=True)
    one.program = Both(program, limits(kind)["acceleration_mm_s2"], limits(kind)["brake_mm_s2"])
    one.run()
    assert one.program.seen["fast"] > 20


def drawn(chance: Random, heartbeat: int) -> StateVector:
    """What a program may read: mostly that a vehicle may move; else in place, stopped, or a sensor in doubt."""
    speed = chance.choice((0.0, 7.4, 60.0, 123.0, 480.0))
    driving = Setpoint(DriveState.APPROACH, chance.random() < 0.9, speed)
    moving: dict[str, Any] = {"setpoint": driving}
    stopped = {"stop": True, "may_move": False}
    arriving = {"visit": Visit(VisitPhase.ARRIVING)}
    return chance.choice(
        (
            *[permitted(heartbeat, **moving)] * 8,
            permitted(heartbeat, **moving, may_move=False),
            permitted(heartbeat, **moving, vision=VisionReading(0, Quality.COASTED)),
            permitted(heartbeat, **moving, range=RangeReading(0, Quality.NO_ECHO)),
            permitted(heartbeat, **moving, range=RangeReading(0, Quality.NO_ECHO), **arriving),
            permitted(heartbeat, **moving, range=RangeReading(0, Quality.STALE), **arriving),
            permitted(heartbeat, **moving, **stopped, reason=Reason.NO_TARGET),
            *[permitted(heartbeat, **stopped, reason=reason) for reason in (Reason.TARGET_REACHED, Reason.CLEARING)],
            *(standing(heartbeat, covered=covered) for covered in (False, True)),
            standing(heartbeat, range=RangeReading(0, Quality.NO_ECHO)),
        )
    )


@pytest.mark.parametrize(("seed", "scans"), mostly_long([(1, 1500), *((seed, 5000) for seed in (2, 4, 5, 7, 13, 24))]))
def test_images_at_random_are_followed_alike(program: Program, seed: int, scans: int) -> None:
    """An image lasts for a while, life signs stop, jump and go back, polls are lost. The first seed reaches all."""
    chance = Random(f"images {seed}")
    both, heartbeat, poll_ms, changes_ms = Both(program, 100.0, 300.0), 65_500, 0, 0
    state, step = permitted(heartbeat), 1
    for scan in range(scans):
        now_ms = scan * 20
        polled = None
        if now_ms >= changes_ms:
            state = drawn(chance, 0)
            changes_ms = now_ms + chance.choice((200, 600, 1500, 4000, 12_000))
            step = chance.choice((0, 40_000, -3)) if chance.random() < 0.1 else 1
        if now_ms >= poll_ms:
            heartbeat = (heartbeat + step) % 65_536
            told = replace(state, heartbeat=heartbeat)
            polled = image_of(told), words(told)
            poll_ms = now_ms + (chance.choice((460, 480, 500, 520, 900)) if chance.random() < 0.03 else 200)
        both.scan(now_ms / 1000, polled)
    assert both.seen["fast"] > 0
    ends = {ApproachEnd.LIFE, ApproachEnd.STOP, ApproachEnd.WAIT}
    assert seed != 1 or set(both.seen) > {*ends, "Busy", "Done", "Fault"}
