"""One Modbus request in, one answer out: the complete behaviour of a unit as a pure function of bytes.

A PDU is the function code and its data, without the header of the transport. The order of the checks is the
one of the state diagrams in the Modbus Application Protocol V1.1b3, chapter 6: function code (01), structure and
quantity (03), address range (02), then the work itself (04, or the result of `Unit.write`).

Nothing here waits, and the image is taken once per request: an answer can't be torn. FC 23 writes first and takes the
image afterwards, so that it reads what it wrote.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

from gateway.certs.validity import Validity
from gateway.modbus.protocol import identity
from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.registers.bits import bits_of, masked
from gateway.modbus.registers.register_map import STATUS, STATUS_ADDRESS

MAX_READ_BITS = 2000
MAX_READ_WORDS = 125
MAX_WRITE_BITS = 1968
MAX_WRITE_WORDS = 123
MAX_READ_WRITE_WORDS = 121  # what FC 23 may write
COIL_VALUES = {0x0000: 0, 0xFF00: 1}  # what FC 5 may write
READ_DEVICE_IDENTIFICATION = 14  # MEI type of FC 43; 13 (CANopen) is not supported
MAY_NOT_WRITE = "it may not write (modbus.plc_addresses or, over TLS, modbus.tls.write_roles define who may)"
NOT_DECIDING = STATUS.mask("gateway_fault", "shutdown")


class Access(IntEnum):
    """What a peer may do. Ordered: each includes the one before."""

    NONE = 0
    READ = 1
    WRITE = 2


@dataclass(frozen=True, slots=True)
class Peer:
    """Who sent the request. Plain TCP gives an address and no role; Modbus/TCP Security has the role of the
    certificate."""

    address: str
    access: Access = Access.WRITE
    role: str | None = None
    subject: str = ""  # of the certificate, for the audit
    certificate: Validity | None = None
    connection: int = 0  # its number; 0: not known


ReadImage = Callable[[], Sequence[int]]
"""The current image of a unit, words 0..65535. Called for every request, on the event loop; returns at once."""


class Write(Protocol):
    """Takes over all of the words or none, and of each only the bits in `mask`. None: done; else why not, 02 for an
    address that is read only, 03 for a value out of its range. Called on the event loop, returns at once."""

    def __call__(
        self, address: int, words: Sequence[int], peer: Peer, mask: int = 0xFFFF
    ) -> ModbusException | None: ...


@dataclass(frozen=True, slots=True)
class Unit:
    """One bay as a Modbus server sees it. `write` None: writes are off, their function codes do not exist (01)."""

    read: ReadImage
    write: Write | None = None
    identity: Mapping[int, bytes] = field(default_factory=identity.objects)  # FC 43/14, by object id
    refused: Callable[[Peer, str], None] = lambda peer, why: None  # called for writes that the peer may not make
    # Called for each connection of a writer: whether it has one now, and the number of the one that has ended, or 0.
    connection: Callable[[Peer, bool, int], None] = lambda peer, here, ended: None
    words: int | None = None  # of each image; None: it must be read to know


class ExceptionResponseError(Exception):
    """Carries the exception code of a request that is not granted from where it is found out to `answer`."""

    def __init__(self, code: ModbusException) -> None:
        super().__init__(code.name)
        self.code = code


def answer(unit: Unit, pdu: bytes, peer: Peer) -> bytes:
    """The PDU that answers `pdu`, which has at least its function code: a result or an exception.

    Raises all that `unit.read` or `unit.write` raise; the caller answers that with `exception(pdu[0], 04)`.
    """
    try:
        function = FUNCTIONS.get(pdu[0])
        if function is None or peer.access < function.access or (function.writes and unit.write is None):
            if function is not None and function.writes:
                unit.refused(peer, "writes are off" if unit.write is None else MAY_NOT_WRITE)
            raise ExceptionResponseError(ModbusException.ILLEGAL_FUNCTION)
        return function.work(unit, pdu, peer)
    except ExceptionResponseError as refused:
        return exception(pdu[0], refused.code)


def exception(function_code: int, code: ModbusException) -> bytes:
    """The two bytes of an exception. A function code beyond 127 has its bit set already."""
    return bytes((function_code | 0x80, code))


def _read_bits(unit: Unit, pdu: bytes, _: Peer) -> bytes:
    address, count = _fields(">HH", pdu)
    _check(1 <= count <= MAX_READ_BITS, ModbusException.ILLEGAL_VALUE)
    total, bits = bits_of(unit.read())
    _check(address + count <= total, ModbusException.ILLEGAL_ADDRESS)
    size = (count + 7) // 8
    return bytes((pdu[0], size)) + (bits >> address & (1 << count) - 1).to_bytes(size, "little")


def _read_words(unit: Unit, pdu: bytes, _: Peer) -> bytes:
    address, count = _fields(">HH", pdu)
    _check(1 <= count <= MAX_READ_WORDS, ModbusException.ILLEGAL_VALUE)
    return _words(unit, pdu[0], address, count)


def _write_one(unit: Unit, pdu: bytes, peer: Peer) -> bytes:
    address, word = _fields(">HH", pdu)
    _write(unit, address, (word,), peer)
    return pdu


def _write_words(unit: Unit, pdu: bytes, peer: Peer) -> bytes:
    address, count, words = _words_in(pdu, 1, MAX_WRITE_WORDS)
    _write(unit, address, words, peer)
    return pdu[:1] + struct.pack(">HH", address, count)


def _write_coil(unit: Unit, pdu: bytes, peer: Peer) -> bytes:
    address, value = _fields(">HH", pdu)
    _check(value in COIL_VALUES, ModbusException.ILLEGAL_VALUE)
    _write_bits(unit, address, 1, COIL_VALUES[value], peer)
    return pdu


def _write_coils(unit: Unit, pdu: bytes, peer: Peer) -> bytes:
    _check(len(pdu) >= 6, ModbusException.ILLEGAL_VALUE)
    address, count, size = struct.unpack_from(">HHB", pdu, 1)
    valid = 1 <= count <= MAX_WRITE_BITS and size == (count + 7) // 8 and len(pdu) == 6 + size
    _check(valid, ModbusException.ILLEGAL_VALUE)
    _write_bits(unit, address, count, int.from_bytes(pdu[6:], "little"), peer)
    return pdu[:5]


def _mask_write(unit: Unit, pdu: bytes, peer: Peer) -> bytes:
    """The register becomes (it AND and_mask) OR (or_mask AND NOT and_mask): what and_mask lacks is written."""
    address, and_mask, or_mask = _fields(">HHH", pdu)
    _write(unit, address, (or_mask & ~and_mask,), peer, ~and_mask & 0xFFFF)
    return pdu


def _read_write(unit: Unit, pdu: bytes, peer: Peer) -> bytes:
    _check(len(pdu) >= 10, ModbusException.ILLEGAL_VALUE)
    address, count = struct.unpack(">HH", pdu[1:5])
    _check(1 <= count <= MAX_READ_WORDS, ModbusException.ILLEGAL_VALUE)
    write_address, _, words = _words_in(pdu, 5, MAX_READ_WRITE_WORDS)
    _check(address + count <= _size(unit), ModbusException.ILLEGAL_ADDRESS)  # nothing is written if it can't be read
    _write(unit, write_address, words, peer)
    return _words(unit, pdu[0], address, count)


def _report_id(unit: Unit, pdu: bytes, _: Peer) -> bytes:
    _check(len(pdu) == 1, ModbusException.ILLEGAL_VALUE)
    return pdu + identity.report(unit.identity, running=not unit.read()[STATUS_ADDRESS] & NOT_DECIDING)


def _encapsulated(unit: Unit, pdu: bytes, _: Peer) -> bytes:
    _check(len(pdu) >= 2, ModbusException.ILLEGAL_VALUE)
    _check(pdu[1] == READ_DEVICE_IDENTIFICATION, ModbusException.ILLEGAL_FUNCTION)
    _check(len(pdu) == 4, ModbusException.ILLEGAL_VALUE)
    found = identity.answer(unit.identity, pdu[2], pdu[3])
    if isinstance(found, ModbusException):
        raise ExceptionResponseError(found)
    return pdu[:2] + found


@dataclass(frozen=True, slots=True)
class Function:
    """One function code this server has."""

    code: int
    name: str
    work: Callable[[Unit, bytes, Peer], bytes] = field(repr=False)
    writes: bool = False

    @property
    def access(self) -> Access:
        return Access.WRITE if self.writes else Access.READ


FUNCTIONS: dict[int, Function] = {
    function.code: function
    for function in (
        Function(1, "read coils", _read_bits),
        Function(2, "read discrete inputs", _read_bits),
        Function(3, "read holding registers", _read_words),
        Function(4, "read input registers", _read_words),
        Function(5, "write single coil", _write_coil, writes=True),
        Function(6, "write single register", _write_one, writes=True),
        Function(15, "write multiple coils", _write_coils, writes=True),
        Function(16, "write multiple registers", _write_words, writes=True),
        Function(17, "report server id", _report_id),
        Function(22, "mask write register", _mask_write, writes=True),
        Function(23, "read and write multiple registers", _read_write, writes=True),
        Function(43, "read device identification (MEI type 14)", _encapsulated),
    )
}


def _check(valid: bool, otherwise: ModbusException) -> None:
    if not valid:
        raise ExceptionResponseError(otherwise)


def _fields(layout: str, pdu: bytes) -> tuple[int, ...]:
    """The numbers after the function code. A PDU of another length is 03: its structure is wrong."""
    _check(len(pdu) == 1 + struct.calcsize(layout), ModbusException.ILLEGAL_VALUE)
    return struct.unpack_from(layout, pdu, 1)


def _words_in(pdu: bytes, start: int, most: int) -> tuple[int, int, tuple[int, ...]]:
    """Address, count and the words of `address, count, byte count, words` from `start` to the end of the PDU."""
    _check(len(pdu) >= start + 5, ModbusException.ILLEGAL_VALUE)
    address, count, size = struct.unpack_from(">HHB", pdu, start)
    valid = 1 <= count <= most and size == 2 * count and len(pdu) == start + 5 + size
    _check(valid, ModbusException.ILLEGAL_VALUE)
    return address, count, struct.unpack_from(f">{count}H", pdu, start + 5)


def _words(unit: Unit, function_code: int, address: int, count: int) -> bytes:
    """One slice of one image. Raises struct.error for an image with anything but words in it."""
    image = unit.read()
    _check(address + count <= len(image), ModbusException.ILLEGAL_ADDRESS)
    return struct.pack(f">BB{count}H", function_code, 2 * count, *image[address : address + count])


def _size(unit: Unit) -> int:
    """How many registers there are. A write makes another image: the one before it need not be encoded for this."""
    return len(unit.read()) if unit.words is None else unit.words


def _write_bits(unit: Unit, address: int, count: int, bits: int, peer: Peer) -> None:
    found = masked(address, count, bits)
    if found is None:
        unit.refused(peer, f"coils {address} to {address + count - 1} are not of one register")
        raise ExceptionResponseError(ModbusException.ILLEGAL_ADDRESS)
    register, word, mask = found
    _write(unit, register, (word,), peer, mask)


def _write(unit: Unit, address: int, words: Sequence[int], peer: Peer, mask: int = 0xFFFF) -> None:
    assert unit.write is not None  # `answer` has checked it
    _check(address + len(words) <= _size(unit), ModbusException.ILLEGAL_ADDRESS)
    if (refusal := unit.write(address, words, peer, mask)) is not None:
        raise ExceptionResponseError(refusal)
