"""Modbus/TCP framing, sans IO: bytes in, complete frames out, on whatever boundaries the bytes arrive. Pure.

A frame (ADU) is the MBAP header and a PDU: transaction id, protocol id (0 is Modbus), length of what follows (unit id
and PDU), unit id; all in network order. MODBUS Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3 and 4.4.2.

What is wrong with a frame is reported, never raised:

- another protocol id: the frame is discarded without an answer, as the guide says. Its length still tells where the
  next one begins.
- a length that no frame can have: where the next frame begins can't be known any more, so the connection must end.
"""

import struct
from enum import Enum

HEADER = struct.Struct(">HHHB")
HEADER_BYTES = HEADER.size  # 7
_PROTOCOL_AND_LENGTH = struct.Struct(">HH")
MAX_PDU_BYTES = 253
MAX_FRAME_BYTES = HEADER_BYTES + MAX_PDU_BYTES  # 260
MIN_LENGTH, MAX_LENGTH = 2, 1 + MAX_PDU_BYTES  # of the length field: at least a unit id and a function code


class Fault(Enum):
    """Why a frame has no PDU."""

    BAD_PROTOCOL = "another protocol id than 0"
    BAD_LENGTH = "a length outside of 2 to 254"


class Framer:
    """The byte stream of one connection: `feed` what comes, take `next` until it gives None."""

    def __init__(self) -> None:
        self._bytes = b""
        self._at = 0

    @property
    def held(self) -> int:
        """Bytes fed and not yet taken."""
        return len(self._bytes) - self._at

    def feed(self, data: bytes) -> None:
        self._bytes = self._bytes[self._at :] + data
        self._at = 0

    def next(self) -> bytes | Fault | None:
        """The next complete frame with its header, or what is wrong with it; None: it is not complete yet.

        After BAD_LENGTH all that was fed is gone, and the connection must end.
        """
        if self.held < 6:  # up to the length: what is wrong so far shows without waiting for more
            return None
        protocol, length = _PROTOCOL_AND_LENGTH.unpack_from(self._bytes, self._at + 2)
        if not MIN_LENGTH <= length <= MAX_LENGTH:
            self._bytes, self._at = b"", 0
            return Fault.BAD_LENGTH
        end = self._at + 6 + length
        if len(self._bytes) < end:
            return None
        frame, self._at = self._bytes[self._at : end], end
        return Fault.BAD_PROTOCOL if protocol != 0 else frame

    @property
    def complete(self) -> bool:
        """Does `next` have something to give?"""
        if self.held < 6:
            return False
        _, length = _PROTOCOL_AND_LENGTH.unpack_from(self._bytes, self._at + 2)
        return not MIN_LENGTH <= length <= MAX_LENGTH or self.held >= 6 + length


def frame_bytes(transaction: int, unit: int, pdu: bytes) -> bytes:
    """The bytes of one frame."""
    return HEADER.pack(transaction, 0, 1 + len(pdu), unit) + pdu
