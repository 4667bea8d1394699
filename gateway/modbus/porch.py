"""Where a TCP connection waits until its TLS handshake is done: bounded in number, in rate and in time.

A handshake costs a hundred times what an answer costs, and it runs on the event loop. So strangers may begin only a
few of them at once and a few a second; the configured PLCs are not held up by that. What fails is told with the reason
and the address. Afterwards the connection goes on as if it had just been made.
"""

import asyncio
import ssl
from collections.abc import Callable
from typing import Protocol

from gateway.modbus.limits import Refusal, plain_address
from gateway.modbus.tls import why
from gateway.modbus.tlsstream import TlsStream

AT_ONCE = 16  # handshakes of strangers, unfinished
BURST = 20  # of strangers, at once
PER_S = 5.0  # of strangers, for ever
PLC_AT_ONCE = 64  # with those of the PLCs


class Host(Protocol):
    """The listener behind the porch."""

    def allowed(self, address: str) -> Refusal | None:
        """Why that address must stay outside; None: it may come in."""

    def is_plc(self, address: str) -> bool: ...
    def turned_away(self, address: str, why: Refusal, said: str = "") -> None: ...
    def coming(self, transport: asyncio.Transport) -> None: ...
    def went(self, transport: asyncio.Transport) -> None: ...


class Porch:
    """`tlsstream.House`. `admit` gives the protocol for a client that has come in."""

    def __init__(
        self,
        contexts: Callable[[], ssl.SSLContext],
        deadline_s: float,
        host: Host,
        admit: Callable[[], asyncio.Protocol],
    ) -> None:
        self._contexts = contexts
        self.deadline_s = deadline_s
        self._host = host
        self._admit = admit
        self._waiting = 0
        self._tokens = float(BURST)
        self._counted_s = 0.0

    @property
    def context(self) -> ssl.SSLContext:
        """For the next connection."""
        return self._contexts()

    def newcomer(self) -> TlsStream:
        """The protocol of a connection that was just accepted."""
        return TlsStream(self)

    def knock(self, stream: TlsStream, tcp: asyncio.Transport) -> bool:
        name = tcp.get_extra_info("peername")
        if not name:
            return False
        stream.address = plain_address(name[0])
        refusal = self._host.allowed(stream.address) or self._busy(stream.address)
        if refusal is not None:
            self._host.turned_away(stream.address, refusal)
            return False
        self._waiting += 1
        stream.counted = True
        self._host.coming(tcp)
        return True

    def enter(self, stream: TlsStream) -> asyncio.Protocol:
        self._done(stream)
        return self._admit()

    def turn_away(self, stream: TlsStream, error: Exception) -> None:
        self._done(stream)
        self._host.turned_away(stream.address, Refusal.TLS_FAILED, why(error))

    def left(self, stream: TlsStream, tcp: asyncio.Transport) -> None:
        self._done(stream)
        self._host.went(tcp)

    def _done(self, stream: TlsStream) -> None:
        if stream.counted:
            stream.counted = False
            self._waiting -= 1

    def _busy(self, address: str) -> Refusal | None:
        if self._host.is_plc(address):
            return None if self._waiting < PLC_AT_ONCE else Refusal.TLS_BUSY
        now_s = asyncio.get_running_loop().time()
        self._tokens = min(float(BURST), self._tokens + (now_s - self._counted_s) * PER_S)
        self._counted_s = now_s
        if self._waiting >= AT_ONCE or self._tokens < 1:
            return Refusal.TLS_BUSY
        self._tokens -= 1
        return None
