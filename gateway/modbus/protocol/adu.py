"""Modbus/TCP framing, sans IO: bytes in, complete frames out, however the bytes arrive; and the exception codes. Pure.

A frame (ADU) is the MBAP header and a PDU: transaction id, protocol id (0 is Modbus), length of what follows (unit id
and PDU), unit id; all in network order. MODBUS Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3 and 4.4.2.

Faults of a frame are reported, never raised:

- another protocol id: the frame is discarded without an answer, as in the guide. Its length still gives the start of
  the next one.
- a length that no frame can have: the start of the next frame is unknown, so the connection must end.
"""

import struct
from enum import Enum, IntEnum

HEADER = struct.Struct(">HHHB")
HEADER_BYTES = HEADER.size  # 7
_PROTOCOL_AND_LENGTH = struct.Struct(">HH")
MAX_PDU_BYTES = 253
MAX_FRAME_BYTES = HEADER_BYTES + MAX_PDU_BYTES  # 260
MIN_LENGTH, MAX_LENGTH = 2, 1 + MAX_PDU_BYTES  # of the length field: at least a unit id and a function code


class FrameFault(Enum):
    """Why a frame has no PDU."""

    BAD_PROTOCOL = "another protocol id than 0"
    BAD_LENGTH = "a length outside of 2 to 254"


class ModbusException(IntEnum):
    """The second byte of an exception answer: Modbus Application Protocol V1.1b3, chapter 7, as far as it is used."""

    ILLEGAL_FUNCTION = 0x01
    ILLEGAL_ADDRESS = 0x02
    ILLEGAL_VALUE = 0x03
    DEVICE_FAILURE = 0x04
    SERVER_BUSY = 0x06
    TARGET_FAILED_TO_RESPOND = 0x0B


EXCEPTION_MEANING: dict[ModbusException, str] = {
    ModbusException.ILLEGAL_FUNCTION: "a function code (or MEI type of FC 43) that this server does not have, writes "
    "where they are off, and all that the peer's address or role does not allow",
    ModbusException.ILLEGAL_ADDRESS: "part of the request lies beyond the last register or bit, is written "
    "although it is read only, or is an object id that does not exist",
    ModbusException.ILLEGAL_VALUE: "a count of 0 or more than fits, a request that is shorter or longer than its own "
    "numbers say, a value out of its range, a control bit that has no meaning, or an unknown kind of identification",
    ModbusException.DEVICE_FAILURE: "the gateway could not make an image; its log has the reason",
    ModbusException.SERVER_BUSY: "a write to the handshake registers while another PLC owns them; nothing was written",
    ModbusException.TARGET_FAILED_TO_RESPOND: "no bay has this unit id, or something is written under unit id 0",
}


class Framer:
    """The byte stream of one connection: `feed` the bytes received, take `next` until it returns None."""

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

    def next(self) -> bytes | FrameFault | None:
        """The next complete frame with its header, or its fault; None: it is not complete yet.

        After BAD_LENGTH all bytes are dropped, and the connection must end.
        """
        if self.held < 6:  # up to the length: what is wrong so far shows without waiting for more
            return None
        protocol, length = _PROTOCOL_AND_LENGTH.unpack_from(self._bytes, self._at + 2)
        if not MIN_LENGTH <= length <= MAX_LENGTH:
            self._bytes, self._at = b"", 0
            return FrameFault.BAD_LENGTH
        end = self._at + 6 + length
        if len(self._bytes) < end:
            return None
        frame, self._at = self._bytes[self._at : end], end
        return FrameFault.BAD_PROTOCOL if protocol != 0 else frame

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
