"""FB_Approach, which turns the gateway's speed setpoint into a drive's, and an example of a bay that uses it. Pure.

No tool has a clock that all others have, too: ramps count calls, and CycleMs is checked against a timer.
"""

import math
from dataclasses import replace
from enum import IntEnum

from gateway.config import DriveConfig, VisitConfig
from gateway.core.state import Reason
from gateway.modbus.exports.interface import DATA, TIMER, FunctionBlock, Var
from gateway.modbus.exports.logic import first_of
from gateway.modbus.exports.target import template

LIFE_MS = 500
LONGEST_CYCLE_MS = 100
WAIT_S, WAIT_MORE_S = 10, 3.0  # WaitTimeout: at least; and so much more than it can take


class ApproachEnd(IntEnum):
    """Why an approach ended before the vehicle was in place, or did not begin. Never renumber, only add."""

    NONE = 0
    LIFE = 1
    DRIVE = 2
    CYCLE = 3
    STOP = 4
    WAIT = 5


# On the way in, the stop of a vehicle that is at its mark is no end: in_place is still to come.
_AT_MARK = f"(NOT #Busy) OR ((#Data.reason <> {Reason.TARGET_REACHED:d}) AND (#Data.reason <> {Reason.CLEARING:d}))"
ENDS: dict[ApproachEnd, tuple[str, str]] = {
    ApproachEnd.LIFE: (
        "(NOT #Alive) OR #LifeLost",
        f"no life sign of the right bay for {LIFE_MS} ms, or the gateway's block is not Alive: its Diagnostic",
    ),
    ApproachEnd.DRIVE: ("NOT #DriveReady", "DriveReady is FALSE"),
    ApproachEnd.CYCLE: (
        "NOT #CycleFits",
        f"CycleMs is not the time between two calls, or longer than {LONGEST_CYCLE_MS} ms; also in the first second",
    ),
    ApproachEnd.STOP: (
        f"(NOT #MayMove) AND (NOT #InPlace) AND ({_AT_MARK})",
        "the gateway's block does not let the vehicle move: its Diagnostic and Reason",
    ),
    ApproachEnd.WAIT: ("#WaitTimer.Q", "the setpoint was 0 for WaitTimeout: register drive_state"),
}
"""Condition, in the common language, and meaning; the first that applies is the cause."""

APPROACH = FunctionBlock(
    "FB_Approach",
    (
        Var("Data", DATA, "Data of the gateway's block; call that one first, in every cycle"),
        Var("Alive", "BOOL", "its Alive: right bay, map version, word order, heartbeat"),
        Var("MayMove", "BOOL", "its MayMove"),
        Var("InPlace", "BOOL", "its InPlace"),
        Var("Start", "BOOL", "rising: the approach begins; one that ended begins again by a new edge only"),
        Var("DriveReady", "BOOL", "the drive is ready, and nothing of the plant forbids it to run; FALSE: 0 at once"),
        Var("CycleMs", "UINT", f"time between two calls, as the task has it, 1 to {LONGEST_CYCLE_MS} [ms]"),
        Var("Acceleration", "REAL", "at most so steep upwards [mm/s2]", "100.0"),
        Var("Deceleration", "REAL", "ramp without a life sign; at least brake_mm_s2 of the gateway [mm/s2]", "300.0"),
        Var("ReferenceSpeed", "REAL", "speed at which Analog is FullScale [mm/s]", "500.0"),
        Var("FullScale", "INT", "Analog at ReferenceSpeed", "27648"),
        Var("WaitTimeout", "TIME", "longest time at setpoint 0; by settle_s, lag_s, latency_s", f"T#{WAIT_S}000ms"),
    ),
    (
        Var("Run", "BOOL", "TRUE while Velocity is above 0: MC_MoveVelocity, else MC_Halt"),
        Var("Velocity", "REAL", "speed for the drive, towards the spout; never negative [mm/s]"),
        Var("Analog", "INT", "Velocity as an analogue output, 0 to FullScale"),
        Var("Busy", "BOOL", "TRUE from Start on, until Done or Fault: the vehicle may move by itself"),
        Var("Done", "BOOL", "TRUE: this approach has brought the vehicle in place; ends with InPlace"),
        Var("Fault", "BOOL", "TRUE: the approach ended early, or did not begin; until the next Start"),
        Var("Cause", "UINT", "why"),
    ),
    (
        Var("LifeTimer", TIMER, ""),
        Var("LifeLost", "BOOL", ""),
        Var("LastHeartbeat", "UINT", ""),
        Var("Calls", "UINT", "since ClockTimer was on"),
        Var("ClockTimer", TIMER, ""),
        Var("Counted", "REAL", "what the calls of one second come to [ms]"),
        Var("CycleFits", "BOOL", ""),
        Var("WaitTimer", TIMER, ""),
        Var("Problem", "UINT", "what Cause would be now"),
        Var("StartWas", "BOOL", "", "TRUE"),
        Var("Seconds", "REAL", "CycleMs"),
        Var("Setpoint", "REAL", "of the gateway [mm/s]"),
        Var("Exact", "REAL", "Analog before it is rounded"),
    ),
    template("approach.scl").format(
        life=LIFE_MS,
        longest=LONGEST_CYCLE_MS,
        causes="\n".join(first_of("Problem", ((applies, end, meaning) for end, (applies, meaning) in ENDS.items()))),
    ),
    "Moves the vehicle at the gateway's setpoint from a rising Start until it is in place. No safety function.",
)


