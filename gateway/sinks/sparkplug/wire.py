"""Sparkplug B payloads: the part of the specification's Protocol Buffers schema that an edge node needs. Pure.

Sparkplug Specification 3.0.0, section 6.4.1. In the tests code that the Protocol Buffers compiler made from the schema
decodes what is encoded here, and encodes what is read here.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

Value = bool | int | float | str | None


class DataType(IntEnum):
    """Section 6.4.16; the ones in use.

    None is unsigned: the schema gives UInt32 the field `long_value`, and some decoders read `int_value`.
    """

    INT32 = 3
    INT64 = 4
    DOUBLE = 10
    BOOLEAN = 11
    STRING = 12
    DATETIME = 13  # Unix, ms


class QualityCode(IntEnum):
    """Section 6.4.7.1: the property `Quality`; absent means GOOD."""

    BAD = 0
    GOOD = 192
    STALE = 500


@dataclass(frozen=True, slots=True)
class Metric:
    """One value with its time (Unix, ms). `value` None: null. `unit` is sent as the property `engUnit`."""

    name: str
    timestamp_ms: int
    datatype: DataType
    value: Value
    historical: bool = False
    quality: QualityCode = QualityCode.GOOD
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Payload:
    """`seq` None: none, as in NDEATH."""

    timestamp_ms: int
    metrics: tuple[Metric, ...] = ()
    seq: int | None = None


class WireError(ValueError):
    """Not a Sparkplug B payload."""


_VARINT, _FIXED64, _BYTES = 0, 1, 2
_METRIC = 2  # field of Payload
_INT, _LONG, _DOUBLE, _BOOL, _STRING = 10, 11, 13, 14, 15  # fields of Metric.value


# Out.


def encode(payload: Payload, *, typed: bool = True) -> bytes:
    """The bytes on the wire. Not `typed`: without datatypes, for data whose birth has them."""
    out = bytearray(_number(1, payload.timestamp_ms))
    for metric in payload.metrics:
        out += _block(_METRIC, _metric(metric, typed=typed))
    if payload.seq is not None:
        out += _number(3, payload.seq)
    return bytes(out)


def _metric(metric: Metric, *, typed: bool) -> bytes:
    out = bytearray(_block(1, metric.name.encode()))
    out += _number(3, metric.timestamp_ms)
    if typed:
        out += _number(4, metric.datatype)
    if metric.historical:
        out += _number(5, 1)
    if metric.value is None:
        out += _number(7, 1)
    if metric.quality is not QualityCode.GOOD or metric.unit:
        out += _block(9, _properties(metric))
    if metric.value is not None:
        out += _value(metric.datatype, metric.value)
    return bytes(out)


def _properties(metric: Metric) -> bytes:
    keys, values = b"", b""
    if metric.quality is not QualityCode.GOOD:
        keys += _block(1, b"Quality")
        values += _block(2, _number(1, DataType.INT32) + _number(3, metric.quality))
    if metric.unit:
        keys += _block(1, b"engUnit")
        values += _block(2, _number(1, DataType.STRING) + _block(8, metric.unit.encode()))
    return keys + values


def _value(datatype: DataType, value: bool | int | float | str) -> bytes:
    match datatype:
        case DataType.BOOLEAN:
            return _number(_BOOL, bool(value))
        case DataType.DOUBLE:
            return _key(_DOUBLE, _FIXED64) + struct.pack("<d", value)
        case DataType.STRING:
            return _block(_STRING, str(value).encode())
        case DataType.INT64 | DataType.DATETIME:
            return _number(_LONG, int(value) & 0xFFFF_FFFF_FFFF_FFFF)  # negative ones as their two's complement
        case DataType.INT32:
            return _number(_INT, int(value) & 0xFFFF_FFFF)
    raise ValueError(f"a value needs a datatype: {value!r}")


def _number(field: int, value: int) -> bytes:
    return _key(field, _VARINT) + _varint(value)


def _block(field: int, data: bytes) -> bytes:
    return _key(field, _BYTES) + _varint(len(data)) + data


def _key(field: int, kind: int) -> bytes:
    return _varint(field << 3 | kind)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


# In.


def booleans(data: bytes) -> set[tuple[str, bool]]:
    """Name and value of the Boolean metrics in a payload: what a command here can be. Raises WireError."""
    found: set[tuple[str, bool]] = set()
    for field, metric in _fields(data):
        if field != _METRIC or not isinstance(metric, bytes):
            continue
        name, value = "", None
        for part, content in _fields(metric):
            match part, content:
                case 1, bytes():
                    name = _text(content)
                case 14, int():
                    value = bool(content)
        if value is not None:
            found.add((name, value))
    return found


def _fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Number and raw value of every field; values of fixed length and blocks as bytes."""
    at = 0
    while at < len(data):
        key, at = _read_varint(data, at)
        match key & 7:
            case 0:
                number, at = _read_varint(data, at)
                yield key >> 3, number
                continue
            case 1:
                size = 8
            case 2:
                size, at = _read_varint(data, at)
            case 5:
                size = 4
            case other:
                raise WireError(f"wire type {other}")
        if at + size > len(data):
            raise WireError("cut off")
        yield key >> 3, data[at : at + size]
        at += size


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for n in range(10):
        if at + n >= len(data):
            raise WireError("cut off")
        byte = data[at + n]
        value |= (byte & 0x7F) << 7 * n
        if byte < 0x80:
            return value & 0xFFFF_FFFF_FFFF_FFFF, at + n + 1
    raise WireError("a number of more than ten bytes")


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise WireError("text that is not UTF-8") from error
