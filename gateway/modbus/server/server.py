"""Modbus TCP: answers for every bay under its unit id, on asyncio.

`connection` takes the bytes from the transport, `request_handler` and `answers` decide what is answered, `limits` who
may be connected. Why asyncio and not a Modbus library's server: docs/decisions/0022.
"""

import asyncio
import logging
import socket
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Self, cast

from gateway.config import ModbusConfig
from gateway.modbus.protocol.answers import Peer, Unit
from gateway.modbus.protocol.request_handler import RequestHandler, RequestStats
from gateway.modbus.server.connection import ModbusConnection
from gateway.modbus.server.limits import ConnectedWriters, ConnectionLimits, Refusal
from gateway.modbus.server.tls_handshake_limiter import TlsHandshakeLimiter
from gateway.modbus.server.tls_stream import TlsStream
from gateway.modbus.server.traffic import PeerNow, ServerNow, peers
from gateway.net.listener import allow_open_files, bind_error, bound_sockets
from gateway.net.rate_limit import LogThrottle, plain_address

if TYPE_CHECKING:
    from gateway.modbus.server.tls import ModbusTls

log = logging.getLogger(__name__)

CLOSE_TIMEOUT_S = 0.5
ACCEPT_TURNS = 3  # of the event loop, from accept() to connection_made(); asyncio loses a socket closed in between
ACCEPT_AT_ONCE = 8  # asyncio accepts as many before it serves other connections
BACKLOG = 64  # connections that the kernel completes before they are accepted; many at once are accepted in such groups
RECEIVE_BYTES = 8 * 1024  # a Modbus request has at most 260 bytes; the kernel doubles this
SEND_BYTES = 32 * 1024
KEEPALIVE_PROBES = 4
SWEEP_S = 0.25  # how often deadlines are checked
SUMMARY_S = 60.0  # how often the counters of refusals are logged, if they have grown

PeerOf = Callable[[asyncio.Transport], Peer | None]
"""The peer; None: one that may not be answered, or the connection is closed already."""


def plain_peer(transport: asyncio.Transport) -> Peer | None:
    """Plain TCP: an address, and no role."""
    name = transport.get_extra_info("peername")
    return Peer(plain_address(name[0])) if name else None


@dataclass(slots=True)
class ServerStats(RequestStats):
    """Counters since the server object was made."""

    connections: int = 0  # accepted
    open: int = 0  # connected now
    refused: Counter[Refusal] = field(default_factory=Counter)  # connections refused or closed, frames discarded
    plc_active_s: float | None = None  # a connection of plc_addresses was last answered then, by the event loop's time


def ports_of(config: ModbusConfig) -> int:
    """How many ports are listened at; each may have max_connections."""
    return config.plain + (config.tls is not None)


