"""The function block's body in Rockwell's structured text, for an Add-On Instruction. Pure.

Logix has signed numbers only, no functions and no TRUE: words are masked into DINT, floats are copied bit by bit (COP,
low word first, as Logix keeps them), a BOOL is set to 1 or 0. All after the decoding is the common logic,
translated statement by statement.
"""

import re

from gateway.core.plc import Control
from gateway.modbus.exports.diagnosis import Diagnosis
from gateway.modbus.exports.fields import Field, fields
from gateway.modbus.exports.interface import OUTPUTS
from gateway.modbus.exports.logic import dead_fields, iec, logic, nothing
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import Register

_TIMER = re.compile(r"^(\w+)\(IN := (.+), PT := (\w+|T#\d+ms)\);$", re.MULTILINE)
_COPY = re.compile(r"^( *)Data := (Raw|Nothing);$", re.MULTILINE)


def body(target: Target) -> str:
    """The routine "Logic"."""
    decode = "// The words of one poll, as fields.\n" + "\n".join(_decode(field, target) for field in fields())
    return f"{decode}\n\n{translated(logic())}"


def off() -> str:
    """What runs while the instruction's rung is false, and when the controller starts: everything reads as dead.

    Otherwise outputs, Data and memory would keep their values. Of what is written only "truck present" stays:
    cleared, it would mean that the truck has left.
    """
    reason = dict(dead_fields())["reason"]
    started = {"MustStop": "1", "Alive": "0", "Diagnostic": f"{int(Diagnosis.POLL_FAILED)}", "Reason": reason}
    kept = {"PlcHeartbeat", "PlcControl", "RecipeSelect", "Data"}
    lines = [f"{var.name} := {started.get(var.name, '0')};" for var in OUTPUTS if var.name not in kept]
    memory = ("Sound", "Seen", "Changed", "Changes", "Beating", "TriggerWas", "TriggerBit", "AcknowledgeBit", "Stage")
    lines += [f"{name} := 0;" for name in memory]
    lines.append(f"PlcControl := PlcControl AND {1 << Control.TRUCK_PRESENT};")
    return translated("\n".join([nothing(), *lines, ""]))


def translated(text: str) -> str:
    """The common language as Logix takes it: timers by TONR, structures by COP, 1 and 0."""
    text = _TIMER.sub(_timer, iec(text))
    text = _COPY.sub(r"\1COP(\2, Data, 1);", text).replace("Timer.Q", "Timer.DN")
    code = re.split(r"(\(\*.*?\*\))", text, flags=re.DOTALL)  # comments stay as they are
    code[::2] = [re.sub(r"\bFALSE\b", "0", re.sub(r"\bTRUE\b", "1", part)) for part in code[::2]]
    return "".join(code)


def _timer(found: re.Match[str]) -> str:
    name, on, limit = found[1], found[2], found[3]
    preset = limit[2:-2] if limit.startswith("T#") else f"{limit}Ms"
    return f"{name}.PRE := {preset};\n{name}.TimerEnable := {on};\nTONR({name});"


def _decode(field: Field, target: Target) -> str:
    name, register = f"Raw.{field.name}", field.register
    word = f"(Words[{register.address}] AND 65535)"
    if field.part == "valid":
        none = f"IF NOT {name} THEN\n  Raw.{register.name} := 0;\nEND_IF;"
        return f"{name} := ({_valid(register, target)});\n{none}"
    if field.part == "bit":
        return f"{name} := ((Words[{register.address}] AND {1 << field.bit}) <> 0);"
    if field.part in ("high", "low"):
        first = (field.part == "high") == (target.word_order == "big")
        return f"{name} := {_pair(register.address + (0 if first else 2), target)};"
    if register.kind.is_float:
        high, low = target.high_low(register.address)
        return f"Pair[0] := Words[{low}];\nPair[1] := Words[{high}];\nCOP(Pair[0], {name}, 1);"
    if register.words == 2:
        return f"{name} := {_pair(register.address, target)};"
    value = f"Words[{register.address}]" if register.kind.low < 0 else word
    return f"{name} := {value}{'' if register.scale == 1 else f' * {register.scale}'};"


def _pair(address: int, target: Target) -> str:
    high, low = target.high_low(address)
    return f"(Words[{high}] * 65536) + (Words[{low}] AND 65535)"


def _valid(register: Register, target: Target) -> str:
    if register.kind.is_float:
        high, _ = target.high_low(register.address)
        return f"(Words[{high}] AND 32640) <> 32640"
    return f"(Words[{register.address}] AND 65535) <> {register.kind.no_value}"
