"""What listens for Modbus: plain TCP, Modbus/TCP Security, or both beside each other, on the same units."""

from asyncio import Transport
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace

from gateway.clock import Clock
from gateway.config import ModbusConfig
from gateway.modbus import tls
from gateway.modbus.answers import Access, Peer, Unit
from gateway.modbus.server import ModbusServer, plain_peer
from gateway.modbus.traffic import ServerNow


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
        """What each of the ports has had to do."""
        return tuple(server.now() for server in self.servers)


@asynccontextmanager
async def serving(config: ModbusConfig, units: Mapping[int, Unit], clock: Clock) -> AsyncIterator[Listening]:
    """Listens until the block is left. Raises ConfigError and LinkError as `ModbusServer` and `tls.Contexts` do.

    Where there is TLS, plain TCP only reads: whoever wants to write must show who it is.
    """
    async with AsyncExitStack() as stack:
        plain: int | None = None
        secure: int | None = None
        servers: list[ModbusServer] = []
        if config.tls is not None:
            server = ModbusServer(
                config,
                units,
                port=config.tls.port,
                tls_contexts=tls.Contexts(config.tls, clock).current,
                handshake_deadline_s=config.tls.handshake_deadline_s,
                peer_of=tls.Roles(config.tls).peer_of,
            )
            servers.append(await stack.enter_async_context(server))
            secure = server.port
        if config.plain:
            peer_of = plain_peer if config.tls is None else reader
            servers.append(await stack.enter_async_context(ModbusServer(config, units, peer_of=peer_of)))
            plain = servers[-1].port
        yield Listening(plain, secure, tuple(servers))


def reader(transport: Transport) -> Peer | None:
    """Somebody on plain TCP beside TLS."""
    peer = plain_peer(transport)
    return None if peer is None else replace(peer, access=Access.READ)
