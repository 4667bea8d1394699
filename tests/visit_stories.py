"""Visits made up by chance: how a truck drives, what goes wrong when, and what the PLC writes. The same by seed."""

import random
from typing import Any

from gateway.bay import Recorder
from gateway.config import GatewayConfig
from gateway.core.plc import Control, PlcWrite
from gateway.core.readings import DEAD, Quality
from gateway.core.state import FunctionCheck, StateVector
from gateway.sim.scenario import Scenario, parse
from tests.visit_bench import PLC, Bench, gateway

RANGER_FAULTS = (
    "ranger_silent",
    "ranger_no_echo",
    "ranger_stuck",
    "ranger_too_near",
    "ranger_too_far",
    "ranger_noise",
    "ranger_wild",
    "ranger_unplugged",
    "ranger_wrong_version",
)
CAMERA_FAULTS = ("camera_freeze", "camera_lost", "camera_black", "marker_hidden")
LENGTH_S = 32.0


def story(seed: int) -> Scenario:
    """A truck drives in, stands, perhaps rolls or drives away while it is loaded, leaves; perhaps another comes."""
    chance = random.Random(f"story {seed}")
    legs: list[dict[str, Any]] = [_leg(chance, chance.uniform(20, 29.5), chance.uniform(10, 40), chance.uniform(4, 9))]
    if chance.random() < 0.3:
        legs.append(_leg(chance, chance.uniform(15, 45), chance.uniform(0.5, 4), chance.uniform(0, 3)))
    legs.append(_leg(chance, chance.uniform(45, 160), chance.uniform(10, 50), chance.uniform(0, 2)))
    if chance.random() < 0.4:
        legs.append({"another_truck": True, "distance_cm": chance.uniform(24, 90), "hold_s": chance.uniform(0, 3)})
    legs.append(_leg(chance, chance.uniform(22, 29), chance.uniform(10, 30), 4))
    faults: list[dict[str, Any]] = []
    if chance.random() < 0.8:
        faults.append({"kind": "spout_down", "at_s": chance.uniform(4, 9), "for_s": chance.uniform(5, 12)})
    for kind, likely in (("red_lamp", 0.4), ("ranger_echo", 0.4), ("dust_cloud", 0.2)):
        if chance.random() < likely:
            faults.append({"kind": kind, "at_s": chance.uniform(0, 18), "for_s": chance.uniform(0.05, 6)})
            if kind == "ranger_echo":
                faults[-1]["distance_cm"] = chance.uniform(3, 120)
    for kinds in (RANGER_FAULTS, CAMERA_FAULTS):
        if chance.random() < 0.4:
            faults.append(
                {"kind": chance.choice(kinds), "at_s": chance.uniform(0, 22), "for_s": chance.uniform(0.05, 4)}
            )
    return parse(
        {
            "seed": seed,
            "start": {"distance_cm": chance.uniform(40, 130), "lateral_mm": chance.uniform(-20, 20)},
            "legs": legs,
            "faults": faults,
            "vibration": {"amplitude_mm": chance.uniform(0, 3)},
            "ranger": {"jitter_mm": chance.uniform(0.5, 2.5), "dropout": chance.choice((0.0, 0.0, 0.02))},
        }
    )


def _leg(chance: random.Random, distance_cm: float, speed_cm_s: float, hold_s: float) -> dict[str, Any]:
    return {
        "distance_cm": distance_cm,
        "lateral_mm": chance.uniform(-15, 15),
        "speed_cm_s": speed_cm_s,
        "hold_s": hold_s,
    }


def settings(seed: int) -> GatewayConfig:
    """With and without a cross-check, an aim, a latch: whatever a plant may have set."""
    chance = random.Random(f"settings {seed}")
    fusion: dict[str, Any] = {"latch_stop": chance.random() < 0.2, "latch_leave_s": 1.0}
    if chance.random() < 0.4:
        fusion["cross_check"] = {"focal_px": 600.0, "marker_radius_mm": 90.0}
    guidance = {"aim_u_px": 319.5} if chance.random() < 0.5 else {}
    return gateway(fusion=fusion, guidance=guidance, visit={"hold_limit_s": chance.choice((2.0, 1800.0))})


class Writer:
    """A PLC that releases when it likes, for as long as it likes, forgets its heartbeat and resets the latch."""

    def __init__(self, seed: int) -> None:
        self._chance = random.Random(f"plc {seed}")
        self._bits = 0
        self._silent_until_s = -10.0
        self._beat = 0

    def __call__(self, t_s: float, state: StateVector) -> PlcWrite | None:
        chance = self._chance
        if chance.random() < 0.002:
            self._silent_until_s = t_s + chance.uniform(0.2, 3)
        if t_s < self._silent_until_s:
            return None
        likely = 0.02 if state.in_place else 0.01
        if chance.random() < likely:
            self._bits ^= 1 << chance.choice((Control.RELEASE, Control.RELEASE, Control.RESET, Control.TRUCK_PRESENT))
        self._beat = (self._beat + 1) & 0xFFFF
        return PlcWrite(PLC, heartbeat=self._beat, control=self._bits)


def play(seed: int, record: Recorder | None = None) -> Bench:
    """One visit to its end: sensors that die, a technician who comes, a gateway that starts anew, or stands still."""
    chance = random.Random(f"play {seed}")
    bench = Bench(story(seed), settings(seed), seed=seed, record=record)
    bench.plc = Writer(seed)
    dead = sorted(DEAD | {Quality.NO_ECHO, Quality.UNSTABLE, Quality.NO_TARGET})
    while bench.t_s < LENGTH_S:
        bench.run(bench.t_s + chance.uniform(0.5, 8))
        match chance.randrange(8):
            case 0:
                bench.vision_fault = chance.choice(dead)
                bench.run(bench.t_s + chance.uniform(0.05, 2))
                bench.vision_fault = None
            case 1:
                bench.range_fault = chance.choice(dead)
                bench.run(bench.t_s + chance.uniform(0.05, 2))
                bench.range_fault = None
            case 2:
                bench.check_function(chance.choice((FunctionCheck.MAY_MOVE_OFF, FunctionCheck.MAY_MOVE_KEPT)))
                bench.run(bench.t_s + chance.uniform(0.05, 2))
                bench.check_function(FunctionCheck.OFF)
            case 3:
                bench.power_on()
            case 4:
                bench.ticking = False
                bench.run(bench.t_s + chance.uniform(0.1, 1.5))
                bench.ticking = True
            case _:
                pass
    return bench
