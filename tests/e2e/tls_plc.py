"""A PLC that writes: over TLS with its certificate, with a heartbeat of its own; and reads back what came of it."""

import socket
import ssl
import struct
import threading
import time
from collections.abc import Callable

from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.registers.register_map import BLOCK_WORDS, decode
from tests.e2e.plc import CyclicProgram, Image


class RefusedError(Exception):
    """The exception code that came back."""


class TlsPlc(CyclicProgram):
    """Reads the whole block and writes 80 to 82 in one FC 23 request, as a PLC's cycle does.

    A gateway on a busy machine answers 04 while its control task is late: the PLC tries again in its next cycle.
    """

    def __init__(self, port: int, context: ssl.SSLContext, period_s: float = 0.05) -> None:
        super().__init__(period_s)
        self._sock = context.wrap_socket(
            socket.create_connection(("127.0.0.1", port), timeout=10), server_hostname="127.0.0.1"
        )
        self._lock = threading.Lock()
        self._beating = threading.Event()
        self._beating.set()
        self._transaction = 0
        self.heartbeat = 0
        self.control = 0
        self.recipe = 0
        self.image: Image = {}

    def close(self) -> None:
        self._sock.close()

    def stand_still(self) -> None:
        """The program stops; its communication goes on writing the same values."""
        self._beating.clear()

    def ask(self, pdu: bytes) -> bytes:
        """The answer's PDU. Raises RefusedError."""
        with self._lock:
            self._transaction = (self._transaction + 1) & 0xFFFF
            self._sock.sendall(struct.pack(">HHHB", self._transaction, 0, len(pdu) + 1, 1) + pdu)
            transaction, _, length = struct.unpack(">HHH", self._exactly(6))
            answer = self._exactly(length)[1:]
        assert transaction == self._transaction
        if answer[0] & 0x80:
            raise RefusedError(answer[1])
        return answer

    def cycle(self) -> None:
        """One FC 23: write, then read; the image shows what was just written."""
        words = (self.heartbeat & 0xFFFF, self.control, self.recipe)
        pdu = struct.pack(">BHHHHB3H", 23, 0, BLOCK_WORDS, 80, 3, 6, *words)
        try:
            answer = self.ask(pdu)
        except RefusedError as refused:
            if refused.args != (ModbusException.DEVICE_FAILURE,):
                raise
            return
        image = decode(struct.unpack(f">{BLOCK_WORDS}H", answer[2:]))
        assert [image[name] for name in ("plc_heartbeat", "plc_control", "recipe_select")] == list(words)
        self.image = image
        self.heartbeat += self._beating.is_set()

    def wait_for(self, wanted: Callable[[Image], bool], timeout_s: float = 30.0) -> Image:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            self.failed()
            image = self.image
            if image and wanted(image):
                return image
            time.sleep(0.01)
        raise AssertionError(f"not seen in {timeout_s} s; last image: {self.image}")

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self._sock.recv(count - len(data))
            if not more:
                raise ConnectionResetError("the gateway closed the connection")
            data += more
        return data
