"""Modbus TCP: shows each bay's image under its unit id. The only file that imports pymodbus.

pymodbus keeps the sockets and frames; what is answered is decided here. Function codes 3 and 4 read one slice of one
image, taken when the request is handled, with no `await` in between: an answer can't be torn. Function code 43/14
names the product. Everything else is refused, writes included.

Where values come from is a mapping from unit id to a callable that returns the whole current image. A faster or
stricter data path overrides `data_received` in `_Connection`; callers would not notice.
"""

import asyncio
import errno
import logging
import socket
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self, cast

from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.device import ModbusDeviceIdentification
from pymodbus.server import ModbusBaseServer, ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import SimData, SimDevice
from pymodbus.simulator.simcore import SimCore

from gateway import __version__
from gateway.config import ModbusConfig
from gateway.errors import ConfigError, GatewayError, LinkError

log = logging.getLogger(__name__)
# A scanner must not fill the disk: pymodbus logs every odd frame, here the bad ones are counted.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

ReadImage = Callable[[], Sequence[int]]
"""The whole current image of a unit, words 0..65535. Called for every request, on the event loop; returns at once."""

READ_HOLDING_REGISTERS = 3
READ_INPUT_REGISTERS = 4
ENCAPSULATED_INTERFACE = 43
SERVED = frozenset({READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS, ENCAPSULATED_INTERFACE})

CLOSE_TIMEOUT_S = 0.5
ACCEPT_TURNS = 3  # of the event loop, from accept() to connection_made(); asyncio loses a socket closed in between


@dataclass(slots=True)
class ServerStats:
    """Counters since the server object was made."""

    connections: int = 0  # accepted
    open: int = 0  # connected now
    requests: int = 0  # understood
    exceptions: int = 0  # answered with a Modbus exception, whatever the reason
    image_faults: int = 0  # an image could not be had or was no image: exception 4


class ModbusServer:
    """`async with ModbusServer(config.modbus, {1: read_bay1}) as server:` listens until the block is left.

    `images`: unit id (0..255) -> ReadImage; the mapping is looked at for every request. Entering raises ConfigError
    where the operator must act (name, privilege) and LinkError where waiting may help (port in use, address not yet
    there). Leaving cuts every connection within CLOSE_TIMEOUT_S. May be entered again.
    """

    def __init__(self, config: ModbusConfig, images: Mapping[int, ReadImage]) -> None:
        self.stats = ServerStats()
        self._config = config
        self._images = images
        self._listener: _Listener | None = None

    @property
    def port(self) -> int:
        """The port really bound, which differs from the configured one when that is 0."""
        if self._listener is None:
            raise RuntimeError("the server is not running")
        return self._listener.port

    async def __aenter__(self) -> Self:
        listener = _Listener(self._config, self._images, self.stats)
        try:
            await listener.serve_forever(background=True)
        except (OSError, ValueError) as error:
            await listener.shut_down()
            raise bind_error(self._config, error) from error
        self._listener = listener
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        listener, self._listener = self._listener, None
        if listener is not None:
            await listener.shut_down()


def bind_error(config: ModbusConfig, error: Exception) -> GatewayError:
    """What the operator is told when listening fails with `error`: ConfigError where trying again would not help."""
    kind: type[GatewayError] = LinkError
    match error:
        case PermissionError():
            kind = ConfigError
            why = (
                "not permitted. Ports below 1024 need a privilege: take a port from 1024 up (modbus.port), or allow "
                "it with `sudo setcap cap_net_bind_service=+ep` on the Python executable, or with "
                "AmbientCapabilities=CAP_NET_BIND_SERVICE in the systemd unit"
            )
        case socket.gaierror() if error.errno == socket.EAI_AGAIN:
            why = f"the name can't be resolved now: {error.strerror}"
        case socket.gaierror() | ValueError():
            kind = ConfigError
            why = f"modbus.host is neither an address nor a known name: {getattr(error, 'strerror', error)}"
        case OSError(errno=errno.EADDRINUSE):
            why = "another program listens there already (another gateway?); `ss -ltnp` shows it"
        case OSError(errno=errno.EADDRNOTAVAIL):
            why = "this machine does not have that address (yet)"
        case _:
            why = getattr(error, "strerror", None) or str(error)
    return kind(f"modbus: cannot listen on {config.host} port {config.port}: {why}")


