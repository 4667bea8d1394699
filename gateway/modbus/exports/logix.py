"""The function block's body in Rockwell's structured text, for an Add-On Instruction. Pure.

Logix has signed numbers only, no functions and no TRUE: words are masked into DINT, floats are copied bit by bit (COP,
low word first, as Logix keeps them), a BOOL is set to 1 or 0. All after the decoding is the common logic,
translated statement by statement, as the decoding is.
"""

import re

from gateway.core.plc import Control
from gateway.modbus.exports.decode import decode
from gateway.modbus.exports.diagnosis import Diagnosis
from gateway.modbus.exports.interface import OUTPUTS, TIMER, FunctionBlock
from gateway.modbus.exports.logic import dead_fields, iec, logic, nothing
from gateway.modbus.exports.target import Target

_TIMER = re.compile(r"^(\w+)\(IN := (.+), PT := (\w+|T#\d+ms)\);$", re.MULTILINE)
_WORD = r"(Words\[\d+\])"
_DECODING = (
    (rf"^(.+) := LG_Real\(High := {_WORD}, Low := {_WORD}\);", r"Pair[0] := \3;\nPair[1] := \2;\nCOP(Pair[0], \1, 1);"),
    (rf"LG_UDInt\(High := {_WORD}, Low := {_WORD}\)", r"(\1 * 65536) + (\2 AND 65535)"),
    (rf"WORD_TO_UINT\({_WORD}\)", r"(\1 AND 65535)"),
    (rf"WORD_TO_INT\({_WORD}\)", r"\1"),
    (r"\w+_TO_REAL\((.+)\)", r"\1"),
    (rf":= {_WORD} <>", r":= (\1 AND 65535) <>"),
    (r":= (.+ <> .+);", r":= (\1);"),
)
"""Statements of decode.py, and what they are here."""
_COPY = re.compile(r"^( *)Data := (Raw|Nothing);$", re.MULTILINE)


def body(target: Target) -> str:
    """The routine "Logic"."""
    text = iec(decode(target))
    for statement, here in _DECODING:
        text = re.sub(statement, here, text, flags=re.MULTILINE)
    text = re.sub(r"16#([0-9A-F]+)", lambda found: str(int(found[1], 16)), text)
    return f"{text}\n{translated(logic(target))}"


def off() -> str:
    """What runs while the instruction's rung is false, and when the controller starts: everything reads as dead.

    Otherwise outputs, Data and memory would keep their values. Of what is written only "truck present" stays:
    cleared, it would mean that the truck has left.
    """
    reason = dict(dead_fields())["reason"]
    started = {"MustStop": "1", "Alive": "0", "Diagnostic": f"{int(Diagnosis.POLL_FAILED)}", "Reason": reason}
    kept = {"PlcHeartbeat", "PlcControl", "RecipeSelect", "Data"}
    lines = [f"{var.name} := {started.get(var.name, '0')};" for var in OUTPUTS if var.name not in kept]
    memory = ["Sound", "Seen", "Changed", "Changes", "Beating", "Answers", "Answering"]
    memory += ["TriggerWas", "TriggerBit", "AcknowledgeBit", "ReleaseBit", "Stage"]
    lines += [f"{name} := 0;" for name in memory]
    lines += ["StartWas := 1;", "ReleaseWas := 1;"]
    lines.append(f"PlcControl := PlcControl AND {1 << Control.TRUCK_PRESENT};")
    return translated("\n".join([nothing(), *lines, ""]))


def reset(block: FunctionBlock) -> str:
    """The same for a block that holds no data: every output and memory as it starts."""
    kept = [var for var in (*block.outputs, *block.memory) if var.kind != TIMER]
    return "\n".join(f"{var.name} := {'1' if var.start == 'TRUE' else '0'};" for var in kept)


def translated(text: str) -> str:
    """The common language as Logix takes it: timers by TONR, structures by COP, 1 and 0; no conversions."""
    text = re.sub(r"\b[A-Z]+_TO_[A-Z]+\(", "(", _TIMER.sub(_timer, iec(text)))
    text = _COPY.sub(r"\1COP(\2, Data, 1);", text).replace("Timer.Q", "Timer.DN")
    code = re.split(r"(\(\*.*?\*\))", text, flags=re.DOTALL)  # comments stay as they are
    code[::2] = [re.sub(r"\bFALSE\b", "0", re.sub(r"\bTRUE\b", "1", part)) for part in code[::2]]
    return "".join(code)


def _timer(found: re.Match[str]) -> str:
    name, on, limit = found[1], found[2], found[3]
    preset = limit[2:-2] if limit.startswith("T#") else f"{limit}Ms"
    return f"{name}.PRE := {preset};\n{name}.TimerEnable := {on};\nTONR({name});"
