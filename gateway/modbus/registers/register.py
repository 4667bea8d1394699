"""What a register is: its row of the map, its type on the wire, and how its value becomes 16-bit words and back. Pure.

Bytes inside a word are always big-endian (Modbus Application Protocol V1.1b3, 4.2); the order of the words of a longer
value is not standardised, hence the choice. Nothing wraps by accident: a value too large for its register is
the register's limit, a value that does not exist is the type's sentinel, and neither can be mistaken for the other.
"""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Literal, TypeVar

from gateway.core.state import StateVector
from gateway.explained import ExplainedInt
from gateway.values.bay_values import BAY_VALUES

WordOrder = Literal["big", "little"]
"""`big`: the high word has the lowest address. `little`: the low word has it."""

Value = float | None
Part = TypeVar("Part")
Names = Mapping[int, tuple[str, str]]
Packed = tuple[tuple[int, ...], bool]

WRAPS = "count since the start of the gateway, modulo 65536"
_FLOAT32_MAX = 3.4028234663852886e38
_FLOAT32_NAN = 0x7FC0_0000
_FLOAT = struct.Struct(">f")
_UNSIGNED = {1: ">H", 2: ">I", 4: ">Q"}  # by the number of words


@dataclass(frozen=True, slots=True)
class WireType:
    """A type on the wire. Integers span `low`..`high`; `no_value` lies outside of that (None: always has a value)."""

    name: str
    words: int
    low: int = 0
    high: int = 0
    no_value: int | None = None
    is_float: bool = False

    @property
    def sentinel(self) -> int:
        """`no_value` of an integer as the number that a client reads; 0 in a type that always has a value."""
        word = self.no_value or 0
        return word - 0x1_0000 if self.low < 0 else word


# A plain type always has a value and uses all its bits; a measured uint16 gives up 0xFFFF as its sentinel.
UINT16 = WireType("uint16", 1, 0, 0xFFFF)
INT16 = WireType("int16", 1, -0x8000, 0x7FFF)
UINT32 = WireType("uint32", 2, 0, 0xFFFF_FFFF)
UINT64 = WireType("uint64", 4, 0, 0xFFFF_FFFF_FFFF_FFFF)
MEASURED_UINT16 = WireType("uint16", 1, 0, 0xFFFE, no_value=0xFFFF)
MEASURED_INT16 = WireType("int16", 1, -0x7FFF, 0x7FFF, no_value=0x8000)
FLOAT32 = WireType("float32", 2, is_float=True)
MEASURED_FLOAT32 = WireType("float32", 2, no_value=_FLOAT32_NAN, is_float=True)


@dataclass(frozen=True, slots=True)
class Register:
    """One row. `read` gives the value in `unit` from (state, unix_ns); None: no value. `scale`: unit per count."""

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

    @property
    def words(self) -> int:
        return self.kind.words


@dataclass(frozen=True, slots=True)
class Reserved:
    """Addresses kept free; they read 0 until a later map version gives them a meaning."""

    address: int
    words: int
    purpose: str


def part(find: Callable[[StateVector], Part | None], name: str) -> Callable[[StateVector, int], Value]:
    """For `Register.read`: attribute `name` of the record that `find` gives; no value where it gives None."""
    read = attrgetter(name)
    return lambda state, _: None if (found := find(state)) is None else read(found)


def shown(
    address: int, name: str, kind: WireType, scale: float, value: str, meaning: str = "", *, codes: Names | None = None,
    bits: Names | None = None,
) -> Register:  # fmt: skip
    """A register that holds a value of the table: a share in %, a counter of a plain type modulo its size.

    `meaning`: where a PLC needs other words than the table's.
    """
    row = BAY_VALUES[value]
    words = f"{row.meaning}: {WRAPS}" if value.startswith("counters.") else row.meaning
    share = row.kind is float and not row.unit and not kind.is_float
    counter = row.kind is int and kind.no_value is None

    def read(state: StateVector, _: int) -> Value:
        found: Value = row.of(state)
        if counter:
            return int(found or 0) & kind.high
        return 100.0 * found if share and found is not None else found

    return Register(address, name, kind, scale, "%" if share else row.unit, meaning or words, read, codes, bits)


def named(codes: type[ExplainedInt]) -> dict[int, tuple[str, str]]:
    """A table of names for a register: number -> (name in small letters, meaning)."""
    return {int(code): (code.name.lower(), code.meaning) for code in codes}


@dataclass(frozen=True, slots=True)
class StatusWord:
    """A register of one bit each: (name, meaning, when it is on), from bit 0. Never reorder, only append."""

    rows: tuple[tuple[str, str, Callable[[StateVector], bool]], ...]

    @property
    def names(self) -> Names:
        """For `Register.bits`."""
        return {bit: (name, meaning) for bit, (name, meaning, _) in enumerate(self.rows)}

    def read(self, state: StateVector, _: int) -> Value:
        """For `Register.read`."""
        return sum(on(state) << bit for bit, (_, _, on) in enumerate(self.rows))

    def mask(self, *names: str) -> int:
        """The bits of these names. Raises ValueError for an unknown one."""
        known = {name: 1 << bit for bit, (name, _, _) in enumerate(self.rows)}
        if unknown := set(names) - known.keys():
            raise ValueError(f"no bit is named {', '.join(sorted(unknown))}")
        return sum(known[name] for name in names)

    def on(self, word: int) -> set[str]:
        """The names of the bits that are on in `word`."""
        return {name for bit, (name, _, _) in enumerate(self.rows) if word >> bit & 1}


def packer(kind: WireType, scale: float, order: WordOrder) -> Callable[[float | None], Packed]:
    """A function from a value (in its unit; the register counts in `scale`) to its words and whether it was limited.

    None and any number that is not finite is "no value": the sentinel, or 0 in a type without one. Never raises on a
    number.
    """
    number, layout = struct.Struct(_UNSIGNED[kind.words]), struct.Struct(f">{kind.words}H")
    low, high, one_word, swapped = kind.low, kind.high, kind.words == 1, order == "little"

    def words(data: bytes) -> tuple[int, ...]:
        return layout.unpack(data)[::-1] if swapped else layout.unpack(data)

    nothing = words(number.pack(kind.no_value or 0)), False

    def float32(value: float | None) -> Packed:
        if value is None or not -math.inf < value < math.inf:  # false for NaN too
            return nothing
        return words(_FLOAT.pack(min(max(value, -_FLOAT32_MAX), _FLOAT32_MAX))), False

    def integer(value: float | None) -> Packed:
        if value is None or not -math.inf < value < math.inf:
            return nothing
        try:
            raw = value if scale == 1 and isinstance(value, int) else round(value / scale)
        except OverflowError:  # beyond any float, and so beyond any register
            raw = high + 1 if value > 0 else low - 1
        fitting = raw if low <= raw <= high else min(max(raw, low), high)
        return (fitting & 0xFFFF,) if one_word else words(number.pack(fitting)), fitting != raw

    return float32 if kind.is_float else integer


def unpack(kind: WireType, words: Sequence[int], scale: float, order: WordOrder) -> float | None:
    """The value behind `words`, in its unit; None where they hold the sentinel. An int where the scale is 1."""
    raw = 0
    for word in words if order == "big" else reversed(words):
        raw = raw << 16 | word
    if kind.is_float:
        number = float(struct.unpack(">f", raw.to_bytes(4, "big"))[0])
        return None if math.isnan(number) else number
    if raw == kind.no_value:
        return None
    if raw > kind.high:  # a negative one
        raw -= 0x1_0000
    return round(raw * scale, 9)