class _Listener(ModbusTcpServer):
    """pymodbus's server with our values, our reasons for refusal, and an end that leaves nothing open."""

    def __init__(self, config: ModbusConfig, images: Mapping[int, ReadImage], stats: ServerStats) -> None:
        # The base class insists on a storage of its own; nothing ever reads it.
        super().__init__(
            SimDevice(0, SimData(0)),
            address=(config.host, config.port),
            identity=_identity(),
            trace_pdu=self._count,
        )
        self.images = images
        self.stats = stats
        self.context = _Values(images, stats)
        self._server: asyncio.Server | None = None
        self._transports: set[asyncio.Transport] = set()
        self._all_gone = asyncio.Event()
        self._all_gone.set()

    @property
    def port(self) -> int:
        assert self._server is not None  # set by listen(), which raised otherwise
        return int(self._server.sockets[0].getsockname()[1])

    async def listen(self) -> bool:
        """As in the base class, but with the operating system's reason raised instead of swallowed."""
        self.is_closing = False
        self.is_listener = True
        host, port = self.comm_params.source_address or ("", 0)
        server = await self.loop.create_server(self.handle_new_connection, host, port)
        if len({bound.getsockname()[1] for bound in server.sockets}) > 1:
            # Port 0 and a name with two addresses (localhost): each got a free port of its own. Agree on the first.
            port = server.sockets[0].getsockname()[1]
            server.close()
            server = await self.loop.create_server(self.handle_new_connection, host, port)
        self._server = server
        self.transport = server  # type: ignore[assignment]  # as the base class does: all it calls is close()
        return True

    def callback_new_connection(self) -> "_Connection":
        return _Connection(self, self.trace_packet, self.trace_pdu, self.trace_connect)  # type: ignore[no-untyped-call]  # pymodbus

    def opened(self, transport: asyncio.Transport) -> None:
        self._transports.add(transport)
        self._all_gone.clear()
        self.stats.connections += 1
        self.stats.open += 1

    def closed(self, transport: asyncio.Transport) -> None:
        if transport in self._transports:
            self._transports.remove(transport)
            self.stats.open -= 1
        if not self._transports:
            self._all_gone.set()

    async def shut_down(self) -> None:
        """Stop accepting, then close every connection; one that won't take its answer is cut."""
        for listening in self._server.sockets if self._server is not None else ():
            self.loop.remove_reader(listening.fileno())
        for _ in range(ACCEPT_TURNS):
            await asyncio.sleep(0)
        transports = list(self._transports)
        await self.shutdown()  # type: ignore[no-untyped-call]  # pymodbus
        for transport in transports:
            transport.abort()
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await self._all_gone.wait()
        except TimeoutError:
            log.warning("modbus: %d connections did not close", len(self._transports))
        if ModbusBaseServer.active_server is self:  # a class-level reference would keep us alive
            ModbusBaseServer.active_server = None

    def _count(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        if not sending:
            self.stats.requests += 1
        elif pdu.isError():
            self.stats.exceptions += 1
        return pdu


class _Connection(ServerRequestHandler):
    """One client."""

    server: _Listener
    _tcp: asyncio.Transport | None = None
    _asked: int = 0  # function code of the frame at hand

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._tcp = cast(asyncio.Transport, transport)
        self.server.opened(self._tcp)
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        if self._tcp is not None:
            self.server.closed(self._tcp)

    def callback_data(self, data: bytes, addr: tuple[str, int] | None = None) -> int:
        self._asked = data[7] if len(data) > 7 else 0
        return super().callback_data(data, addr)

    async def handle_request(self) -> None:
        """Refuse what this gateway does not offer; pymodbus would make up answers to some of it."""
        pdu = self.last_pdu
        if pdu is not None and (refusal := self._refusal(pdu.dev_id, pdu.function_code)) is not None:
            answer = ExceptionResponse(pdu.function_code, refusal, pdu.dev_id, pdu.transaction_id)
            self.server_send(answer, self.last_addr)
            return
        await super().handle_request()  # type: ignore[no-untyped-call]  # pymodbus

    def server_send(self, pdu: ModbusPDU, addr: tuple[str, int] | None) -> None:
        """A request that could not be decoded is refused by pymodbus as function 0; put that right."""
        if isinstance(pdu, ExceptionResponse) and pdu.function_code == 0x80:
            pdu.function_code = self._asked | 0x80
            pdu.exception_code = self._refusal(pdu.dev_id, self._asked) or ExcCodes.ILLEGAL_VALUE
        super().server_send(pdu, addr)  # type: ignore[no-untyped-call]  # pymodbus

    def _refusal(self, unit: int, function_code: int) -> ExcCodes | None:
        if unit not in self.server.images:
            return ExcCodes.GATEWAY_NO_RESPONSE
        return None if function_code in SERVED else ExcCodes.ILLEGAL_FUNCTION


class _Values(SimCore):
    """What pymodbus asks for register values: slices of our images, nothing stored."""

    def __init__(self, images: Mapping[int, ReadImage], stats: ServerStats) -> None:
        self.devices = {}
        self._images = images
        self._faults = _Faults(stats)

    def device_ids(self) -> list[int]:
        return list(self._images)

    async def async_getValues(  # noqa: N802 - pymodbus's name
        self, device_id: int, func_code: int, address: int, count: int = 1
    ) -> list[int] | list[bool] | ExcCodes:
        """One slice of one image. Whatever the image's callable raises is counted and answered with exception 4."""
        with self._faults:
            image = self._images[device_id]()
            words = list(image[address : address + count])
            struct.pack(f">{len(words)}H", *words)  # anything but 0..65535 is a fault here, not a lost answer later
        return words if address + count <= len(image) else ExcCodes.ILLEGAL_ADDRESS

    async def async_setValues(  # noqa: N802 - pymodbus's name
        self, device_id: int, func_code: int, address: int, values: list[int] | list[bool]
    ) -> ExcCodes | None:
        return ExcCodes.ILLEGAL_FUNCTION


class _Faults:
    """Counts and logs what leaves a `with` block as an exception and lets it pass: pymodbus answers exception 4."""

    def __init__(self, stats: ServerStats) -> None:
        self._stats = stats
        self._told: type[BaseException] | None = None

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            return
        self._stats.image_faults += 1
        if self._told is not kind:  # a PLC polls on and on; one traceback of each kind is enough
            self._told = kind
            log.error("modbus: no image to answer with", exc_info=error)


def _identity() -> ModbusDeviceIdentification:
    return ModbusDeviceIdentification(  # type: ignore[no-untyped-call]  # pymodbus
        info_name={
            "VendorName": "plc-loading-gateway",
            "ProductCode": "plc-loading-gateway",
            "MajorMinorRevision": __version__,
            "ProductName": "PLC integration gateway for bulk loading",
        }
    )
