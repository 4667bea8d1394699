"""Who of those that may write is connected: the units are told of each one's first connection and of its last. Pure."""

from collections import Counter
from collections.abc import Iterable

from gateway.modbus.protocol.answers import Access, Peer, Unit


class Presence:
    def __init__(self, units: Iterable[Unit]) -> None:
        self._tell = [unit.connection for unit in units if unit.connection is not None]
        self._open: Counter[tuple[str, str]] = Counter()  # connections by address and subject

    def came(self, peer: Peer) -> None:
        if peer.access is not Access.WRITE:
            return
        who = (peer.address, peer.subject)
        self._open[who] += 1
        if self._open[who] == 1:
            self._told(peer, here=True)

    def left(self, peer: Peer) -> None:
        if peer.access is not Access.WRITE:
            return
        who = (peer.address, peer.subject)
        self._open[who] -= 1
        if self._open[who] == 0:
            del self._open[who]
            self._told(peer, here=False)

    def _told(self, peer: Peer, *, here: bool) -> None:
        for tell in self._tell:
            tell(peer, here)
