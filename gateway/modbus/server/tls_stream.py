"""TLS on one TCP connection, by hand: bytes of the network in, bytes of the client out, on any event loop.

The event loops have TLS of their own. It does not report whose handshake failed and why, and drops the alert that would
inform the client; and their ways to begin TLS on an existing connection differ. So OpenSSL is fed here, through its
memory buffers.
"""

import asyncio
import contextlib
import ssl
from collections.abc import Callable
from typing import Any, cast

from gateway.modbus.server.tls_handshake_limiter import PendingHandshake, TlsHandshakeLimiter

READ_BYTES = 16 * 1024  # the largest TLS record


class TlsStream(PendingHandshake, asyncio.Protocol):
    """The protocol of the TCP connection."""

    def __init__(self, owner: TlsHandshakeLimiter) -> None:
        self._owner = owner
        self._incoming = ssl.MemoryBIO()
        self._outgoing = ssl.MemoryBIO()
        self._tls = owner.context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._client: asyncio.Protocol | None = None  # after the handshake
        self._transport: TlsTransport | None = None
        self._over = True  # nothing more is read or written
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._tcp = cast(asyncio.Transport, transport)
        if not self._owner.admit(self, self._tcp):
            self._tcp.abort()
            return
        self._over = False
        loop = asyncio.get_running_loop()
        self._deadline = loop.call_later(self._owner.deadline_s, self._fail, TimeoutError())

    def data_received(self, data: bytes) -> None:
        if self._over:
            return
        self._incoming.write(data)
        try:
            if self._client is None and not self._handshake():
                return
            self._read()
        except ssl.SSLError as error:
            self._fail(error)

    def _handshake(self) -> bool:
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            return False
        finally:
            self._flush()  # an alert, too
        self._cancel_deadline()
        self._client = self._owner.established(self)
        self._transport = TlsTransport(self._tcp, self._tls, self.write, self.close)
        self._client.connection_made(self._transport)
        return True

    def _read(self) -> None:
        while not self._over and not self._tcp.is_closing():
            try:
                data = self._tls.read(READ_BYTES)
            except ssl.SSLWantReadError:
                self._flush()  # what TLS itself has to send
                return
            except ssl.SSLZeroReturnError:
                data = b""
            if self._client is None:
                return
            if data:
                self._client.data_received(data)
            else:
                self._ended()
                return

    def _ended(self) -> None:
        if self._client is not None and not self._client.eof_received():
            self.close()

    def eof_received(self) -> bool:
        if self._client is None or self._over:
            return False
        return bool(self._client.eof_received())

    def pause_writing(self) -> None:
        if self._client is not None:
            self._client.pause_writing()

    def resume_writing(self) -> None:
        if self._client is not None:
            self._client.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        self._cancel_deadline()
        client, self._client = self._client, None
        if client is not None:
            client.connection_lost(exc)
        elif not self._over:
            self._owner.failed(self, ConnectionResetError())
        self._over = True
        self._owner.closed(self, self._tcp)

    def write(self, data: bytes) -> None:
        if self._over or self._tcp.is_closing():
            return
        self._tls.write(data)  # a memory buffer takes everything
        self._flush()

    def close(self) -> None:
        """Send the closing alert and close when everything is sent."""
        if self._over:
            return
        self._over = True
        with contextlib.suppress(ssl.SSLError):  # the peer's closing alert is not waited for
            self._tls.unwrap()
        self._flush()
        self._tcp.close()

    def _fail(self, error: Exception) -> None:
        """Before the end of the handshake it is reported; later it is a broken connection."""
        if self._over:
            return
        self._over = True
        self._cancel_deadline()
        if self._client is None:
            self._owner.failed(self, error)
        self._flush()
        self._tcp.close()

    def _flush(self) -> None:
        data = self._outgoing.read()
        if data and not self._tcp.is_closing():
            self._tcp.write(data)

    def _cancel_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class TlsTransport(asyncio.Transport):
    """What the client's protocol sees: the TCP transport, with its bytes encrypted."""

    def __init__(
        self,
        tcp: asyncio.Transport,
        tls: ssl.SSLObject,
        write: Callable[[bytes], None],
        close: Callable[[], None],
    ) -> None:
        super().__init__()
        self._tcp = tcp
        self._tls = tls
        self._write = write
        self._close = close

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return self._tls if name == "ssl_object" else self._tcp.get_extra_info(name, default)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self._write(bytes(data))

    def close(self) -> None:
        self._close()

    def abort(self) -> None:
        self._tcp.abort()

    def is_closing(self) -> bool:
        return self._tcp.is_closing()

    def pause_reading(self) -> None:
        self._tcp.pause_reading()

    def resume_reading(self) -> None:
        self._tcp.resume_reading()

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._tcp.set_write_buffer_limits(high, low)
