"""The words of one poll as fields, for IEC 61131-3 structured text and Siemens SCL. Pure.

A float is put together by arithmetic, which is exact because only powers of two are multiplied: not every tool has
unions, pointers or shifts.
"""

from gateway.modbus.exports.fields import Field, fields, measured
from gateway.modbus.exports.target import Target, template
from gateway.modbus.registers.register_map import Register

NO_VALUE = "1.0E+38"
"""A REAL that has none, beside its `_valid`: beyond every limit, and no truck at the sensor. Not NaN, which not every
language has, and which stops programs where floating point exceptions are on (TwinCAT)."""

UDINT_BODY = """\
#LG_UDInt := WORD_TO_UDINT(#High) * UDINT#65536 + WORD_TO_UDINT(#Low);
"""

REAL_BODY = template("LG_Real.scl")


def decode(target: Target) -> str:
    """`Raw`, field by field."""
    return "(* The words of one poll, as fields. *)\n" + "\n".join(_decode(field, target) for field in fields()) + "\n"


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
    return NO_VALUE if measured(register) else "0"
