"""The exported example program drives a vehicle to its place, in a closed loop with the gateway's own decision.

In virtual time: a scan every 50 ms, a poll every 100 ms. The vehicle follows the program's velocity late and no faster
than its brake; what its sensors see goes into gateway/core/interlock.py, and the image of that into the program.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import pytest

from gateway.config import parse
from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.plc import PlcWrite, Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.setpoint import DriveState, Setpoint
from gateway.core.state import Reason, Tick
from gateway.modbus.exports import structured_text
from gateway.modbus.exports.approach import LIFE_MS, ApproachEnd, wait_s
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import BLOCK_WORDS
from tests import structured_text as structured_text_runner
from tests.long import mostly_long
from tests.permitted import permitted
from tests.plc_images import ADDRESS, words
from tests.structured_text import Instance, Program
from tools.situations import R_TIMES_Z

pytestmark = [pytest.mark.xdist_group("structured text"), pytest.mark.timeout(600)]  # the parser takes its time

MS = 1_000_000
SCAN_MS, POLL_MS = 50, 100
DECELERATION_MM_S2 = 300.0
PLC = Writer("10.0.0.9")
DRIVE = {"latency_s": 0.7, "max_speed_mm_s": 120.0}  # the block's life sign, a poll and a cycle
CHECK = {"focal_px": R_TIMES_Z / 100.0, "marker_radius_mm": 100.0}
CONFIG = parse(
    {
        "modbus": {"writes": True, "plc_addresses": [PLC.address]},
        "fusion": {"cross_check": CHECK},
        "drive": DRIVE,
    }
)
RULES = Rules.of(CONFIG.bays[0], CONFIG)


@dataclass
class Vehicle:
    """First order, with a brake that is no better than 150 mm/s2."""

    z_mm: float = 700.0
    speed_mm_s: float = 0.0
    lag_s: float = 0.3
    brake_mm_s2: float = 150.0

    def move(self, wanted_mm_s: float, dt_s: float) -> None:
        change = (wanted_mm_s - self.speed_mm_s) * dt_s / self.lag_s
        self.speed_mm_s = max(0.0, self.speed_mm_s + max(change, -self.brake_mm_s2 * dt_s))
        self.z_mm -= self.speed_mm_s * dt_s


class Loop:
    """A bay with a gateway, a vehicle, a spout and a barrier that do as the program says."""

    def __init__(self, program: Program, rules: Rules = RULES) -> None:
        self.plc, self.rules = program.instance(structured_text.EXAMPLE), rules
        self.state = interlock.initial("bay1", 0, rules)
        self.vehicle = Vehicle()
        self.words = [0] * BLOCK_WORDS
        self.now_ms = 0
        self.killed = False  # no poll is answered
        self.frozen = False  # each is, with the same image
        self.covered = False
        self.velocity: list[float] = []
        self.plc.values |= {
            "StopButton": True, "SpoutTop": True, "SpoutBottom": False, "DriveOk": True, "TruckPresent": True,
            "CycleMs": SCAN_MS,
        }  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        """`gateway`, `approach`, `sequence`: the program's blocks."""
        block: Instance = self.plc["bay1" if name == "gateway" else f"bay1_{name.capitalize()}"]
        return block

    def put(self, **inputs: bool) -> None:
        self.plc.values |= inputs

    def run(self, for_ms: int, until: Callable[[], bool] | None = None) -> None:
        """For a time, or until something is so; then it must be so before."""
        for _ in range(for_ms // SCAN_MS):
            self._scan()
            if until is not None and until():
                return
        assert until is None, "not before the time had passed"

    def _scan(self) -> None:
        self.now_ms += SCAN_MS
        if not self.killed:
            self._gateway()
        self.plc.values["bay1_PollOk"] = not self.killed
        self.plc.values["bay1_Words"] = list(self.words)
        self.plc.call(self.now_ms)
        approach, sequence = self.approach, self.sequence
        image = self.words
        limit = image[ADDRESS["speed_setpoint"]] if approach["Alive"] else max([0.0, *self.velocity[-1:]])
        assert 0.0 <= approach["Velocity"] <= limit
        assert approach["Velocity"] == 0.0 or not approach["Alive"] or image[ADDRESS["stop"]] == 0
        assert approach["Analog"] == math.floor(approach["Velocity"] / 500.0 * 27648 + 1e-9)
        assert approach["Run"] is (approach["Velocity"] > 0.0)
        self.velocity.append(approach["Velocity"])
        self.vehicle.move(approach["Velocity"], SCAN_MS / 1000)
        self.put(BarrierClosed=sequence["CloseBarrier"])
        if sequence["LowerSpout"] or sequence["RaiseSpout"]:
            self.put(SpoutTop=sequence["RaiseSpout"], SpoutBottom=sequence["LowerSpout"])

    def _gateway(self) -> None:
        now_ns, z_mm = self.now_ms * MS, self.vehicle.z_mm
        radius_px = R_TIMES_Z / z_mm + 0.02 * (self.now_ms // SCAN_MS % 3 - 1)  # live pictures: never twice the same
        vision = VisionReading(now_ns, Quality.GOOD, Circle(320.0, 240.0, radius_px))
        seen: list[Observation] = [
            VisionReading(now_ns, Quality.NO_TARGET) if self.covered else vision,
            RangeReading(now_ns, Quality.GOOD, z_mm),
            Tick(),
        ]
        if self.now_ms % POLL_MS == 0:
            block = self.gateway
            seen.append(
                PlcWrite(
                    PLC, heartbeat=block["PlcHeartbeat"], control=block["PlcControl"], recipe=block["RecipeSelect"]
                )
            )
        for observation in seen:
            self.state = interlock.step(self.state, observation, now_ns, self.rules)
        if self.now_ms % POLL_MS == 0 and not self.frozen:
            self.words = words(self.state)

    def begin(self) -> "Loop":
        """Until the start button has been pressed, and the vehicle is on its way."""
        self.run(1500, until=lambda: bool(self.gateway["MayMove"]))
        self.run(1200)
        self.press()
        self.run(6000, until=lambda: self.vehicle.z_mm < 600.0)
        assert (self.approach["Busy"], self.sequence["Lamp"]) == (True, True)
        return self

    def press(self) -> None:
        self.put(StartButton=True)
        self.run(100)
        self.put(StartButton=False)


@pytest.fixture(scope="module")
def program() -> Program:
    example = structured_text.text(structured_text.example(Target(), polled=False))
    return Program(structured_text.declarations((Target(),)), example)


@pytest.fixture
def loop(program: Program) -> Loop:
    return Loop(program)


def test_one_vehicle_from_the_start_button_to_its_release(loop: Loop) -> None:
    loop.begin()
    loop.run(12_000, until=lambda: bool(loop.approach["Done"]))
    assert 280.0 < loop.vehicle.z_mm < 300.0
    assert (loop.approach["Busy"], loop.approach["Fault"], loop.approach["Cause"]) == (False, False, ApproachEnd.NONE)
    assert max(loop.velocity) == 120.0
    assert max(after - before for before, after in pairwise(loop.velocity)) <= 100.0 * SCAN_MS / 1000 + 1e-3
    loop.run(500, until=lambda: bool(loop.sequence["Load"]))
    assert (loop.gateway["LoadPermit"], loop.sequence["Stage"], loop.plc["SpoutBottom"]) == (True, 4, True)
    assert not loop.sequence["Lamp"]
    loop.run(1000)
    loop.put(Full=True)
    loop.run(500, until=lambda: bool(loop.sequence["Release"]))
    assert (loop.sequence["Load"], loop.plc["SpoutTop"], loop.sequence["CloseBarrier"]) == (False, True, False)
    loop.run(2000, until=lambda: bool(loop.gateway["MayMove"]))
    assert loop.velocity[-1] == 0.0, "what is released is driven by no setpoint without a new start"
    loop.put(TruckPresent=False, Full=False)
    loop.run(60)
    assert loop.sequence["Stage"] == 0


def test_a_place_that_takes_long_to_settle_ends_no_approach(program: Program) -> None:
    given = {"fusion": {"cross_check": CHECK}, "drive": DRIVE, "visit": {"settle_s": 11.0}}
    config = parse({"modbus": {"writes": True, "plc_addresses": [PLC.address]}} | given)
    (bay,) = config.bays
    assert bay.drive
    loop = Loop(program, Rules.of(bay, config))
    assert (before := loop.approach["WaitTimeout"]) < 11_000
    loop.approach.values["WaitTimeout"] = 1000 * wait_s(bay.drive, bay.visit)
    loop.begin()
    loop.run(25_000, until=lambda: bool(loop.approach["Done"]))
    short = Loop(program, Rules.of(bay, config))
    short.begin()
    short.run(25_000, until=lambda: bool(short.approach["Fault"]))
    assert (short.approach["Cause"], short.approach["WaitTimeout"]) == (ApproachEnd.WAIT, before)


def ramps(velocity: list[float], from_: int) -> int:
    """Checks that the velocity falls by its limit to 0; how many scans it took."""
    step = DECELERATION_MM_S2 * SCAN_MS / 1000
    falls = velocity[from_:]
    scans = next(n for n, speed in enumerate(falls) if speed == 0.0)
    for before, after in pairwise(falls[: scans + 1]):
        assert after == pytest.approx(max(0.0, before - step), abs=1e-3)
    assert not any(falls[scans:])
    return scans


@pytest.mark.parametrize("how", mostly_long(["killed", "frozen"]))
def test_a_gateway_that_is_gone_ramps_down_and_one_that_is_back_moves_nothing(loop: Loop, how: str) -> None:
    loop.begin()
    speed, at = loop.velocity[-1], len(loop.velocity)
    assert speed > 100.0
    setattr(loop, how, True)
    loop.run(3000)
    if how == "frozen":
        at = next(n for n in range(at, len(loop.velocity)) if loop.velocity[n] < loop.velocity[n - 1]) - 1
    else:
        at -= 1
    assert ramps(loop.velocity, at) == math.ceil(loop.velocity[at] / (DECELERATION_MM_S2 * SCAN_MS / 1000))
    assert (loop.approach["Busy"], loop.approach["Fault"], loop.approach["Cause"]) == (False, True, ApproachEnd.LIFE)
    setattr(loop, how, False)
    loop.run(2000, until=lambda: bool(loop.gateway["MayMove"]))
    loop.run(4000)
    assert loop.words[ADDRESS["speed_setpoint"]] > 0
    assert not any(loop.velocity[at + 40 :])
    loop.press()
    loop.run(20_000, until=lambda: bool(loop.approach["Done"]))
    assert 280.0 < loop.vehicle.z_mm < 300.0


def test_a_stop_of_the_gateway_is_0_at_once_and_needs_a_new_start(loop: Loop) -> None:
    loop.begin()
    loop.covered = True
    loop.run(1000, until=lambda: bool(loop.gateway["MustStop"]))
    assert loop.velocity[-1] == 0.0
    assert loop.velocity[-2] > 100.0
    assert (loop.approach["Fault"], loop.approach["Cause"]) == (True, ApproachEnd.STOP)
    loop.covered = False
    loop.run(5000)
    assert loop.gateway["MayMove"]
    assert loop.velocity[-1] == 0.0
    loop.press()
    loop.run(20_000, until=lambda: bool(loop.approach["Done"]))


@pytest.mark.parametrize("given", mostly_long([{"StopButton": False}, {"DriveOk": False}, {"SpoutTop": False}]))
def test_what_the_plant_forbids_is_0_at_once(loop: Loop, given: dict[str, bool]) -> None:
    loop.begin()
    loop.put(**given)
    loop.run(SCAN_MS)
    assert loop.velocity[-1] == 0.0
    assert (loop.approach["Fault"], loop.approach["Cause"]) == (True, ApproachEnd.DRIVE)
    loop.put(**dict.fromkeys(given, True))
    loop.run(2000)
    assert not any(loop.velocity[-40:])


@pytest.mark.parametrize("known", ["UnitId", "BayIdentity"])
def test_another_bay_is_never_driven_to(program: Program, known: str) -> None:
    approach, block = Rig.of(program)
    block.values[known] += 1
    rig = Rig(approach, block)
    rig.run(2000)
    for _ in range(3):
        rig.start()
    assert rig.most == 0.0
    assert (rig.approach["Cause"], block["Diagnostic"]) == (ApproachEnd.LIFE, 13)


# ---- FB_Approach by itself


class Rig:
    """The two blocks, and the images of a vehicle that may move."""

    def __init__(self, approach: Instance, block: Instance, **inputs: Any) -> None:
        self.approach, self.block = approach, block
        self.now_ms = self.heartbeat = 0
        self.most = 0.0
        self.image: dict[str, Any] = {}
        self.setpoint = 300.0
        self.stuck = False
        self.inputs: dict[str, Any] = {"CycleMs": SCAN_MS, "DriveReady": True, "Start": False, **inputs}

    @staticmethod
    def of(program: Program) -> tuple[Instance, Instance]:
        block = program.instance(structured_text.FUNCTION_BLOCK)
        known = Target().identity
        block.values |= {"UnitId": known.unit_id, "BayIdentity": known.number, "HeartbeatTimeout": 5000}
        return program.instance("FB_Approach"), block

    def run(self, for_ms: int) -> "Rig":
        for _ in range(for_ms // SCAN_MS):
            self.now_ms += SCAN_MS
            self.heartbeat += not self.stuck
            drive = Setpoint(DriveState.APPROACH, enable=True, speed_mm_s=self.setpoint)
            state = replace(permitted(100 + self.heartbeat, setpoint=drive), **self.image)
            self.block.call(self.now_ms, PollOk=True, Words=words(state))
            given = {name: self.block[name] for name in ("Data", "Alive", "MayMove", "InPlace")}
            self.approach.call(self.now_ms, **given, **self.inputs)
            self.most = max(self.most, self.approach["Velocity"])
        return self

    def start(self) -> "Rig":
        self.inputs["Start"] = True
        self.run(SCAN_MS)
        self.inputs["Start"] = False
        return self.run(SCAN_MS)


@pytest.fixture
def rig(program: Program) -> Rig:
    return Rig(*Rig.of(program))


def test_a_start_that_is_on_from_the_beginning_begins_nothing(rig: Rig) -> None:
    rig.inputs["Start"] = True
    assert (rig.run(3000).most, rig.approach["Fault"]) == (0.0, False), "it is no edge, and refused as none"
    rig.inputs["Start"] = False
    rig.run(SCAN_MS)
    assert rig.start().run(200).most > 0.0


def test_its_own_life_sign_is_faster_than_the_block_s(rig: Rig) -> None:
    """HeartbeatTimeout of the rig's block is 5 s."""
    rig.run(1500).start().run(4000)
    assert rig.approach["Velocity"] == 300.0
    rig.stuck = True
    rig.run(LIFE_MS - SCAN_MS)
    assert (rig.approach["Velocity"], rig.block["Alive"]) == (300.0, True)
    rig.run(SCAN_MS)
    assert (rig.approach["Cause"], rig.approach["Velocity"]) == (ApproachEnd.LIFE, 285.0)


@pytest.mark.parametrize("scans", mostly_long([12, 0, 5, 16, 20]))
def test_a_plc_that_was_held_does_not_go_on_by_itself(rig: Rig, scans: int) -> None:
    """Its variables are kept, the gateway is alive, and a new image is there at the first call."""
    rig.run(1500).start().run(2000 + scans * SCAN_MS)
    before = rig.approach["Velocity"]
    assert before > 200.0
    rig.now_ms += 60_000
    rig.heartbeat += 600
    rig.run(SCAN_MS)
    assert (rig.approach["Busy"], rig.approach["Cause"]) == (False, ApproachEnd.LIFE)
    assert rig.approach["Velocity"] < before
    rig.run(2000)
    assert (rig.block["Alive"], rig.approach["Velocity"]) == (True, 0.0)


@pytest.mark.parametrize("name", ["Acceleration", "Deceleration"])
def test_a_ramp_that_is_no_number_drives_nothing(program: Program, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(structured_text_runner, "_f32", float)  # as most tools compute: with NaN
    rig = Rig(*Rig.of(program))
    rig.inputs[name] = math.nan
    rig.run(1500).start().run(2000)
    rig.stuck = True
    rig.run(LIFE_MS)
    assert rig.approach["Cause"] == ApproachEnd.LIFE
    assert (rig.approach["Velocity"], rig.approach["Run"], rig.approach["Analog"]) == (0.0, False, 0)


@pytest.mark.parametrize(("cycle_ms", "fits"), [(50, True), (0, False), (25, False), (38, False), (80, False)])
def test_a_wrong_cycle_time_drives_nothing(program: Program, cycle_ms: int, fits: bool) -> None:
    rig = Rig(*Rig.of(program), CycleMs=cycle_ms)
    rig.run(2500).start().run(200)
    assert (rig.most > 0.0) is fits
    assert rig.approach["Cause"] == (ApproachEnd.NONE if fits else ApproachEnd.CYCLE)


def test_a_setpoint_of_0_is_waited_for_and_then_ends_it(rig: Rig) -> None:
    rig.setpoint = 0.0
    rig.run(1500).start().run(9500)
    assert rig.approach["Busy"]
    rig.run(1000)
    assert (rig.approach["Cause"], rig.approach["Busy"]) == (ApproachEnd.WAIT, False)
    rig.setpoint = 300.0
    assert rig.run(1000).most == 0.0


def test_a_drive_that_is_not_enabled_gets_0_at_once_and_goes_on(rig: Rig) -> None:
    rig.run(1500).start().run(2000)
    assert rig.approach["Velocity"] > 150.0
    rig.image = {"setpoint": Setpoint(DriveState.NO_DISTANCE, enable=False, speed_mm_s=300.0)}
    rig.run(SCAN_MS)
    assert (rig.approach["Velocity"], rig.approach["Busy"]) == (0.0, True)
    rig.image = {}
    assert rig.run(SCAN_MS).approach["Velocity"] == pytest.approx(5.0)


def test_a_stop_beside_a_setpoint_is_0_at_once(rig: Rig) -> None:
    rig.run(1500).start().run(2000)
    rig.image = {"stop": True, "may_move": False, "reason": Reason.NO_TARGET}
    rig.run(SCAN_MS)
    assert (rig.approach["Velocity"], rig.approach["Cause"]) == (0.0, ApproachEnd.STOP)


@pytest.mark.parametrize(
    ("setpoint", "reference", "full_scale", "analog"),
    [(300.0, 500.0, 27648, 16588), (300.0, 250.0, 27648, 27648), (100.0, 300.0, 1000, 333), (300.0, 0.0, 27648, 0)],
)
def test_the_analogue_value_never_says_more_than_the_setpoint(
    program: Program, setpoint: float, reference: float, full_scale: int, analog: int
) -> None:
    rig = Rig(*Rig.of(program), ReferenceSpeed=reference, FullScale=full_scale, Acceleration=1e5)
    rig.setpoint = setpoint
    rig.run(1500).start()
    assert rig.approach["Analog"] == analog
