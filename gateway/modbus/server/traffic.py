"""What a Modbus server has done, as a record for pages and metrics. Pure."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from gateway.modbus.server.limits import Refusal

MOST_PEERS = 16  # listed; a server may have thousands


@dataclass(frozen=True, slots=True)
class PeerNow:
    """One address with its open connections. `quiet_s`: since it was last answered, to a quarter of a second."""

    address: str
    is_plc: bool
    connections: int
    requests: int
    quiet_s: float


@dataclass(frozen=True, slots=True)
class ServerNow:
    """One listening port. Counters since the start."""

    tls: bool
    port: int
    open: int
    connections: int
    requests: int
    exceptions: int
    image_faults: int
    refused: tuple[tuple[Refusal, int], ...]  # every reason, in the order of Refusal
    plc_quiet_s: float | None  # since one of plc_addresses was last answered; None: never
    peers: tuple[PeerNow, ...]  # at most MOST_PEERS, PLCs first, then those answered last


def peers(connections: Iterable[PeerNow]) -> tuple[PeerNow, ...]:
    """One record an address."""
    found: dict[str, PeerNow] = {}
    for one in connections:
        known = found.get(one.address, replace(one, connections=0, requests=0))
        found[one.address] = replace(
            one,
            connections=known.connections + one.connections,
            requests=known.requests + one.requests,
            quiet_s=min(known.quiet_s, one.quiet_s),
        )
    return tuple(sorted(found.values(), key=lambda peer: (not peer.is_plc, peer.quiet_s))[:MOST_PEERS])
