"""The checks that every generated PLC program makes before it uses an image. Pure; one table for both outputs.

An image names at most one of two outputs: the truck may move (`may_move`), or it is in place (`in_place`). A check
names the outputs that it can take away (`needs`); the first that fails is the diagnosis. The checks of SOUND are made
first: only an image that passes them is evaluated, and only there does a heartbeat count.

A condition is written in the subset that IEC 61131-3 structured text, Siemens SCL and Rockwell structured text share,
with `#` before every local name (as in SCL); it is true when the check fails. `Raw` is the decoded block.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum

from gateway.core.readings import FRESH_FRAME, Quality
from gateway.core.state import VisitPhase
from gateway.modbus.registers.register_map import BLOCK_WORDS, KNOWN_FLOAT32, KNOWN_UINT32, MAP_VERSION

HEARTBEAT_TIMEOUT_MS = 500
HEARTBEAT_CHANGES = 2  # an image left over from before and one frozen image make one change, never two
HALF_CIRCLE = 32768  # of the numbers of 16 bits: a heartbeat that went farther has gone back
SWAPPED_UINT32 = (KNOWN_UINT32 & 0xFFFF) << 16 | KNOWN_UINT32 >> 16


class Diagnosis(IntEnum):
    """Why both outputs are off. Never renumber, only add."""

    OK = 0
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
    NO_MAY_MOVE = 11
    CAMERA = 12
    WRONG_BAY = 13
    NO_ECHO = 14


class NeededOutput(Enum):
    """Which output needs a check to pass; the value is what makes the check count, in the common language."""

    BOTH = ""
    MAY_MOVE = "(#Raw.in_place = 0) AND "
    IN_PLACE = "(#Raw.in_place = 1) AND "

    @property
    def outputs(self) -> str:
        """For people."""
        return {"BOTH": "MayMove, InPlace", "MAY_MOVE": "MayMove", "IN_PLACE": "InPlace"}[self.name]


@dataclass(frozen=True, slots=True)
class Check:
    """`fails`: the condition. `meaning`: what was found. `action`: what a person does."""

    diagnosis: Diagnosis
    fails: str
    meaning: str
    action: str
    needs: NeededOutput = NeededOutput.BOTH

    @property
    def condition(self) -> str:
        """`fails`, only for the output that needs the check."""
        return f"{self.needs.value}({self.fails})" if self.needs.value else self.fails


def _none_of(name: str, codes: Collection[IntEnum]) -> str:
    return " AND ".join(f"(#Raw.{name} <> {code.value})" for code in sorted(codes))


# Where the gateway lets a truck drive though one sensor has no good value (docs/visit.md), it is not so that; all else
# needs both. Without NOT before brackets, which STruC++ 0.6.1 does not compile.
NOT_BEYOND_THE_RANGER = (
    "(#Raw.may_move <> 1) OR (#Raw.vision_quality <> 0) OR (NOT #Raw.d_valid) OR (#Raw.d <> 0)"
    f" OR ({_none_of('visit_phase', (VisitPhase.ARRIVING, VisitPhase.LEAVING))})"
    f" OR ({_none_of('range_quality', (Quality.NO_ECHO, Quality.TOO_FAR))})"
)
NOT_RELEASED_COVERED = f"(NOT #Raw.position_status_released) OR ({_none_of('vision_quality', FRESH_FRAME)})"


Raw = Mapping[str, float | bool]
"""A decoded block by the names of the PLC programs' fields (gateway/modbus/exports/fields.py)."""


# Two facts of one image that can't both be true, as the programs and as `gateway update` find it; a test compares both.
# What the gateway guarantees: docs/visit.md, gateway/core/visit.py.
CONTRADICTIONS: dict[str, Callable[[Raw], bool]] = {
    "(#Raw.stop > 1) OR (#Raw.may_move > 1) OR (#Raw.in_place > 1)":
        lambda raw: max(raw["stop"], raw["may_move"], raw["in_place"]) > 1,
    "(#Raw.may_move = 1) AND (#Raw.stop = 1)": lambda raw: raw["may_move"] == raw["stop"] == 1,
    "(#Raw.may_move = 1) AND (#Raw.in_place = 1)": lambda raw: raw["may_move"] == raw["in_place"] == 1,
    "(#Raw.may_move = 1) AND (#Raw.reason <> 0)": lambda raw: raw["may_move"] == 1 and raw["reason"] != 0,
    "(#Raw.in_place = 1) AND (#Raw.stop = 0)": lambda raw: raw["in_place"] == 1 and raw["stop"] == 0,
    "(#Raw.in_place = 1) AND (#Raw.moved <> 0)": lambda raw: raw["in_place"] == 1 and raw["moved"] != 0,
    "(#Raw.in_place = 1) AND #Raw.d_valid AND (#Raw.d = 0)":
        lambda raw: raw["in_place"] == 1 and bool(raw["d_valid"]) and raw["d"] == 0,
    "#Raw.status_stop XOR (#Raw.stop = 1)": lambda raw: raw["status_stop"] != (raw["stop"] == 1),
    "#Raw.status_may_move XOR (#Raw.may_move = 1)": lambda raw: raw["status_may_move"] != (raw["may_move"] == 1),
    "#Raw.position_status_may_move XOR (#Raw.may_move = 1)":
        lambda raw: raw["position_status_may_move"] != (raw["may_move"] == 1),
    "#Raw.position_status_in_place XOR (#Raw.in_place = 1)":
        lambda raw: raw["position_status_in_place"] != (raw["in_place"] == 1),
    "#Raw.position_status_moved XOR (#Raw.moved <> 0)": lambda raw: raw["position_status_moved"] != (raw["moved"] != 0),
    "#Raw.position_status_held AND (#Raw.in_place = 0)":
        lambda raw: bool(raw["position_status_held"]) and raw["in_place"] == 0,
    "(#Raw.signal_lamps_green OR #Raw.signal_lamps_amber) AND (#Raw.may_move = 0)":
        lambda raw: bool(raw["signal_lamps_green"] or raw["signal_lamps_amber"]) and raw["may_move"] == 0,
}  # fmt: skip


