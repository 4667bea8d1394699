"""What a row of the register map is. Pure; the rows stand in registers, advice and block."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum, auto
from typing import TypeVar

from gateway.core.model import StateVector
from gateway.modbus.registers.words import WireType

Value = float | None
Code = TypeVar("Code", bound=IntEnum)
Names = Mapping[int, tuple[str, str]]


class Of(Enum):
    """What a register's value depends on: the whole state and the time, one part of the state alone, or nothing."""

    STATE = auto()
    RANGE = auto()
    PLC = auto()
    NOTHING = auto()


@dataclass(frozen=True, slots=True)
class Register:
    """One row. `read` gives the value in `unit` from (state, unix_ns); None: no value. `scale`: unit per count.

    `of`: as long as that part of the state is the same record, so is the value, and it is not encoded again.
    """

    address: int
    name: str
    kind: WireType
    scale: float
    unit: str
    meaning: str
    read: Callable[[StateVector, int], Value] = field(repr=False)
    codes: Names | None = field(default=None, repr=False)  # value -> (name, meaning)
    bits: Names | None = field(default=None, repr=False)  # bit -> (name, meaning)
    writable: bool = False  # by the PLC, where writes are on
    of: Of = Of.STATE

    @property
    def words(self) -> int:
        return self.kind.words


@dataclass(frozen=True, slots=True)
class Reserved:
    """Addresses kept free; they read 0 until a later map version gives them a meaning."""

    address: int
    words: int
    purpose: str


def named(meanings: Mapping[Code, str]) -> dict[int, tuple[str, str]]:
    """A table of names for a register: number -> (name in small letters, meaning)."""
    return {int(code): (code.name.lower(), meaning) for code, meaning in meanings.items()}
