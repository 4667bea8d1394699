"""MQTT over a WebSocket (MQTT 5, section 6): a socket that carries a stream of bytes in binary frames. IO, never waits.

paho's own WebSocket waits for the server in the event loop, and keeps whatever a server announces.
"""

import contextlib
import socket
import ssl

from websockets.client import ClientProtocol
from websockets.exceptions import InvalidHandshake
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

READ_BYTES = 65_536
MAX_FRAME_BYTES = 1_048_576


def protocol_of(url: str) -> ClientProtocol:
    """`url`: ws[s]://host:port/path."""
    return ClientProtocol(parse_uri(url), subprotocols=[Subprotocol("mqtt")], max_size=MAX_FRAME_BYTES)


def request(protocol: ClientProtocol) -> bytes:
    """The opening handshake."""
    protocol.send_request(protocol.connect())
    return b"".join(protocol.data_to_send())


def answered(protocol: ClientProtocol, data: bytes) -> bool:
    """Is the handshake complete with this part of the answer? Raises OSError for a refusal."""
    protocol.receive_data(data) if data else protocol.receive_eof()
    protocol.events_received()
    error = protocol.handshake_exc
    if error is not None:
        why = str(error) if isinstance(error, InvalidHandshake) else "no answer of HTTP"
        raise OSError(f"no WebSocket: {why}")
    if protocol.state is State.OPEN and protocol.subprotocol != "mqtt":
        raise OSError("no WebSocket for MQTT: the subprotocol `mqtt` is not offered")
    return protocol.state is State.OPEN


class WebSocket:
    """In place of a socket in paho's client. `sock` is non-blocking, `protocol` open."""

    def __init__(self, sock: socket.socket, protocol: ClientProtocol) -> None:
        self.inner = sock
        self._protocol = protocol
        self._in = bytearray()  # of frames, not fetched yet
        self._out = bytearray()  # frames, not sent yet
        self._promised = 0  # bytes of the message in the last of these, which `send` will be called with again

    def recv(self, size: int) -> bytes:
        """Raises BlockingIOError or ssl.SSLWantReadError where nothing is there, OSError for a violation."""
        while not self._in:
            if self._protocol.state is not State.OPEN:
                if (fault := self._protocol.parser_exc) is not None:
                    raise OSError(f"not a WebSocket's frame: {fault}")
                return b""
            data = self.inner.recv(READ_BYTES)
            if not data:
                return b""
            self._protocol.receive_data(data)
            for event in self._protocol.events_received():
                if isinstance(event, Frame) and event.opcode in (Opcode.BINARY, Opcode.CONT):
                    self._in += event.data
                elif isinstance(event, Frame) and event.opcode is Opcode.TEXT:
                    raise OSError("a text frame: MQTT is binary")
            self._out += b"".join(self._protocol.data_to_send())  # PONG, or the answer to CLOSE
            with contextlib.suppress(BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
                self._flush()
        found = bytes(self._in[:size])
        del self._in[:size]
        return found

    def send(self, data: bytes) -> int:
        """All of it. Raises BlockingIOError where the network takes no more: to be called with the same data again."""
        if not self._promised:
            if self._protocol.state is not State.OPEN:
                raise ConnectionResetError("the WebSocket is closed")
            self._protocol.send_binary(data)
            self._out += b"".join(self._protocol.data_to_send())
            self._promised = len(data)
        self._flush()
        sent, self._promised = self._promised, 0
        return sent

    def pending(self) -> int:
        """Bytes that can be fetched although the socket is not readable."""
        inner = self.inner.pending() if isinstance(self.inner, ssl.SSLSocket) and self.inner.fileno() >= 0 else 0
        return len(self._in) + inner

    def fileno(self) -> int:
        return self.inner.fileno()

    def setblocking(self, flag: bool) -> None:
        self.inner.setblocking(flag)

    def close(self) -> None:
        self.inner.close()

    def _flush(self) -> None:
        while self._out:
            del self._out[: self.inner.send(self._out)]
