"""The function block's body, once for IEC 61131-3 structured text and Siemens SCL. Pure.

Written as SCL wants it, with `#` before local names and function names in quotes; `iec` takes both away. Only what both
languages and every tool share is used: no pointers, no unions, no shifts, no 64-bit numbers. A float is put together
by arithmetic, which is exact because only powers of two are multiplied.
"""

import re
from collections.abc import Iterator

from gateway.modbus.exports.diagnosis import CHECKS, FIRST_ALIVE
from gateway.modbus.exports.fields import Field, fields, measured
from gateway.modbus.exports.target import Target
from gateway.modbus.registers import Register, dead_image
from gateway.model import StateVector

_PLAIN = {"×": "x", "–": "-", "°": "deg", "±": "+-", "µ": "u"}

UDINT_BODY = """\
#LG_UDInt := WORD_TO_UDINT(#High) * UDINT#65536 + WORD_TO_UDINT(#Low);
"""

# Sign, 8 bits of exponent with a bias of 127, 23 bits of fraction; an exponent of 255 is no number.
REAL_BODY = """\
#Exponent := WORD_TO_DINT(#High AND 16#7F80) / 128;
#Value := UDINT_TO_REAL(WORD_TO_UDINT(#High AND 16#007F) * UDINT#65536 + WORD_TO_UDINT(#Low));
IF #Exponent = 0 THEN
  #Exponent := 1;
ELSE
  #Value := #Value + 8388608.0;
END_IF;
IF #Exponent = 255 THEN
  #Value := 0.0;
  #Exponent := 150;
END_IF;
WHILE #Exponent > 150 DO
  #Value := #Value * 2.0;
  #Exponent := #Exponent - 1;
END_WHILE;
WHILE (#Exponent < 150) AND (#Value <> 0.0) DO
  #Value := #Value * 0.5;
  #Exponent := #Exponent + 1;
END_WHILE;
IF (#High AND 16#8000) <> 16#0000 THEN
  #Value := 0.0 - #Value;
END_IF;
#LG_Real := #Value;
"""

_HEARTBEAT = """\
(* A heartbeat counts once it was seen to change between two good polls. *)
#Changed := FALSE;
IF #PollOk THEN
  IF #Seen AND (#Raw.heartbeat <> #LastHeartbeat) THEN
    #Changed := TRUE;
    #Beating := TRUE;
  END_IF;
  #LastHeartbeat := #Raw.heartbeat;
  #Seen := TRUE;
ELSE
  #Seen := FALSE;
END_IF;
#HeartbeatTimer(IN := NOT #Changed, PT := #HeartbeatTimeout);
IF #HeartbeatTimer.Q THEN
  #Beating := FALSE;
END_IF;
"""

_OUTPUTS = """\
(* Whatever is not known to be right takes the enable away. Nothing of a doubtful image is handed on: Data then reads
   as that of a gateway that has stopped deciding. *)
#Alive := (#Diagnostic = 0) OR (#Diagnostic >= {first_alive});
#Enable := #Diagnostic = 0;
IF #Alive THEN
  #Data := #Raw;
ELSE
  #Data := #Nothing;
{dead}
END_IF;
#MustStop := #Data.stop <> 0;
#Reason := #Data.reason;

(* The PLC's own heartbeat, for gateways that take writes. *)
IF #PlcHeartbeat >= 65535 THEN
  #PlcHeartbeat := 0;
ELSE
  #PlcHeartbeat := #PlcHeartbeat + 1;
END_IF;
"""


def body(target: Target) -> str:
    """The whole function block: decode, heartbeat, checks, outputs."""
    decode = "(* The words of one poll, as fields. *)\n" + "\n".join(_decode(field, target) for field in fields())
    dead = "\n".join(f"  #Data.{name} := {value};" for name, value in dead_fields())
    return f"{decode}\n\n{_HEARTBEAT}\n{checks()}\n{_OUTPUTS.format(first_alive=FIRST_ALIVE, dead=dead)}"


def dead_fields(true: str = "TRUE") -> Iterator[tuple[str, str]]:
    """(field, value) of every code, flag and bit that is not 0 in the image of a gateway that has stopped deciding.

    Without them an empty structure would say "quality good, no reason". `true`: how the language spells it.
    """
    image = dead_image(StateVector(""), 0, 0, "big")
    for field in fields():
        register = field.register
        if register.codes is None and register.bits is None and register.name != "stop":
            continue
        word = image[register.address]
        if field.part == "bit" and word >> field.bit & 1:
            yield field.name, true
        elif field.part == "value" and word not in (0, register.kind.no_value):
            yield field.name, str(word)


def checks() -> str:
    """The chain of checks: the first that fails is the diagnosis."""
    lines = ["(* The first check that fails says why there is no enable. *)"]
    for n, check in enumerate(CHECKS):
        lines.append(f"{'ELSIF' if n else 'IF'} {check.fails} THEN")
        lines.append(f"  #Diagnostic := {int(check.diagnosis)}; (* {check.meaning} *)")
    return "\n".join([*lines, "ELSE", "  #Diagnostic := 0;", "END_IF;", ""])


def iec(text: str) -> str:
    """SCL's local names and quoted function names as plain IEC identifiers. Typed literals keep their `#`."""
    return re.sub(r'"(\w+)"', r"\1", re.sub(r"(?<!\w)#(?=[A-Za-z_])", "", text))


def ascii_only(text: str) -> str:
    """PLC tools disagree on encodings; the few signs that are not ASCII have a plain spelling."""
    for sign, plain in _PLAIN.items():
        text = text.replace(sign, plain)
    return text.encode("ascii", "replace").decode("ascii")


def _decode(field: Field, target: Target) -> str:
    name, register = f"#Raw.{field.name}", field.register
    if field.part == "valid":
        none = f"IF NOT {name} THEN\n  #Raw.{register.name} := {_zero(register)};\nEND_IF;"
        return f"{name} := {_valid(register, target)};\n{none}"
    if field.part == "bit":
        return f"{name} := (#Words[{register.address}] AND 16#{1 << field.bit:04X}) <> 16#0000;"
    if field.part in ("high", "low"):
        first = (field.part == "high") == (target.word_order == "big")
        return f"{name} := {_pair('LG_UDInt', register.address + (0 if first else 2), target)};"
    return f"{name} := {_value(register, field, target)};"


def _value(register: Register, field: Field, target: Target) -> str:
    if register.kind.is_float:
        return _pair("LG_Real", register.address, target)
    if register.words == 2:
        raw = _pair("LG_UDInt", register.address, target)
        kind = "UDINT"
    else:
        kind = "INT" if register.kind.low < 0 else "UINT"
        raw = f"WORD_TO_{kind}(#Words[{register.address}])"
    if field.kind != "REAL":
        return raw
    scale = "" if register.scale == 1 else f" * {register.scale}"
    return f"{kind}_TO_REAL({raw}){scale}"


def _pair(function: str, address: int, target: Target) -> str:
    high, low = target.high_low(address)
    return f'"{function}"(High := #Words[{high}], Low := #Words[{low}])'


def _valid(register: Register, target: Target) -> str:
    if register.kind.is_float:
        high, _ = target.high_low(register.address)
        return f"(#Words[{high}] AND 16#7F80) <> 16#7F80"
    return f"#Words[{register.address}] <> 16#{register.kind.no_value or 0:04X}"


def _zero(register: Register) -> str:
    return "0.0" if measured(register) else "0"