class ModbusServer:
    """`async with ModbusServer(config.modbus, {1: unit1}) as server:` listens until the block is left.

    `units`: unit id (0..255) -> Unit. `port`: instead of the configured one. With `tls` it uses TLS and reads the
    role from the certificate; without it `peer_of` identifies the client. Entering raises ConfigError where the
    operator must act (name, privilege, open files) and LinkError where waiting may help (port in use, address not yet
    there). Leaving aborts every connection within CLOSE_TIMEOUT_S. May be entered again.

    It is also `connection.ConnectionOwner`, and with TLS `tls_handshake_limiter.HandshakeOwner`.
    """

    def __init__(
        self,
        config: ModbusConfig,
        units: Mapping[int, Unit],
        *,
        port: int | None = None,
        tls: "ModbusTls | None" = None,
        peer_of: PeerOf = plain_peer,
    ) -> None:
        self.stats = ServerStats()
        self.peer_of = peer_of if tls is None else tls.peer_of
        self.request_handler = RequestHandler(units, self.stats, self._image_fault)
        self._config = config
        self._port = config.port if port is None else port
        self._tls = tls
        self._limits = ConnectionLimits(config)
        self._writers = ConnectedWriters(units.values())
        self._log_throttle = LogThrottle()
        self._logged_faults: set[type[Exception]] = set()
        self._servers: list[asyncio.Server] = []
        self._connections: dict[ModbusConnection, int] = {}  # -> how many answers it had at the last sweep
        self._transports: set[asyncio.Transport] = set()  # those refused too, until they are closed
        self._all_closed = asyncio.Event()
        self._sweeping: asyncio.TimerHandle | None = None
        self._summary_due_s = 0.0
        self._refusals_logged = 0

    @property
    def port(self) -> int:
        """The port really bound, which differs from the configured one when that is 0."""
        if not self._servers:
            raise RuntimeError("the server is not running")
        return int(self._servers[0].sockets[0].getsockname()[1])

    def now(self) -> ServerNow:
        """What it has done so far and who is connected. Raises RuntimeError where `port` does."""
        stats, port = self.stats, self.port
        now_s = self._loop.time()
        return ServerNow(
            tls=self._tls is not None,
            port=port,
            open=stats.open,
            connections=stats.connections,
            requests=stats.requests,
            exceptions=stats.exceptions,
            image_faults=stats.image_faults,
            refused=tuple((why, stats.refused[why]) for why in Refusal),
            plc_quiet_s=None if stats.plc_active_s is None else max(0.0, now_s - stats.plc_active_s),
            peers=peers(
                PeerNow(one.address, one.is_plc, 1, one.answered, max(0.0, now_s - one.active_s))
                for one in self._connections
            ),
        )

    async def __aenter__(self) -> Self:
        config, self._loop = self._config, asyncio.get_running_loop()
        allow_open_files("modbus.max_connections", config.max_connections, ports_of(config))
        options = partial(_set_options, keepalive_s=config.keepalive_s)
        bind = partial(bound_sockets, "modbus", config.host, self._port, options)
        sockets = await self._loop.run_in_executor(None, bind)
        self._all_closed.set()
        self._summary_due_s = self._loop.time() + SUMMARY_S
        try:
            await self._listen(sockets)
        except OSError as error:
            await self._shut_down()
            raise bind_error("modbus", config.host, self._port, error) from error
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._shut_down()

    async def _listen(self, sockets: tuple[socket.socket, ...]) -> None:
        protocol: Callable[[], asyncio.Protocol] = partial(ModbusConnection, self)
        if self._tls is not None:
            deadline_s, share = self._tls.config.handshake_deadline_s, self._tls.config.handshakes_per_address
            limiter = TlsHandshakeLimiter(self._tls.context, deadline_s, share, self, protocol)
            protocol = partial(TlsStream, limiter)
        for sock in sockets:
            self._servers.append(await self._loop.create_server(protocol, sock=sock, backlog=ACCEPT_AT_ONCE))
            sock.listen(BACKLOG)  # the kernel may keep more of them ready than are accepted in one go
        self._sweep()

    def refusal_of(self, address: str) -> Refusal | None:
        return self._limits.judge(address, self._connections, self._loop.time()).refusal

    def is_plc(self, address: str) -> bool:
        return self._limits.is_plc(address)

    def admit(self, connection: ModbusConnection) -> bool:
        address = connection.address
        verdict = self._limits.judge(address, self._connections, self._loop.time())
        if verdict.refusal is not None:
            self.refused(address, verdict.refusal)
            return False
        if verdict.instead_of is not None:
            leaving = cast(ModbusConnection, verdict.instead_of)
            leaving.end(Refusal.MADE_ROOM)
            self._forget(leaving)  # its place is free now, not when the event loop closes it
        connection.is_plc = self._limits.is_plc(address)
        self._connections[connection] = 0
        self.stats.connections += 1
        connection.peer = replace(connection.peer, connection=self.stats.connections)
        self._writers.opened(connection.peer)
        self.stats.open += 1
        return True

    def refused(self, address: str, why: Refusal, detail: str = "") -> None:
        """For the counters and the log. `detail`: of a failed TLS handshake."""
        self.stats.refused[why] += 1
        line = self._log_throttle.line((why, detail), f"modbus: {address}: {detail or why.value}", self._loop.time())
        if line is not None:
            log.warning("%s", line)

    def opened(self, transport: asyncio.Transport) -> None:
        self._transports.add(transport)
        self._all_closed.clear()

    def closed(self, transport: asyncio.Transport, connection: ModbusConnection | None = None) -> None:
        if connection is not None:
            self._forget(connection)
        self._transports.discard(transport)
        if not self._transports:
            self._all_closed.set()

    def _forget(self, connection: ModbusConnection) -> None:
        if self._connections.pop(connection, None) is not None:
            self._writers.closed(connection.peer)
            self.stats.open -= 1

    def _sweep(self) -> None:
        """Note who was active, close who is overdue."""
        now_s = self._loop.time()
        for connection, answered in list(self._connections.items()):
            if connection.answered != answered:
                self._connections[connection] = connection.answered
                connection.active_s = now_s
                if connection.is_plc:
                    self.stats.plc_active_s = now_s
            why = self._limits.overdue(connection, now_s)
            if why is None and self._tls is not None:
                why = self._tls.ended(connection.peer)
            if why is not None:
                connection.end(why)
                self._forget(connection)
        if now_s >= self._summary_due_s:
            self._summary_due_s = now_s + SUMMARY_S
            self._summarise()
        self._sweeping = self._loop.call_later(SWEEP_S, self._sweep)

    def _summarise(self) -> None:
        """All counters in one line: the lines about single refusals suppress most of them."""
        total = self.stats.refused.total()
        if total != self._refusals_logged:
            self._refusals_logged = total
            counts = ", ".join(f"{why.name.lower()} {count}" for why, count in self.stats.refused.items())
            log.info(
                "modbus: %d connected, %d requests so far; refused: %s", self.stats.open, self.stats.requests, counts
            )

    def _image_fault(self, error: Exception) -> None:
        if type(error) not in self._logged_faults:  # a PLC repeats its polls; one traceback of each kind is enough
            self._logged_faults.add(type(error))
            log.error("modbus: no image to answer with", exc_info=error)

    async def _shut_down(self) -> None:
        """Stop accepting, then abort every connection."""
        if self._sweeping is not None:
            self._sweeping.cancel()
        servers, self._servers = self._servers, []
        for server in servers:
            for listening in server.sockets:
                self._loop.remove_reader(listening.fileno())
        for _ in range(ACCEPT_TURNS):
            await asyncio.sleep(0)
        for server in servers:
            server.close()
        for transport in list(self._transports):
            transport.abort()
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await self._all_closed.wait()
        except TimeoutError:
            log.warning("modbus: %d connections did not close", len(self._transports))
        self._summarise()


def _set_options(sock: socket.socket, *, keepalive_s: int) -> None:
    """Set before listening: the connections inherit them, which saves system calls under a storm."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    # Quiet for keepalive_s, then probed, given up after as long again.
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, keepalive_s)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, max(1, keepalive_s // KEEPALIVE_PROBES))
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, KEEPALIVE_PROBES)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 2000 * keepalive_s)
