"""A register in a PLC: typed fields, a flag where it may hold no value, a flag for every bit. Pure.

Measured values become REAL in their unit; codes, counters and ids stay integers. 64-bit values become two 32-bit
halves, because small PLCs have no longer type.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from gateway.modbus.registers.register_map import REGISTERS, Register

FieldKind = Literal["UINT", "INT", "UDINT", "REAL", "BOOL"]


@dataclass(frozen=True, slots=True)
class Field:
    """One member of the PLC's structure. `part`: which part of its register it shows."""

    name: str
    kind: FieldKind
    comment: str
    register: Register
    part: Literal["value", "valid", "bit", "high", "low"]
    bit: int = 0


def fields() -> Iterator[Field]:
    """Every member of the structure, in the order of the table."""
    for register in REGISTERS:
        yield from _of(register)


def _of(register: Register) -> Iterator[Field]:
    if register.words == 4:
        yield Field(f"{register.name}_high", "UDINT", f"{describe(register)}: high half", register, "high")
        yield Field(f"{register.name}_low", "UDINT", f"{describe(register)}: low half", register, "low")
        return
    yield Field(register.name, _kind(register), describe(register), register, "value")
    if register.kind.no_value is not None:
        yield Field(f"{register.name}_valid", "BOOL", f"{register.name} holds a value", register, "valid")
    for bit, (name, meaning) in (register.bits or {}).items():
        yield Field(f"{register.name}_{name}", "BOOL", meaning, register, "bit", bit)


def measured(register: Register) -> bool:
    """A quantity with a unit or a fraction, for which a PLC uses a REAL."""
    return register.kind.is_float or register.scale != 1 or (register.kind.no_value is not None and bool(register.unit))


def describe(register: Register) -> str:
    """Meaning and unit on one line."""
    return f"{register.meaning} [{register.unit}]" if register.unit else register.meaning


def _kind(register: Register) -> FieldKind:
    if measured(register):
        return "REAL"
    if register.words == 2:
        return "UDINT"
    return "INT" if register.kind.low < 0 else "UINT"
