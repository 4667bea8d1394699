"""The connection policy: which clients may connect, which connections are closed, and which writers are connected.
Pure.

The two pools of the MODBUS Messaging on TCP/IP Implementation Guide V1.0b, 4.3.1: connections from the configured PLC
addresses have reserved places and are never closed for being idle; the others share the rest, one address no
more than its share, and where either is full the longest idle one is closed, unless all of them are busy.
"""

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from enum import Enum
from ipaddress import IPv4Network, IPv6Network, ip_address, ip_network

from gateway.config import ModbusConfig
from gateway.modbus.protocol.answers import Access, Peer, Unit

QUIET_S = 5.0  # a connection outside of plc_addresses without a request for this time is closed for a new one


class Refusal(Enum):
    """Why a connection was refused or closed, or a frame not answered. The value is the text in the log."""

    NOT_ALLOWED = "its address is neither in modbus.allow nor in modbus.plc_addresses"
    SHARE = "its address has modbus.connections_per_address open already, and all of them are busy"
    FULL = "modbus.max_connections is reached (less what is kept for plc_addresses), and all of them are busy"
    MADE_ROOM = "it was the quietest, and a new connection needed its place"
    IDLE = "no request for modbus.idle_timeout_s"
    HALF_FRAME = "it began a frame and did not end it within modbus.frame_timeout_s"
    NOT_READING = "it did not read its answers for modbus.send_timeout_s"
    BAD_LENGTH = "its frame has a length that no frame can have, so that the next one can't be found"
    TLS_FAILED = "its TLS handshake failed"
    TLS_BUSY = "too many TLS handshakes at once, or too soon after one another"
    CERTIFICATE_EXPIRED = "its certificate has expired while it was connected"
    CERTIFICATE_REVOKED = "its certificate was revoked (modbus.tls.crl) while it was connected"
    BAD_PROTOCOL = "its frame has another protocol id than 0; the frame was discarded"


@dataclass(eq=False)
class ConnectionInfo:
    """A connection, as the policy sees it. Times in seconds of one monotonic clock."""

    address: str = ""
    is_plc: bool = False
    active_s: float = 0.0  # when it connected or was last answered
    half_since_s: float | None = None  # since when a frame has begun and is not complete
    blocked_since_s: float | None = None  # since when it does not read its answers


@dataclass(frozen=True, slots=True)
class ConnectionVerdict:
    """On a new connection. `refusal` None: accepted; `instead_of`: and close that one for it."""

    refusal: Refusal | None = None
    instead_of: ConnectionInfo | None = None


class ConnectionLimits:
    def __init__(self, config: ModbusConfig) -> None:
        self._config = config
        self._allow = tuple(map(ip_network, config.allow))
        self._plcs = tuple(map(ip_network, config.plc_addresses))

    def is_plc(self, address: str) -> bool:
        return _within(address, self._plcs)

    def judge(self, address: str, connections: Collection[ConnectionInfo], now_s: float) -> ConnectionVerdict:
        """May a connection from `address` join `connections`?"""
        is_plc = self.is_plc(address)
        if self._allow and not is_plc and not _within(address, self._allow):
            return ConnectionVerdict(Refusal.NOT_ALLOWED)
        if is_plc:
            return self._judge_plc(address, connections)
        others = [connection for connection in connections if not connection.is_plc]
        same = [connection for connection in others if connection.address == address]
        if len(same) >= self._config.connections_per_address:
            return _instead_of_quietest(same, now_s, Refusal.SHARE)
        if len(others) < self.room_for_others and len(connections) < self._config.max_connections:
            return ConnectionVerdict()
        return _instead_of_quietest(others, now_s, Refusal.FULL)

    def _judge_plc(self, address: str, connections: Collection[ConnectionInfo]) -> ConnectionVerdict:
        """A PLC that reconnects after a power failure finds its old connections still open: they make room."""
        if len(connections) < self._config.max_connections:
            return ConnectionVerdict()
        candidates = [connection for connection in connections if not connection.is_plc]
        candidates = candidates or [connection for connection in connections if connection.address == address]
        quietest = _quietest(candidates)
        return ConnectionVerdict(Refusal.FULL) if quietest is None else ConnectionVerdict(instead_of=quietest)

    @property
    def room_for_others(self) -> int:
        """How many connections from elsewhere than plc_addresses there may be."""
        return self._config.max_connections - (self._config.plc_connections if self._plcs else 0)

    def overdue(self, connection: ConnectionInfo, now_s: float) -> Refusal | None:
        """Why `connection` must be closed now; None: it stays open."""
        since = connection.blocked_since_s
        if since is not None and now_s - since >= self._config.send_timeout_s:
            return Refusal.NOT_READING
        since = connection.half_since_s
        if since is not None and now_s - since >= self._config.frame_timeout_s:
            return Refusal.HALF_FRAME
        if not connection.is_plc and now_s - connection.active_s >= self._config.idle_timeout_s:
            return Refusal.IDLE
        return None


class ConnectedWriters:
    """Reports to the units each connection of a peer that may write, and its end."""

    def __init__(self, units: Iterable[Unit]) -> None:
        self._report = [unit.connection for unit in units]
        self._open: Counter[tuple[str, str]] = Counter()  # connections by address and subject

    def opened(self, peer: Peer) -> None:
        self._count(peer, 1)

    def closed(self, peer: Peer) -> None:
        self._count(peer, -1)

    def _count(self, peer: Peer, step: int) -> None:
        if peer.access is not Access.WRITE:
            return
        key = (peer.address, peer.subject)
        self._open[key] += step
        for report in self._report:
            report(peer, self._open[key] > 0, 0 if step > 0 else peer.connection)
        if self._open[key] == 0:
            del self._open[key]


def _instead_of_quietest(
    connections: Collection[ConnectionInfo], now_s: float, otherwise: Refusal
) -> ConnectionVerdict:
    quietest = _quietest(connections)
    if quietest is None or now_s - quietest.active_s < QUIET_S:
        return ConnectionVerdict(otherwise)
    return ConnectionVerdict(instead_of=quietest)


def _quietest(connections: Collection[ConnectionInfo]) -> ConnectionInfo | None:
    return min(connections, key=lambda connection: connection.active_s, default=None)


def _within(address: str, networks: Collection[IPv4Network | IPv6Network]) -> bool:
    parsed = ip_address(address)
    return any(parsed in network for network in networks)
