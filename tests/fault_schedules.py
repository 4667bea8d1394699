"""Schedules of faults made up by chance: what the truck does, what fails when, and what the PLC writes. Pure.

A schedule follows from its seed alone. It begins in one phase of a visit, lets up to five faults overlap within some
two seconds, and ends with every fault. What must hold meanwhile and afterwards: tests/fault_judge.py.
"""

import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from gateway.config import GatewayConfig, parse
from gateway.sim.scenario import Scenario
from gateway.sim.scenario import parse as parse_scenario
from gateway.sim.world import Truth, World

PLC, OTHER_PLC = "10.0.0.9", "10.0.0.8"
WARM_S = 2.2  # world time before the schedule begins: sensors up, and a truck at the mark is in place
MOST_FAULTS = 5
FAULTS_S = 2.0  # the last fault has ended this long after the schedule begins


class Fault(StrEnum):
    """What can fail. The value is the name in reports."""

    # the camera and its picture
    CAMERA_FREEZE = "camera_freeze"
    CAMERA_LOST = "camera_lost"
    CAMERA_BLACK = "camera_black"
    CAMERA_STUCK = "camera_stuck"
    MARKER_HIDDEN = "marker_hidden"
    SPOUT_DOWN = "spout_down"
    RED_LAMP = "red_lamp"
    # the vision process
    VISION_KILLED = "vision_killed"  # it dies, and so does each one started meanwhile
    VISION_HUNG = "vision_hung"  # its detector hangs in a frame
    VISION_SLOW = "vision_slow"  # results need `amount` s longer
    VISION_FUTURE = "vision_future"  # frames are stamped `amount` s ahead
    # the ranger and its wire
    RANGER_SILENT = "ranger_silent"
    RANGER_NO_ECHO = "ranger_no_echo"
    RANGER_STUCK = "ranger_stuck"
    RANGER_TOO_NEAR = "ranger_too_near"
    RANGER_TOO_FAR = "ranger_too_far"
    RANGER_NOISE = "ranger_noise"
    RANGER_WILD = "ranger_wild"
    RANGER_ECHO = "ranger_echo"  # from `amount` cm
    RANGER_UNPLUGGED = "ranger_unplugged"
    RANGER_WRONG_VERSION = "ranger_wrong_version"
    RANGER_BACKLOG = "ranger_backlog"  # bytes wait in a buffer, and arrive together
    # the gateway's processes and clocks
    CONTROL_DEAD = "control_dead"  # the control task does not tick; the server answers
    LOOP_BLOCKED = "loop_blocked"  # nothing of the main process runs; what arrives waits
    RESTARTED = "restarted"  # the gateway is down, then starts anew
    SUSPENDED = "suspended"  # the machine: neither the main nor the vision process runs; their clock goes on
    WALL_JUMP = "wall_jump"  # the wall clock is `amount` s off
    # the PLC and the network
    PLC_STOPPED = "plc_stopped"  # its program: it polls, and writes what it wrote before
    PLC_CUT = "plc_cut"  # no request arrives
    PLC_SLOW = "plc_slow"  # every fourth request arrives
    PLC_RESTARTED = "plc_restarted"  # all its bits are 0, then as they were
    PLC_RELEASES = "plc_releases"  # the release bit is on
    PLC_RESETS = "plc_resets"  # the reset bit alternates
    PLC_BITS = "plc_bits"  # random control bits
    OTHER_MASTER = "other_master"  # a second PLC writes a heartbeat and its release bit
    DAMAGED_FRAMES = "damaged_frames"  # random bytes in complete frames, by a third client that may write
    # people
    FUNCTION_CHECK = "function_check"


OF_SCENARIO = frozenset(
    {
        Fault.CAMERA_BLACK, Fault.CAMERA_STUCK, Fault.MARKER_HIDDEN, Fault.SPOUT_DOWN, Fault.RED_LAMP,
        Fault.RANGER_SILENT, Fault.RANGER_NO_ECHO, Fault.RANGER_STUCK, Fault.RANGER_TOO_NEAR, Fault.RANGER_TOO_FAR,
        Fault.RANGER_NOISE, Fault.RANGER_WILD, Fault.RANGER_ECHO, Fault.RANGER_UNPLUGGED, Fault.RANGER_WRONG_VERSION,
        Fault.CAMERA_FREEZE, Fault.CAMERA_LOST,
    }
)  # fmt: skip
"""Those that the simulator's world or its ranger plays."""


@dataclass(frozen=True, slots=True)
class Failure:
    """One fault for a limited time, from the begin of the schedule."""

    fault: Fault
    at_s: float
    for_s: float
    amount: float = 0.0

    @property
    def end_s(self) -> float:
        return self.at_s + self.for_s

    def __str__(self) -> str:
        amount = f" {self.amount:g}" if self.amount else ""
        return f"{self.fault}{amount} {self.at_s:.2f} to {self.end_s:.2f} s"


