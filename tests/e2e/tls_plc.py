"""A PLC that writes: over TLS with its certificate, with a heartbeat of its own; and reads back what came of it."""

import socket
import ssl
import struct
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.registers.register_map import BLOCK_WORDS, decode

Image = dict[str, Any]


class RefusedError(Exception):
    """The exception code that came back."""


class TlsPlc:
    """Reads the whole block and writes 80 to 82 in one FC 23 request, as a PLC's cycle does; a context manager.

    A gateway on a busy machine answers 04 while its control task is late: the PLC tries again in its next cycle.
    """

    def __init__(self, port: int, context: ssl.SSLContext, period_s: float = 0.05) -> None:
        self._sock = context.wrap_socket(
            socket.create_connection(("127.0.0.1", port), timeout=10), server_hostname="127.0.0.1"
        )
        self._period_s = period_s
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._beating = threading.Event()
        self._transaction = 0
        self._failures: list[BaseException] = []
        self.heartbeat = 0
        self.control = 0
        self.recipe = 0
        self.image: Image = {}

    def __enter__(self) -> Self:
        self.cycle()
        self._beating.set()
        self._thread = threading.Thread(target=self._cycles, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join(10)
        self._sock.close()
        if kind is None and self._failures:
            raise self._failures[0]

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

    def cycle(self) -> Image:
        """One FC 23: write, then read; the image shows what was just written."""
        words = (self.heartbeat & 0xFFFF, self.control, self.recipe)
        pdu = struct.pack(">BHHHHB3H", 23, 0, BLOCK_WORDS, 80, 3, 6, *words)
        answer = self.ask(pdu)
        image = decode(struct.unpack(f">{BLOCK_WORDS}H", answer[2:]))
        assert [image[name] for name in ("plc_heartbeat", "plc_control", "recipe_select")] == list(words)
        self.image = image
        return image

    def wait_for(self, wanted: Callable[[Image], bool], timeout_s: float = 30.0) -> Image:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if self._failures:
                raise self._failures[0]
            image = self.image
            if wanted(image):
                return image
            time.sleep(0.01)
        raise AssertionError(f"not seen in {timeout_s} s; last image: {self.image}")

    def _cycles(self) -> None:
        try:
            while not self._end.wait(self._period_s):
                if self._beating.is_set():
                    self.heartbeat += 1
                try:
                    self.cycle()
                except RefusedError as refused:
                    if refused.args != (ModbusException.DEVICE_FAILURE,):
                        raise
        except BaseException as error:  # noqa: BLE001 - told where the test waits
            self._failures.append(error)

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self._sock.recv(count - len(data))
            if not more:
                raise ConnectionResetError("the gateway closed the connection")
            data += more
        return data