def wait_s(drive: DriveConfig, visit: VisitConfig) -> int:
    """WaitTimeout for this configuration: a vehicle has run out, was seen to stand, and is in place before it."""
    runs_out_s = drive.delay_s + drive.creep_speed_mm_s / drive.brake_mm_s2
    return max(WAIT_S, math.ceil(runs_out_s + drive.delay_s + visit.settle_s + WAIT_MORE_S))


def approach(wait_s: int) -> FunctionBlock:
    """FB_Approach with this WaitTimeout."""
    inputs = (replace(var, start=f"T#{wait_s}000ms") if var.name == "WaitTimeout" else var for var in APPROACH.inputs)
    return replace(APPROACH, inputs=tuple(inputs))


PLANT_INPUTS: tuple[Var, ...] = (
    Var("StartButton", "BOOL", "rising: bring the vehicle in place and load it"),
    Var("StopButton", "BOOL", "normally closed: FALSE ends every step"),
    Var("SpoutTop", "BOOL", "upper limit switch of the spout"),
    Var("SpoutBottom", "BOOL", "lower limit switch of the spout"),
    Var("BarrierClosed", "BOOL", "nobody can step before the vehicle"),
    Var("DriveOk", "BOOL", "the drive is ready"),
    Var("Full", "BOOL", "the vehicle is loaded"),
    Var("TruckPresent", "BOOL", "a vehicle is in the bay"),
)
EXAMPLE_INPUTS = *PLANT_INPUTS, Var("CycleMs", "UINT", "of the task that calls this [ms]", "20")
PLANT_OUTPUTS: tuple[Var, ...] = (
    Var("RaiseSpout", "BOOL", ""),
    Var("LowerSpout", "BOOL", ""),
    Var("CloseBarrier", "BOOL", "FALSE: open"),
    Var("Lamp", "BOOL", "the vehicle may move by itself"),
    Var("Load", "BOOL", "discharge"),
)
SEQUENCE = FunctionBlock(
    "FB_LoadingSequence",
    (
        *PLANT_INPUTS,
        Var("InPlace", "BOOL", "of the gateway's block"),
        Var("LoadPermit", "BOOL", "of the gateway's block"),
        Var("ApproachRun", "BOOL", "Run of FB_Approach"),
        Var("ApproachDone", "BOOL", "Done of FB_Approach"),
        Var("ApproachFault", "BOOL", "Fault of FB_Approach"),
    ),
    (
        *PLANT_OUTPUTS,
        Var("Approach", "BOOL", "Start of FB_Approach"),
        Var("DriveReady", "BOOL", "for FB_Approach"),
        Var("LoadStart", "BOOL", "Start of the gateway's block"),
        Var("Release", "BOOL", "for the gateway's block"),
        Var(
            "Stage",
            "UINT",
            "0 none, 1 spout up and warn, 2 approach, 3 spout down, 4 load, 5 spout up, 6 release",
        ),
    ),
    (Var("StartWas", "BOOL", "", "TRUE"), Var("WarningTimer", TIMER, "")),
    template("sequence.scl"),
    "An example: one vehicle from the start button to its release. Change it to what your bay has.",
)


def wired(bay: str, gateway: str) -> str:
    """The calls of a bay's `_Sequence` and `_Approach`. `gateway`: the gateway's block as the program names it."""
    return template("example.scl").format(bay=bay, gateway=gateway)