@dataclass(frozen=True, slots=True)
class Schedule:
    """One run: its phase at the begin, what the truck does, what fails."""

    seed: int
    settings: str  # name of the configuration
    phase: str
    truck: str
    legs: tuple[Mapping[str, Any], ...]  # of the truck, from the begin of the schedule
    failures: tuple[Failure, ...]
    cycle_ms: int  # of the PLC

    @property
    def ends_s(self) -> float:
        """When the last fault has ended."""
        return max((failure.end_s for failure in self.failures), default=0.0)

    def only(self, numbers: tuple[int, ...]) -> "Schedule":
        """With these faults alone."""
        return replace(self, failures=tuple(self.failures[n] for n in numbers))

    def __str__(self) -> str:
        what = "; ".join(map(str, self.failures)) or "no fault"
        return f"seed {self.seed}: {self.settings}, {self.phase}, truck {self.truck}: {what}"


# -- configurations -------------------------------------------------------------------------------------------------

_QUICK: dict[str, Any] = {
    "fusion": {"recovery_s": 0.4, "period_s": 0.05},
    "visit": {"settle_s": 0.4, "hold_grace_s": 0.3, "leave_s": 0.8},
    "camera": {"reconnect": {"min_s": 0.05, "max_s": 0.2}},
}
_DRIVE: dict[str, Any] = {
    "fusion": {"cross_check": {"focal_px": 600.0, "marker_radius_mm": 90.0}},
    "drive": {"lag_s": 0.3, "latency_s": 0.2},
}


def _settings(*layers: Mapping[str, Any], writes: bool = True, **handshake: Any) -> GatewayConfig:
    plc = {"writes": writes, "plc_addresses": [PLC, OTHER_PLC] if writes else [], "handshake": handshake}
    data: dict[str, Any] = {"modbus": plc}
    for layer in layers:
        for name, keys in layer.items():
            data[name] = data.get(name, {}) | keys
    return parse(data)


SETTINGS: Mapping[str, GatewayConfig] = {
    "quick": _settings(_QUICK, heartbeat_deadline_s=0.5),
    "checked": _settings(_QUICK, _DRIVE, {"guidance": {"aim_u_px": 319.5}}),
    "latched": _settings(_QUICK, {"fusion": {"latch_stop": True}}, enable_required=True, heartbeat_deadline_s=0.5),
    "reads only": _settings(_QUICK, writes=False),
    "no heartbeat": _settings(_QUICK, heartbeat_required=False, heartbeat_deadline_s=0.5),
    "shipped": _settings(),
    "driven": _settings(_QUICK, _DRIVE, heartbeat_deadline_s=0.5),
}
WEIGHTS = (5, 2, 2, 2, 1, 1, 0)  # of them, in this order; the last is not drawn, but taken for quick

# -- schedules ------------------------------------------------------------------------------------------------------

PHASES = ("arriving", "approaching", "approaching", "in place", "in place", "in place", "held", "held", "released")
_AT_MARK = frozenset({"in place", "held", "released"})
_PROCESS = (Fault.CONTROL_DEAD, Fault.LOOP_BLOCKED, Fault.RESTARTED, Fault.SUSPENDED)


def schedule(seed: int) -> Schedule:
    """What `seed` stands for."""
    chance = random.Random(f"faults {seed}")
    settings = chance.choices(list(SETTINGS), WEIGHTS)[0]
    phase = chance.choice(PHASES)
    if phase == "released" and settings == "reads only":
        phase = "in place"
    truck, legs = _truck(chance, phase)
    count = chance.choices((0, 1, 2, 3, 4, MOST_FAULTS), (1, 5, 6, 4, 2, 1))[0]
    kinds = [fault for fault in Fault if settings != "reads only" or not fault.name.startswith(("PLC_RE", "OTHER"))]
    failures = tuple(sorted((_failure(chance, chance.choice(kinds)) for _ in range(count)), key=lambda f: f.at_s))
    return Schedule(seed, settings, phase, truck, legs, failures, chance.choice((100, 100, 100, 200)))


def _failure(chance: random.Random, fault: Fault) -> Failure:
    at_s = chance.uniform(0, 0.6 * FAULTS_S)
    for_s = min(10 ** chance.uniform(-1.7, 0.25), FAULTS_S - at_s)  # 20 ms to 1.8 s, short ones as often as long ones
    if fault is Fault.SPOUT_DOWN:
        for_s = FAULTS_S - at_s  # it needs its time to come down
    amount = 0.0
    match fault:
        case Fault.RANGER_ECHO:
            amount = round(chance.choice((chance.uniform(3, 120), chance.uniform(24, 34))), 1)
        case Fault.VISION_SLOW:
            amount = round(chance.uniform(0.05, 0.5), 3)
        case Fault.VISION_FUTURE:
            amount = round(chance.uniform(0.01, 5), 3)
        case Fault.WALL_JUMP:
            amount = round(chance.choice((-1, 1)) * 10 ** chance.uniform(-1, 8), 1)
        case _:
            pass
    return Failure(fault, round(at_s, 3), round(for_s, 3), amount)


