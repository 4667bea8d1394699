"""Modbus TCP: answers for every bay under its unit id. The only file that imports pymodbus.

pymodbus has the life cycle of listener and connections; the bytes are ours: `connection` takes them from the transport,
`desk` and `answers` say what is answered, `limits` who may be connected. Why: docs/decisions/0009.
"""

import asyncio
import logging
import ssl
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self, cast

from pymodbus.server import ModbusBaseServer, ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import SimData, SimDevice

from gateway.config import ModbusConfig
from gateway.modbus.protocol.answers import Peer, Unit
from gateway.modbus.protocol.request_handler import Desk, DeskStats
from gateway.modbus.server.connection import Connection
from gateway.modbus.server.limits import Limits, Refusal, plain_address
from gateway.modbus.server.presence import Presence
from gateway.modbus.server.sockets import BACKLOG, allow_open_files, bind_error, listen
from gateway.modbus.server.tls_handshakes import Porch
from gateway.modbus.server.traffic import Guest, ServerNow, peers
from gateway.net.log_throttle import Teller

log = logging.getLogger(__name__)
# A scanner must not fill the disk: pymodbus logs every odd frame, here the bad ones are counted.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

CLOSE_TIMEOUT_S = 0.5
ACCEPT_TURNS = 3  # of the event loop, from accept() to connection_made(); asyncio loses a socket closed in between
ACCEPT_AT_ONCE = 8  # asyncio accepts as many before it looks at anybody else
SWEEP_S = 0.25  # how often deadlines are looked at
SUMMARY_S = 60.0  # how often the counters of refusals are logged, if they have grown

PeerOf = Callable[[asyncio.Transport], Peer | None]
"""Who is at the other end; None: nobody who may be answered, or it is gone already."""


def plain_peer(transport: asyncio.Transport) -> Peer | None:
    """Plain TCP: an address, and no role."""
    name = transport.get_extra_info("peername")
    return Peer(plain_address(name[0])) if name else None


@dataclass(slots=True)
class ServerStats(DeskStats):
    """Counters since the server object was made."""

    connections: int = 0  # let in
    open: int = 0  # connected now
    refused: Counter[Refusal] = field(default_factory=Counter)  # connections not let in or cut, frames discarded
    plc_active_s: float | None = None  # a connection of plc_addresses was last answered then, by the event loop's time


@dataclass(frozen=True, slots=True)
class Tls:
    """How a server speaks TLS: the context of the next connection, and which of those that stand have to go."""

    contexts: Callable[[], ssl.SSLContext]
    ended: Callable[[Peer], Refusal | None]
    handshake_deadline_s: float
    handshakes_per_address: int


class ModbusServer:
    """`async with ModbusServer(config.modbus, {1: unit1}) as server:` listens until the block is left.

    `units`: unit id (0..255) -> Unit. `port`: instead of the configured one. With `tls` it speaks TLS, and `peer_of`
    reads the role from the certificate. Entering raises ConfigError where the operator must act (name,
    privilege, open files) and LinkError where waiting may help (port in use, address not yet there). Leaving cuts every
    connection within CLOSE_TIMEOUT_S. May be entered again.
    """

    def __init__(
        self,
        config: ModbusConfig,
        units: Mapping[int, Unit],
        *,
        port: int | None = None,
        tls: Tls | None = None,
        peer_of: PeerOf = plain_peer,
    ) -> None:
        self.stats = ServerStats()
        self._config = config
        self._units = units
        self._wanted_port = config.port if port is None else port
        self._tls = tls
        self._peer_of = peer_of
        self._listener: _Listener | None = None

    @property
    def port(self) -> int:
        """The port really bound, which differs from the configured one when that is 0."""
        if self._listener is None:
            raise RuntimeError("the server is not running")
        return self._listener.port

    def now(self) -> ServerNow:
        """What it has done so far and who is connected. Raises RuntimeError where `port` does."""
        stats, port = self.stats, self.port
        now_s = asyncio.get_running_loop().time()
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
            peers=peers(self._listener.guests(now_s) if self._listener is not None else ()),
        )

    async def __aenter__(self) -> Self:
        allow_open_files(self._config)
        listener = _Listener(self._config, self._units, self.stats, self._wanted_port, self._peer_of)
        if self._tls is not None:
            admit = cast(Callable[[], asyncio.Protocol], listener.handle_new_connection)  # pymodbus's base has no base
            deadline_s, share = self._tls.handshake_deadline_s, self._tls.handshakes_per_address
            listener.porch = Porch(self._tls.contexts, deadline_s, share, listener, admit)
            listener.ended = self._tls.ended
        try:
            await listener.serve_forever(background=True)
        except (OSError, ValueError) as error:
            await listener.shut_down()
            raise bind_error(self._config, error, self._wanted_port) from error
        self._listener = listener
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        listener, self._listener = self._listener, None
        if listener is not None:
            await listener.shut_down()


