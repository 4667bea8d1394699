"""What a register is: its row of the map, its type on the wire, and how its value becomes 16-bit words and back. Pure.

Bytes inside a word are always big-endian (Modbus Application Protocol V1.1b3, 4.2); the order of the words of a longer
value is not standardised, hence the choice. Nothing wraps by accident: a value too large for its register is
the register's limit, a value that does not exist is the type's sentinel, and neither can be mistaken for the other.
"""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from operator import attrgetter
from typing import Literal, TypeVar

from gateway.core.state import StateVector

WordOrder = Literal["big", "little"]
"""`big`: the high word has the lowest address. `little`: the low word has it."""

Value = float | None
Code = TypeVar("Code", bound=IntEnum)
Part = TypeVar("Part")
Names = Mapping[int, tuple[str, str]]

_FLOAT32_MAX = 3.4028234663852886e38
_FLOAT32_NAN = 0x7FC0_0000
_ONE_FLOAT, _TWO_WORDS = struct.Struct(">f"), struct.Struct(">HH")
_INTEGERS = {2: (struct.Struct(">I"), _TWO_WORDS), 4: (struct.Struct(">Q"), struct.Struct(">HHHH"))}
_WITHIN = 1e9  # no one-word register extends so far at any scale
_BEYOND = 1e30  # larger than any register at any scale, small enough to be divided by one


@dataclass(frozen=True, slots=True)
class WireType:
    """A type on the wire. Integers span `low`..`high`; `no_value` lies outside of that (None: always has a value)."""

    name: str
    words: int
    low: int = 0
    high: int = 0
    no_value: int | None = None
    is_float: bool = False


# A plain uint16 is a code or a counter and uses all its bits; a measured one gives up 0xFFFF as its sentinel.
UINT16 = WireType("uint16", 1, 0, 0xFFFF)
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


def percent(find: Callable[[StateVector], Part | None], name: str) -> Callable[[StateVector, int], Value]:
    """As `part`, of a share from 0 to 1."""
    read = part(find, name)
    return lambda state, unix_ns: None if (share := read(state, unix_ns)) is None else 100.0 * share


def named(meanings: Mapping[Code, str]) -> dict[int, tuple[str, str]]:
    """A table of names for a register: number -> (name in small letters, meaning)."""
    return {int(code): (code.name.lower(), meaning) for code, meaning in meanings.items()}


def pack(kind: WireType, value: float | None, scale: float, order: WordOrder) -> tuple[tuple[int, ...], bool]:
    """The words of `value` (in its unit; the register counts in `scale`), and whether it had to be limited.

    None and any number that is not finite is "no value": the sentinel, or 0 in a type without one. Never raises on a
    number.
    """
    raw = _float_bits(value) if kind.is_float else _counts(value, scale)
    if raw is None:
        return _split(kind.no_value or 0, kind.words, order), False
    if kind.is_float:
        return _split(raw, kind.words, order), False
    fitting = min(max(raw, kind.low), kind.high)
    return _split(fitting & _mask(kind), kind.words, order), fitting != raw


Packed = tuple[tuple[int, ...], bool]


def packer(kind: WireType, scale: float, order: WordOrder) -> Callable[[float | None], Packed]:
    """`pack` with all but the value known beforehand: an image of a hundred of them is made at every state."""
    nothing = pack(kind, None, scale, order)
    low, high, high_first = kind.low, kind.high, order == "big"

    def float32(value: float | None) -> Packed:
        if value is None:
            return nothing
        if not -_FLOAT32_MAX <= value <= _FLOAT32_MAX:
            return pack(kind, value, scale, order)
        first, second = _TWO_WORDS.unpack(_ONE_FLOAT.pack(value))
        return ((first, second) if high_first else (second, first)), False

    def one_word(value: int | float | None) -> Packed:
        if value is None:
            return nothing
        if -_WITHIN < value < _WITHIN:  # false for NaN
            raw = value if scale == 1 and isinstance(value, int) else round(value / scale)
            if low <= raw <= high:
                return (raw & 0xFFFF,), False
        return pack(kind, value, scale, order)

    long, parts = _INTEGERS.get(kind.words, (_ONE_FLOAT, _TWO_WORDS))

    def whole_words(value: int | float | None) -> Packed:
        if isinstance(value, int) and scale == 1 and 0 <= low <= value <= high:
            words = parts.unpack(long.pack(value))
            return (words if high_first else words[::-1]), False
        return pack(kind, value, scale, order)

    if kind.is_float:
        return float32
    return one_word if kind.words == 1 else whole_words


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
    if kind.low < 0 and raw > kind.high:
        raw -= _mask(kind) + 1
    return raw if scale == 1 else round(raw * scale, 9)


def _counts(value: float | None, scale: float) -> int | None:
    """Integer register counts, rounded to the nearest; may be far outside of any register."""
    if value is None or not -math.inf < value < math.inf:  # false for NaN too
        return None
    if isinstance(value, int) and scale == 1:
        return value
    scaled = min(max(value, -_BEYOND), _BEYOND) / scale
    return round(scaled)


def _float_bits(value: float | None) -> int | None:
    """The bits of the nearest finite float32; None for what is no number."""
    if value is None or not -math.inf < value < math.inf:
        return None
    return int.from_bytes(struct.pack(">f", min(max(value, -_FLOAT32_MAX), _FLOAT32_MAX)), "big")


def _mask(kind: WireType) -> int:
    return (1 << 16 * kind.words) - 1


def _split(raw: int, words: int, order: WordOrder) -> tuple[int, ...]:
    high_first = tuple(raw >> 16 * place & 0xFFFF for place in reversed(range(words)))
    return high_first if order == "big" else high_first[::-1]
