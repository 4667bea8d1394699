"""Where a TCP connection waits until its TLS handshake is done: bounded in number, in rate and in time.

A handshake costs a hundred times what an answer costs, and it runs on the event loop. So strangers may begin only a
few of them at once and a few a second; the configured PLCs are not held up by that. What fails is told with the reason
and the address. Afterwards the connection is handed on as if it had just been made.
"""

import asyncio
import ssl
from collections.abc import Callable
from typing import Any, cast

from gateway.modbus.limits import Refusal, plain_address
from gateway.modbus.tls import why

AT_ONCE = 16  # handshakes of strangers, unfinished
BURST = 20  # of strangers, at once
PER_S = 5.0  # of strangers, for ever
PLC_AT_ONCE = 64  # with those of the PLCs


class Porch:
    """`admit` gives the protocol for a new client; `allowed` says why an address must stay outside (None: it may come
    in); `refused` is told the address, and why in words; `coming` and `went` keep count of open sockets.
    """

    def __init__(
        self,
        context: ssl.SSLContext,
        deadline_s: float,
        tasks: asyncio.TaskGroup,
        *,
        admit: Callable[[], Any],  # an asyncio.Protocol; pymodbus has a base class of its own
        allowed: Callable[[str], Refusal | None],
        is_plc: Callable[[str], bool],
        refused: Callable[[str, Refusal, str], None],
        coming: Callable[[asyncio.Transport], None],
        went: Callable[[asyncio.Transport], None],
    ) -> None:
        self._context = context
        self._deadline_s = deadline_s
        self._tasks = tasks
        self._admit: Callable[[], asyncio.Protocol] = admit
        self._allowed = allowed
        self._is_plc = is_plc
        self._refused = refused
        self._coming = coming
        self._went = went
        self._waiting = 0
        self._tokens = float(BURST)
        self._counted_s = 0.0
        self._loop = asyncio.get_running_loop()

    def newcomer(self) -> "Newcomer":
        """The protocol of a connection that was just accepted."""
        return Newcomer(self)

    def knock(self, tcp: asyncio.Transport) -> None:
        """A connection has been made; its handshake begins, or it is cut."""
        name = tcp.get_extra_info("peername")
        if not name:
            tcp.abort()
            return
        address = plain_address(name[0])
        refusal = self._allowed(address) or self._busy(address)
        if refusal is not None:
            self._refused(address, refusal, "")
            tcp.abort()
            return
        self._coming(tcp)
        self._waiting += 1
        self._tasks.create_task(self._shake_hands(tcp, address), name=f"tls handshake {address}")

    def _busy(self, address: str) -> Refusal | None:
        if self._is_plc(address):
            return None if self._waiting < PLC_AT_ONCE else Refusal.TLS_BUSY
        now_s = self._loop.time()
        self._tokens = min(float(BURST), self._tokens + (now_s - self._counted_s) * PER_S)
        self._counted_s = now_s
        if self._waiting >= AT_ONCE or self._tokens < 1:
            return Refusal.TLS_BUSY
        self._tokens -= 1
        return None

    async def _shake_hands(self, tcp: asyncio.Transport, address: str) -> None:
        early = _Early()
        try:
            tls = await self._loop.start_tls(
                tcp,
                early,
                self._context,
                server_side=True,
                ssl_handshake_timeout=self._deadline_s,
                ssl_shutdown_timeout=self._deadline_s,
            )
        except OSError as error:  # ssl.SSLError and the timeout are OSErrors, too
            self._refused(address, Refusal.TLS_FAILED, why(error))
            tcp.abort()
            return
        finally:
            self._waiting -= 1
            self._went(tcp)
        if tls is None or early.lost:
            return
        client = self._admit()
        tls.set_protocol(client)
        client.connection_made(tls)
        if early.data:
            client.data_received(bytes(early.data))


class Newcomer(asyncio.Protocol):
    """Says nothing and hears nothing before the handshake."""

    def __init__(self, porch: Porch) -> None:
        self._porch = porch

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        tcp = cast(asyncio.Transport, transport)
        tcp.pause_reading()
        self._porch.knock(tcp)


class _Early(asyncio.Protocol):
    """Keeps what a client sends in the moment between the end of its handshake and its welcome."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.lost = False

    def data_received(self, data: bytes) -> None:
        self.data += data

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost = True
