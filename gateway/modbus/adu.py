"""Modbus/TCP framing, sans IO: bytes in, whole frames out, on whatever boundaries the bytes come. Pure.

A frame (ADU) is the MBAP header and a PDU: transaction id, protocol id (0 is Modbus), length of what follows (unit id
and PDU), unit id; all in network order. MODBUS Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3 and 4.4.2.

What is wrong with a frame is told, never raised:

- another protocol id: the frame is discarded without an answer, as the guide says. Its length still tells where the
  next one begins.
- a length that no frame can have: where the next frame begins can't be known any more, so the connection must end.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

HEADER = struct.Struct(">HHHB")
HEADER_BYTES = HEADER.size  # 7
MAX_PDU_BYTES = 253
MAX_FRAME_BYTES = HEADER_BYTES + MAX_PDU_BYTES  # 260
MIN_LENGTH, MAX_LENGTH = 2, 1 + MAX_PDU_BYTES  # of the length field: at least a unit id and a function code


class Fault(Enum):
    """Why a frame has no PDU."""

    BAD_PROTOCOL = "another protocol id than 0"
    BAD_LENGTH = "a length outside of 2 to 254"


@dataclass(frozen=True, slots=True)
class Frame:
    transaction: int
    unit: int
    pdu: bytes


class Framer:
    """The byte stream of one connection. Holds at most one frame that is not whole, and what was fed behind it."""

    def __init__(self) -> None:
        self._held = b""

    @property
    def held(self) -> int:
        """Bytes of a frame that has begun and is not whole."""
        return len(self._held)

    def feed(self, data: bytes) -> Iterator[Frame | Fault]:
        """Every frame that is now whole, and every fault, in order; the rest is kept. Nothing follows BAD_LENGTH.

        To be run through to its end, or the bytes that were not looked at are fed again with the next ones.
        """
        self._held += data
        while len(self._held) >= 6:  # up to the length: what is wrong so far shows without waiting for more
            transaction, protocol, length = struct.unpack_from(">HHH", self._held)
            if not MIN_LENGTH <= length <= MAX_LENGTH:
                self._held = b""
                yield Fault.BAD_LENGTH
                return
            end = 6 + length
            if len(self._held) < end:
                return
            frame, self._held = self._held[:end], self._held[end:]
            if protocol != 0:
                yield Fault.BAD_PROTOCOL
            else:
                yield Frame(transaction, frame[6], frame[7:])


def frame_bytes(transaction: int, unit: int, pdu: bytes) -> bytes:
    """The bytes of one frame."""
    return HEADER.pack(transaction, 0, 1 + len(pdu), unit) + pdu
