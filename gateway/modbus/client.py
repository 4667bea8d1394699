"""Holding registers read as a PLC reads them: for the gateway's checks of its own port. IO."""

import socket
import struct

from gateway.errors import ProtocolError
from gateway.modbus.protocol.adu import HEADER_BYTES, FrameFault, Framer, frame_bytes

ANSWER_S = 3.0  # for connecting, and for each piece of an answer
READ_HOLDING_REGISTERS = 0x03
_RECEIVE_BYTES = 512


def connect(host: str, port: int) -> socket.socket:
    """Raises OSError."""
    return socket.create_connection((host, port), ANSWER_S)


def holding_registers(sock: socket.socket, unit_id: int, count: int) -> tuple[int, ...]:
    """The first `count` of a unit. Raises OSError, also where the connection ends; ProtocolError for other answers."""
    sock.sendall(frame_bytes(1, unit_id, struct.pack(">BHH", READ_HOLDING_REGISTERS, 0, count)))
    framer = Framer()
    while (frame := framer.next()) is None:
        received = sock.recv(_RECEIVE_BYTES)
        if not received:
            raise ConnectionResetError(104, "it closed the connection")
        framer.feed(received)
    if isinstance(frame, FrameFault):
        raise ProtocolError(f"it answers with {frame.value}")
    pdu = frame[HEADER_BYTES:]
    if pdu[0] == READ_HOLDING_REGISTERS | 0x80 and len(pdu) == 2:
        raise ProtocolError(f"it answers with exception {pdu[1]:02X}")
    if pdu[:2] != bytes([READ_HOLDING_REGISTERS, 2 * count]) or len(pdu) != 2 + 2 * count:
        raise ProtocolError(f"it answers with {len(pdu)} bytes: {pdu[:16].hex(' ')}")
    return struct.unpack(f">{count}H", pdu[2:])
