"""The checks that every generated PLC program makes before it believes an image, in their order. Pure; one table.

The first check that fails names the diagnosis and takes the enable away. A condition is written in the subset that
IEC 61131-3 structured text, Siemens SCL and Rockwell structured text share, with `#` before every local name (as SCL
wants it); it is true when the check fails. `Raw` is the decoded block.
"""

from dataclasses import dataclass
from enum import IntEnum

from gateway.modbus.registers import KNOWN_FLOAT32, KNOWN_UINT32, MAP_VERSION

HEARTBEAT_TIMEOUT_MS = 500
_SWAPPED_UINT32 = (KNOWN_UINT32 & 0xFFFF) << 16 | KNOWN_UINT32 >> 16


class Diagnosis(IntEnum):
    """Why the enable is off. Never renumber, only add."""

    ENABLED = 0
    POLL_FAILED = 1
    WORD_ORDER = 2
    FOREIGN = 3
    TORN = 4
    OLD_MAP = 5
    HEARTBEAT = 6
    CONTRADICTION = 7
    STOP = 8
    VISION = 9
    RANGER = 10
    NO_PERMIT = 11


@dataclass(frozen=True, slots=True)
class Check:
    """`fails`: the condition. `alive` False: nothing in the image may be used. `action`: what a person does."""

    diagnosis: Diagnosis
    fails: str
    meaning: str
    action: str
    alive: bool = False


CHECKS: tuple[Check, ...] = (
    Check(
        Diagnosis.POLL_FAILED,
        "NOT #PollOk",
        "the last poll failed",
        "cable, address, port, firewall, the gateway's list of allowed clients",
    ),
    Check(
        Diagnosis.WORD_ORDER,
        f"(#Raw.known_u32 = {_SWAPPED_UINT32})"
        f" OR ((#Raw.known_u32 = {KNOWN_UINT32}) AND (#Raw.known_f32 <> {KNOWN_FLOAT32}))",
        "the known constants come with their words swapped",
        "export again with the other --word-order, or change modbus.word_order",
    ),
    Check(
        Diagnosis.FOREIGN,
        f"#Raw.known_u32 <> {KNOWN_UINT32}",
        "the known constants are not there: another device, or another start address",
        "read 100 registers from address 0 of this gateway, function code 3; check for an offset of one",
    ),
    Check(
        Diagnosis.TORN,
        "#Raw.seq_begin <> #Raw.seq_end",
        "the block is put together from two images",
        "read all 100 registers in one request",
    ),
    Check(
        Diagnosis.OLD_MAP,
        f"#Raw.map_version < {MAP_VERSION}",
        f"the gateway's map is older than {MAP_VERSION}, for which this program was made",
        "update the gateway, or export from the version that runs",
    ),
    Check(
        Diagnosis.HEARTBEAT,
        "NOT #Beating",
        "the heartbeat does not move, or has not been seen to move yet",
        "normal for a moment after the start; else restart the gateway and keep its log",
    ),
    Check(
        Diagnosis.CONTRADICTION,
        "(#Raw.stop > 1) OR (#Raw.may_move > 1) OR ((#Raw.stop = 1) AND (#Raw.may_move = 1))"
        " OR (#Raw.status_stop XOR (#Raw.stop = 1)) OR (#Raw.status_may_move XOR (#Raw.may_move = 1))"
        " OR ((#Raw.may_move = 1) AND (#Raw.reason <> 0))",
        "stop, may_move, reason and the status word contradict each other",
        "something between gateway and PLC changes the data: a wrong mapping, a second writer",
    ),
    Check(
        Diagnosis.STOP,
        "#Raw.stop <> 0",
        "the gateway says stop",
        "register reason says why",
        alive=True,
    ),
    Check(
        Diagnosis.VISION,
        "#Raw.vision_quality <> 0",
        "the camera's measurement is not good",
        "register vision_quality says why",
        alive=True,
    ),
    Check(
        Diagnosis.RANGER,
        "#Raw.range_quality <> 0",
        "the ranger's measurement is not good",
        "register range_quality says why",
        alive=True,
    ),
    Check(
        Diagnosis.NO_PERMIT,
        "#Raw.may_move <> 1",
        "the truck may not move",
        "the status word says what is missing",
        alive=True,
    ),
)

MEANING: dict[int, tuple[str, str]] = {
    int(Diagnosis.ENABLED): ("enabled", "all checks passed: the enable is on"),
    **{int(check.diagnosis): (check.diagnosis.name.lower(), check.meaning) for check in CHECKS},
}

# Diagnoses below this one mean that nothing in the block may be used.
FIRST_ALIVE = min(int(check.diagnosis) for check in CHECKS if check.alive)