def contradictions(raw: Raw) -> list[str]:
    """Those of CONTRADICTIONS that are true of `raw`, in words."""
    return [claim.replace("#Raw.", "") for claim, holds in CONTRADICTIONS.items() if holds(raw)]


SOUND: tuple[Check, ...] = (
    Check(
        Diagnosis.POLL_FAILED,
        "NOT #PollOk",
        "the last poll failed",
        "cable, address, port, firewall, the gateway's list of allowed clients",
    ),
    Check(
        Diagnosis.WORD_ORDER,
        f"(#Raw.known_u32 = {SWAPPED_UINT32})"
        f" OR ((#Raw.known_u32 = {KNOWN_UINT32}) AND (#Raw.known_f32 <> {KNOWN_FLOAT32}))",
        "the known constants arrive with their words swapped",
        "export again with the other --word-order, or change modbus.word_order",
    ),
    Check(
        Diagnosis.FOREIGN,
        f"#Raw.known_u32 <> {KNOWN_UINT32}",
        "the known constants are not there: nothing polled yet, another device, or another start address",
        f"read {BLOCK_WORDS} registers from address 0 of this gateway, function code 3; check for an offset of one",
    ),
    Check(
        Diagnosis.TORN,
        "#Raw.seq_begin <> #Raw.seq_end",
        "the block holds parts of two images",
        f"read all {BLOCK_WORDS} registers in one request",
    ),
    Check(
        Diagnosis.OLD_MAP,
        f"#Raw.map_version < {MAP_VERSION}",
        f"the gateway's map is older than {MAP_VERSION}, for which this program was made",
        "update the gateway, or export from the version that runs",
    ),
    Check(
        Diagnosis.WRONG_BAY,
        "(#Raw.unit_id <> #UnitId) OR (#Raw.bay_identity <> #BayIdentity)",
        "this is another bay than the one that this program was made for",
        "compare registers 101 to 103 with the head of the export: another unit id or address is polled, or site,"
        " instance or bay were renamed: export again with --config",
    ),
    Check(
        Diagnosis.CONTRADICTION,
        "\n    OR ".join(f"({claim})" for claim in CONTRADICTIONS),
        "stop, may_move, in_place, moved, reason and the status words contradict each other",
        "something between gateway and PLC changes the data: a wrong mapping, a second writer",
    ),
)

ALIVE: tuple[Check, ...] = (
    Check(
        Diagnosis.HEARTBEAT,
        "NOT #Beating",
        "the heartbeat does not change, or no change was seen yet",
        "normal for a moment after the start; else restart the gateway and keep its log",
    ),
    Check(
        Diagnosis.NO_ECHO,
        "#Writes AND #Raw.handshake_status_writes_on AND (NOT #Answering)",
        "plc_heartbeat does not return the numbers of this block: its writes do not arrive, or the image is no answer",
        "write_conflicts that counts: another program writes to this bay; else the writes; a program that only reads"
        " beside a PLC that writes: Writes FALSE",
    ),
)

VALUES: tuple[Check, ...] = (
    Check(
        Diagnosis.STOP,
        "#Raw.stop <> 0",
        "stop is on, and the truck is not in place",
        "the cause is in register reason",
        NeededOutput.MAY_MOVE,
    ),
    Check(
        Diagnosis.VISION,
        f"(#Raw.vision_quality <> 0) AND ({NOT_RELEASED_COVERED})",
        "the camera's measurement is not good (of a released truck the marker may be covered)",
        "the cause is in register vision_quality",
        NeededOutput.MAY_MOVE,
    ),
    Check(
        Diagnosis.RANGER,
        f"(#Raw.range_quality <> 0) AND ({NOT_BEYOND_THE_RANGER})",
        "the ranger's measurement is not good (a truck that the camera sees may be beyond its range)",
        "the cause is in register range_quality",
    ),
    Check(
        Diagnosis.NO_MAY_MOVE,
        "#Raw.may_move <> 1",
        "the truck may not move, and it is not in place",
        "a function check (ne107_active), or a bit of plc_control that is required; with fail_safe off a fault",
        NeededOutput.MAY_MOVE,
    ),
    Check(
        Diagnosis.CAMERA,
        _none_of("vision_quality", FRESH_FRAME),
        "in_place without a live camera; a covered marker (no_target, coasted) does not count",
        "the cause is in register vision_quality",
        NeededOutput.IN_PLACE,
    ),
)

CHECKS: tuple[Check, ...] = (*SOUND, *ALIVE, *VALUES)
"""In the order in which they are made. FIRST_ALIVE to LAST_ALIVE: a live gateway, whose image is handed on."""
FIRST_ALIVE, LAST_ALIVE = (find(int(check.diagnosis) for check in VALUES) for find in (min, max))

MEANING: dict[int, tuple[str, str]] = {
    int(Diagnosis.OK): ("ok", "all checks passed: MayMove or InPlace is on"),
    **{
        int(check.diagnosis): (check.diagnosis.name.lower(), check.meaning)
        for check in sorted(CHECKS, key=lambda check: check.diagnosis)
    },
}
