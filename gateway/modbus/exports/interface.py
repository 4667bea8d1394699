"""The function block's interface: its inputs, outputs and memory, once for every language. Pure.

Neither output is called enable: MayMove is for the truck, InPlace for the spout, so that a program that mixes them up
must name the wrong one explicitly.
"""

from dataclasses import dataclass

from gateway.core.plc import Control
from gateway.modbus.exports.diagnosis import HEARTBEAT_TIMEOUT_MS
from gateway.modbus.registers.register_map import BLOCK_WORDS, REGISTERS

_ADDRESS = {register.name: register.address for register in REGISTERS}
FIRST_WRITTEN = _ADDRESS["plc_heartbeat"]
WRITTEN = ("PlcHeartbeat", "PlcControl", "RecipeSelect")
"""The outputs that go to the registers from FIRST_WRITTEN on, in this order, where [modbus] writes is on."""


@dataclass(frozen=True, slots=True)
class Var:
    """`kind`: BOOL, UINT, TIME, or one of the names below. `start`: its value before the first call; "": the type's."""

    name: str
    kind: str
    comment: str
    start: str = ""


@dataclass(frozen=True, slots=True)
class FunctionBlock:
    """`body`: statements of the common language (logic.py)."""

    name: str
    inputs: tuple[Var, ...]
    outputs: tuple[Var, ...]
    memory: tuple[Var, ...]
    body: str
    comment: str = ""


BLOCK, DATA, TIMER = "BLOCK", "DATA", "TIMER"  # the polled words; the decoded block; an on-delay timer

INPUTS: tuple[Var, ...] = (
    Var("PollOk", "BOOL", "the last completed poll had no error; TRUE where your client does not report it"),
    Var("Words", BLOCK, f"registers 0 to {BLOCK_WORDS - 1}, of one request"),
    Var("UnitId", "UINT", "unit id of this bay, as the gateway has it in register 101; 0 fits no bay"),
    Var("BayIdentity", "UDINT", "number of this bay, as the gateway has it in registers 102 and 103; 0 fits no bay"),
    Var(
        "HeartbeatTimeout",
        "TIME",
        "the gateway's heartbeat must change within this time, and where it accepts writes return this block's own",
        f"T#{HEARTBEAT_TIMEOUT_MS}ms",
    ),
    Var("Writes", "BOOL", "FALSE only in a program that reads beside a PLC that writes", "TRUE"),
    Var("EnableRequest", "BOOL", "the bay is wanted in use"),
    Var("TruckPresent", "BOOL", "a truck is in the bay; back to FALSE: it has left"),
    Var("Reset", "BOOL", "rising: end the latched stop, or that of a truck that moved, if its cause is gone"),
    Var("Trigger", "BOOL", "rising: start a measurement; the block does the handshake"),
    Var("Acknowledge", "BOOL", "TRUE while ResultReady: the result was read"),
    Var(
        "Release",
        "BOOL",
        "rising while SpoutUp and the truck is or was in place: it may leave; hold TRUE until it has left its mark",
    ),
    Var("SpoutUp", "BOOL", "the spout is up; without it no release is sent, and one that was sent ends"),
    Var("Start", "BOOL", "rising while InPlace: loading begins, see LoadPermit"),
    Var("Recipe", "UINT", "id of the recipe wanted; 0: the configuration as it is"),
)

OUTPUTS: tuple[Var, ...] = (
    Var("MayMove", "BOOL", "TRUE: the truck may move. Never a condition for loading"),
    Var("InPlace", "BOOL", "TRUE: the truck is in place. The only condition for loading"),
    Var("LoadPermit", "BOOL", "TRUE from Start on, until InPlace ends or the truck rolls; then a new Start is needed"),
    Var(
        "Rolling", "BOOL", "TRUE: a truck that was in place begins to move without release: stop loading; before Moved"
    ),
    Var("Moved", "BOOL", "TRUE: the truck left its place without release"),
    Var("Held", "BOOL", "TRUE: InPlace is held by the ranger alone, the marker is covered"),
    Var("MustStop", "BOOL", "TRUE: the truck must stop; also whenever nothing is known", "TRUE"),
    Var("Alive", "BOOL", "TRUE: Data is of a live gateway"),
    Var("Diagnostic", "UINT", "0, or the check that failed", "1"),
    Var("Reason", "UINT", "register reason: why stop is on", "40"),
    Var("TriggerReady", "BOOL", "TRUE: a rising Trigger would be accepted"),
    Var("Measuring", "BOOL", "TRUE: a triggered measurement runs"),
    Var("ResultReady", "BOOL", "TRUE: Data.result_... hold the result of the trigger; acknowledge it"),
    Var("TriggerFailed", "BOOL", "TRUE: the newest trigger gave no result; until the next one"),
    Var("MayWrite", "BOOL", "TRUE: this bay's gateway accepts writes"),
    *(
        Var(name, "UINT", f"write it to register {FIRST_WRITTEN + place} while MayWrite")
        for place, name in enumerate(WRITTEN)
    ),
    Var("Data", DATA, "the block in engineering units; a dead gateway's while not Alive"),
)

MEMORY: tuple[Var, ...] = (
    Var("Raw", DATA, "the newest words, decoded"),
    Var("Nothing", DATA, "never written"),
    Var("Sound", "BOOL", "the newest image passed the checks of an image"),
    Var("HeartbeatTimer", TIMER, ""),
    Var("LastHeartbeat", "UINT", ""),
    Var("Seen", "BOOL", "LastHeartbeat is of a valid image, and all images since were valid"),
    Var("Changed", "BOOL", ""),
    Var("Changes", "UINT", "how often the heartbeat was seen to change"),
    Var("Beating", "BOOL", ""),
    Var("Steps", "UINT", "how far a number is ahead of another"),
    Var("Written", "UINT", "how many numbers this block has made since Challenge"),
    Var("Challenge", "UINT", "PlcHeartbeat when the newest answer arrived: the next one must be newer"),
    Var("Answered", "BOOL", "the newest image holds such a number"),
    Var("Answers", "UINT", "how often"),
    Var("Answering", "BOOL", ""),
    Var("AnswerTimer", TIMER, ""),
    Var("TriggerWas", "BOOL", ""),
    Var("TriggerBit", "BOOL", "as it is written"),
    Var("AcknowledgeBit", "BOOL", "as it is written"),
    Var("StartWas", "BOOL", "", "TRUE"),
    Var("ReleaseWas", "BOOL", "", "TRUE"),
    Var("ReleaseBit", "BOOL", "as it is written"),
    Var("Stage", "UINT", "of a triggered measurement: 0 none, 1 requested, 2 accepted, 3 result held, 4 acknowledged"),
    Var("Entered", "BOOL", "Stage has just changed"),
    Var("StageTimer", TIMER, ""),
)

REQUESTS: tuple[tuple[str, Control], ...] = (
    ("EnableRequest", Control.ENABLE),
    ("TruckPresent", Control.TRUCK_PRESENT),
    ("Reset", Control.RESET),
    ("TriggerBit", Control.TRIGGER),
    ("AcknowledgeBit", Control.RESULTS_ACK),
    ("ReleaseBit", Control.RELEASE),
    ("SpoutUp", Control.SPOUT_UP),
)
"""What is in PlcControl, and at which bit."""