class _Listener(ModbusTcpServer):
    """pymodbus's server with our connections, our limits, and an end that leaves nothing open."""

    def __init__(
        self,
        config: ModbusConfig,
        units: Mapping[int, Unit],
        stats: ServerStats,
        port: int,
        peer_of: PeerOf,
    ) -> None:
        # The base class insists on a storage of its own; nothing ever reads it.
        super().__init__(SimDevice(0, SimData(0)), address=(config.host, port))
        self.desk = Desk(units, stats, self._image_fault)
        self.peer_of = peer_of
        self._config = config
        self._wanted_port = port
        self.porch: Porch | None = None  # with TLS
        self.ended: Callable[[Peer], Refusal | None] = lambda _: None
        self._stats = stats
        self._limits = Limits(config)
        self._presence = Presence(units.values())
        self._teller = Teller()
        self._told_faults: set[type[Exception]] = set()
        self._servers: list[asyncio.Server] = []
        self._guests: dict[Connection, int] = {}  # -> how many answers it had at the last sweep
        self._everybody: set[asyncio.Transport] = set()  # those refused too, until they are gone
        self._sweeping: asyncio.TimerHandle | None = None
        self._summary_due_s = self.loop.time() + SUMMARY_S
        self._refusals_told = 0
        self._all_gone = asyncio.Event()
        self._all_gone.set()

    @property
    def port(self) -> int:
        return int(self._servers[0].sockets[0].getsockname()[1])

    async def listen(self) -> bool:
        """As in the base class, but with the operating system's reason raised instead of swallowed."""
        self.is_closing = False
        self.is_listener = True
        welcome = self.handle_new_connection if self.porch is None else self.porch.newcomer
        for sock in await listen(self._config, self._wanted_port):
            self._servers.append(await self.loop.create_server(welcome, sock=sock, backlog=ACCEPT_AT_ONCE))
            sock.listen(BACKLOG)  # the kernel may keep more of them ready than are accepted in one go
        self.transport = _Servers(self._servers)
        self._sweep()
        return True

    def allowed(self, address: str) -> Refusal | None:
        return self._limits.judge(address, self._guests, self.loop.time()).refusal

    def is_plc(self, address: str) -> bool:
        return self._limits.is_plc(address)

    def callback_new_connection(self) -> "_Connection":
        return _Connection(self)

    def welcome(self, connection: Connection) -> bool:
        self._all_gone.clear()
        address = connection.address
        verdict = self._limits.judge(address, self._guests, self.loop.time())
        if verdict.refusal is not None:
            self.refused(connection, verdict.refusal)
            return False
        if verdict.instead_of is not None:
            leaving = cast(Connection, verdict.instead_of)
            leaving.end(Refusal.MADE_ROOM)
            self.gone(leaving)  # its place is free now, not when the event loop comes to it
        connection.is_plc = self._limits.is_plc(address)
        self._guests[connection] = 0
        self._presence.came(connection.peer)
        self._stats.connections += 1
        self._stats.open += 1
        return True

    def guests(self, now_s: float) -> list[Guest]:
        """Who is connected, as of the last sweep."""
        return [
            Guest(guest.address, guest.is_plc, guest.answered, max(0.0, now_s - guest.active_s))
            for guest in self._guests
        ]

    def gone(self, connection: Connection) -> None:
        if self._guests.pop(connection, None) is not None:
            self._presence.left(connection.peer)
            self._stats.open -= 1

    def refused(self, connection: Connection, why: Refusal) -> None:
        self.turned_away(connection.address, why)

    def turned_away(self, address: str, why: Refusal, said: str = "") -> None:
        """`said`: why in particular, of a TLS handshake."""
        self._stats.refused[why] += 1
        line = self._teller.tell((why, said), f"modbus: {address}: {said or why.value}", self.loop.time())
        if line is not None:
            log.warning("%s", line)

    def coming(self, transport: asyncio.Transport) -> None:
        self._everybody.add(transport)
        self._all_gone.clear()

    def went(self, transport: asyncio.Transport) -> None:
        self._everybody.discard(transport)
        if not self._everybody:
            self._all_gone.set()

    def _sweep(self) -> None:
        """Note who was active, end who is overdue."""
        now_s = self.loop.time()
        for guest, answered in list(self._guests.items()):
            if guest.answered != answered:
                self._guests[guest] = guest.answered
                guest.active_s = now_s
                if guest.is_plc:
                    self._stats.plc_active_s = now_s
            why = self._limits.overdue(guest, now_s) or self.ended(guest.peer)
            if why is not None:
                guest.end(why)
                self.gone(guest)
        if now_s >= self._summary_due_s:
            self._summary_due_s = now_s + SUMMARY_S
            self._summarise()
        self._sweeping = self.loop.call_later(SWEEP_S, self._sweep)

    def _summarise(self) -> None:
        """All counters in one line: the lines about single refusals hold most of them back."""
        total = self._stats.refused.total()
        if total != self._refusals_told:
            self._refusals_told = total
            counts = ", ".join(f"{why.name.lower()} {count}" for why, count in self._stats.refused.items())
            log.info(
                "modbus: %d connected, %d requests so far; refused: %s", self._stats.open, self._stats.requests, counts
            )

    def _image_fault(self, error: Exception) -> None:
        if type(error) not in self._told_faults:  # a PLC polls on and on; one traceback of each kind is enough
            self._told_faults.add(type(error))
            log.error("modbus: no image to answer with", exc_info=error)

    async def shut_down(self) -> None:
        """Stop accepting, then close every connection; one that won't take its answer is cut."""
        if self._sweeping is not None:
            self._sweeping.cancel()
        for server in self._servers:
            for listening in server.sockets:
                self.loop.remove_reader(listening.fileno())
        for _ in range(ACCEPT_TURNS):
            await asyncio.sleep(0)
        transports = list(self._everybody)
        await self.shutdown()  # type: ignore[no-untyped-call]  # pymodbus
        for transport in transports:
            transport.abort()
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await self._all_gone.wait()
        except TimeoutError:
            log.warning("modbus: %d connections did not close", len(self._everybody))
        self._summarise()
        if ModbusBaseServer.active_server is self:  # a class-level reference would keep us alive
            ModbusBaseServer.active_server = None


class _Servers(asyncio.BaseTransport):
    """What the base class closes when it ends: one server for each address of the host."""

    def __init__(self, servers: list[asyncio.Server]) -> None:
        super().__init__()
        self._servers = servers

    def close(self) -> None:
        for server in self._servers:
            server.close()


class _Connection(Connection, ServerRequestHandler):
    """One client: pymodbus's place in the life cycle, our data path."""

    def __init__(self, listener: _Listener) -> None:
        ServerRequestHandler.__init__(self, listener, None, None, None)  # type: ignore[no-untyped-call]  # pymodbus
        Connection.__init__(self, listener)
        self._listener = listener

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        tcp = cast(asyncio.Transport, transport)
        self._listener.coming(tcp)
        ServerRequestHandler.connection_made(self, transport)
        self.opened(tcp)

    def connection_lost(self, exc: Exception | None) -> None:
        tcp = self._tcp
        ServerRequestHandler.connection_lost(self, exc)
        self.closed()
        if tcp is not None:
            self._listener.went(tcp)

    def eof_received(self) -> bool:  # type: ignore[override]  # the base class always lets the transport close
        return Connection.eof_received(self)