def _truck(chance: random.Random, phase: str) -> tuple[str, tuple[Mapping[str, Any], ...]]:
    """What it does from the begin on."""
    wait_s = round(chance.uniform(0, 1.2), 3)
    if phase == "arriving":
        return "arrives", ({"distance_cm": 300.0, "speed_cm_s": 100.0, "acceleration_cm_s2": 200.0},)
    if phase == "approaching":
        goal = chance.choice((24.0, 28.0, 29.5, 45.0, 85.0))
        start = {"distance_cm": 90.0, "hold_s": wait_s / 4}
        return f"drives to {goal:g} cm", (start, _leg(chance, goal, 40, 120))
    if phase == "released":
        return "leaves", ({"distance_cm": 28.0, "hold_s": wait_s / 4}, _leg(chance, chance.uniform(45, 130), 15, 80))
    return _of_a_truck_at_the_mark(chance, {"distance_cm": 28.0, "hold_s": wait_s})


def _of_a_truck_at_the_mark(
    chance: random.Random, hold: Mapping[str, Any]
) -> tuple[str, tuple[Mapping[str, Any], ...]]:
    match chance.randrange(6):
        case 0 | 1:
            return "stays", ()
        case 2:
            goal = round(28 + chance.choice((-1, 1)) * chance.uniform(1.0, 9), 1)
            return f"creeps to {goal:g} cm", (hold, _leg(chance, goal, 2, 30))
        case 3:
            return "leaves without release", (hold, _leg(chance, chance.uniform(40, 140), 15, 80))
        case 4:
            aside = round(chance.choice((-1, 1)) * chance.uniform(5, 60), 1)
            return f"slides {aside:g} mm aside", (hold, _leg(chance, 28.0, 5, 40) | {"lateral_mm": aside})
        case _:
            other = {"another_truck": True, "distance_cm": round(chance.uniform(22, 120), 1)}
            return f"another at {other['distance_cm']} cm", (hold, other)


def _leg(chance: random.Random, goal_cm: float, slow: float, fast: float) -> dict[str, Any]:
    return {
        "distance_cm": round(goal_cm, 1),
        "speed_cm_s": round(chance.uniform(slow, fast), 1),
        "acceleration_cm_s2": 200.0,
    }


# -- worlds ---------------------------------------------------------------------------------------------------------

_VIBRATION = {"amplitude_mm": 1.0}
_RANGER = {"jitter_mm": 1.5}


def start_of(phase: str) -> Mapping[str, Any]:
    """Where the truck stands while the gateway warms up."""
    return {"distance_cm": 28.0 if phase in _AT_MARK else 430.0 if phase == "arriving" else 90.0}


def warm_scenario(phase: str) -> Scenario:
    """The world before the schedule begins, the same for each schedule of that phase."""
    covered = [{"kind": Fault.MARKER_HIDDEN, "at_s": WARM_S - 0.7, "for_s": 5.0}] if phase == "held" else []
    return parse_scenario(
        {"start": start_of(phase), "faults": covered, "vibration": _VIBRATION, "ranger": _RANGER, "seed": 1}
    )


def scenario_of(made: Schedule) -> Scenario:
    """The world of a schedule; its time is the schedule's plus WARM_S."""
    first = {"distance_cm": start_of(made.phase)["distance_cm"], "hold_s": WARM_S}
    faults: list[dict[str, Any]] = []
    if made.phase == "held":
        # The loading spout is down for the whole time, as while it loads.
        faults.append({"kind": Fault.MARKER_HIDDEN, "at_s": WARM_S - 0.7, "for_s": 0.7 + FAULTS_S})
    for failure in made.failures:
        if failure.fault in OF_SCENARIO:
            faults.append({"kind": failure.fault, "at_s": failure.at_s + WARM_S, "for_s": failure.for_s})
            if failure.fault is Fault.RANGER_ECHO:
                faults[-1]["distance_cm"] = failure.amount
    return parse_scenario(
        {
            "start": start_of(made.phase), "legs": (first, *made.legs), "faults": faults,
            "vibration": _VIBRATION, "ranger": _RANGER, "seed": 1,
        }
    )  # fmt: skip


def undisturbed(here: Truth, *goals_cm: float) -> World:
    """A world without a fault: the truck drives from where it is to each of these, and stays at the last."""
    mm_per_px = 90.0 / here.radius_px  # of the marker
    start = {"distance_cm": here.distance_mm / 10, "lateral_mm": (here.u_px - 319.5) * mm_per_px}
    legs = [{"distance_cm": cm, "speed_cm_s": 150.0, "acceleration_cm_s2": 300.0} for cm in goals_cm]
    return World(parse_scenario({"start": start, "legs": legs, "vibration": _VIBRATION, "seed": 1}))
