"""The function block's body in Rockwell's structured text, for an Add-On Instruction. Pure.

Logix has signed numbers only, no functions and no TRUE: words are masked into DINT, floats are copied bit by bit (COP,
low word first, as Logix keeps them), a BOOL is set to 1 or 0. The chain of checks is the one of all the exports.
"""

from gateway.modbus.exports.diagnosis import FIRST_ALIVE
from gateway.modbus.exports.fields import Field, fields
from gateway.modbus.exports.logic import checks, dead_fields, iec
from gateway.modbus.exports.target import Target
from gateway.modbus.registers import Register

_HEARTBEAT = """\
// A heartbeat counts once it was seen to change between two good polls.
Changed := 0;
IF PollOk THEN
  IF Seen AND (Raw.heartbeat <> LastHeartbeat) THEN
    Changed := 1;
    Beating := 1;
  END_IF;
  LastHeartbeat := Raw.heartbeat;
  Seen := 1;
ELSE
  Seen := 0;
END_IF;
HeartbeatTimer.PRE := HeartbeatTimeoutMs;
HeartbeatTimer.TimerEnable := NOT Changed;
TONR(HeartbeatTimer);
IF HeartbeatTimer.DN THEN
  Beating := 0;
END_IF;
"""

_OUTPUTS = """\
// Whatever is not known to be right takes the enable away. Nothing of a doubtful image is handed on: Data then reads
// as that of a gateway that has stopped deciding.
Alive := (Diagnostic = 0) OR (Diagnostic >= {first_alive});
Enable := (Diagnostic = 0);
IF Alive THEN
  COP(Raw, Data, 1);
ELSE
  COP(Nothing, Data, 1);
{dead}
END_IF;
MustStop := (Data.stop <> 0);
Reason := Data.reason;

// The PLC's own heartbeat, for gateways that take writes.
IF PlcHeartbeat >= 65535 THEN
  PlcHeartbeat := 0;
ELSE
  PlcHeartbeat := PlcHeartbeat + 1;
END_IF;
"""

# Runs when the instruction's rung is false or the controller starts: outputs would else stand as they were.
OFF = """\
Enable := 0;
MustStop := 1;
Alive := 0;
Diagnostic := 1;
Seen := 0;
Beating := 0;
"""


def body(target: Target) -> str:
    """The routine "Logic"."""
    decode = "// The words of one poll, as fields.\n" + "\n".join(_decode(field, target) for field in fields())
    dead = "\n".join(f"  Data.{name} := {value};" for name, value in dead_fields(true="1"))
    outputs = _OUTPUTS.format(first_alive=FIRST_ALIVE, dead=dead)
    return f"{decode}\n\n{_HEARTBEAT}\n{iec(checks())}\n{outputs}"


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
