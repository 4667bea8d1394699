"""What listens for Modbus: plain TCP, Modbus/TCP Security, or both beside each other, on the same units."""

import asyncio
import logging
from asyncio import Transport
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace

from gateway.clock import Clock
from gateway.config import ModbusConfig
from gateway.modbus.protocol.answers import Access, Peer, Unit
from gateway.modbus.server.limits import ConnectionLimits
from gateway.modbus.server.server import ModbusServer, PeerOf, plain_peer
from gateway.modbus.server.traffic import ServerNow

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Listening:
    """The ports really bound; None: not served."""

    plain: int | None
    tls: int | None
    servers: tuple[ModbusServer, ...] = ()

    @property
    def first(self) -> int:
        """Of plain TCP; where that is off, of TLS."""
        return self.plain or self.tls or 0

    def now(self) -> tuple[ServerNow, ...]:
        """The counters of each port."""
        return tuple(server.now() for server in self.servers)


class ModbusService:
    """A row of a task table. `now`: the counters of each port that is open."""

    def __init__(self, config: ModbusConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._bound: Listening | None = None

    def now(self) -> tuple[ServerNow, ...]:
        return () if self._bound is None else self._bound.now()

    async def run(self, units: Mapping[int, Unit], opened: Callable[[Listening], None]) -> None:
        """Raises LinkError where the port can't be had yet, which is tried again: the bays, the pages and the sinks do
        not wait for the PLC's network."""
        async with serving(self._config, units, self._clock) as bound:
            self._bound = bound
            try:
                opened(bound)
                await asyncio.Event().wait()
            finally:
                self._bound = None


@asynccontextmanager
async def serving(config: ModbusConfig, units: Mapping[int, Unit], clock: Clock) -> AsyncIterator[Listening]:
    """Listens until the block is left. Raises ConfigError and LinkError as `ModbusServer` and `ModbusTls` do.

    Where there is TLS, plain TCP only reads: a client that writes must have a certificate.
    """
    async with AsyncExitStack() as stack:
        plain: int | None = None
        secure: int | None = None
        servers: list[ModbusServer] = []
        if config.tls is not None:
            from gateway.modbus.server.tls import ModbusTls  # noqa: PLC0415 - reading certificates takes a library of 2 MB

            server = ModbusServer(config, units, port=config.tls.port, tls=ModbusTls(config.tls, clock))
            servers.append(await stack.enter_async_context(server))
            secure = server.port
        if config.plain:
            servers.append(await stack.enter_async_context(ModbusServer(config, units, peer_of=plain_peers(config))))
            plain = servers[-1].port
        for line in config.warnings():  # once there is a port: it may be tried again and again
            log.warning("%s", line)
        yield Listening(plain, secure, tuple(servers))


def plain_peers(config: ModbusConfig) -> PeerOf:
    """Identification on plain TCP: a client that may connect reads, and where there is no TLS, plc_addresses write."""
    limits = ConnectionLimits(config)

    def peer_of(transport: Transport) -> Peer | None:
        peer = plain_peer(transport)
        if peer is None:
            return None
        may_write = config.tls is None and limits.is_plc(peer.address)
        return replace(peer, access=Access.WRITE if may_write else Access.READ)

    return peer_of
