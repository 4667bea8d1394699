"""Where a TCP connection waits until its TLS handshake is done: bounded in number, in rate and in time.

A handshake costs a hundred times what an answer costs, and it runs on the event loop. So strangers may begin only a
few of them at once and a few a second, and one address no more than its share of these; the configured PLCs are not
held up by that. What fails is told with the reason and the address. Afterwards the connection goes on as if it had just
been made.
"""

import asyncio
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from gateway.modbus.server.limits import Refusal, plain_address
from gateway.modbus.server.tls import why
from gateway.modbus.server.tls_stream import TlsStream

AT_ONCE = 16  # handshakes of strangers, unfinished
BURST = 20  # of strangers, at once
PER_S = 5.0  # of strangers, for ever
REFILL_S = BURST / PER_S  # in which a burst may come again
PLC_AT_ONCE = 64  # with those of the PLCs
MAX_ADDRESSES = 1024  # remembered; one that is forgotten has its share anew


class Host(Protocol):
    """The listener behind the porch."""

    def allowed(self, address: str) -> Refusal | None:
        """Why that address must stay outside; None: it may come in."""

    def is_plc(self, address: str) -> bool: ...
    def turned_away(self, address: str, why: Refusal, said: str = "") -> None: ...
    def coming(self, transport: asyncio.Transport) -> None: ...
    def went(self, transport: asyncio.Transport) -> None: ...


@dataclass(slots=True)
class Budget:
    """A token bucket: `most` handshakes at once, and again within REFILL_S."""

    most: float
    tokens: float
    counted_s: float
    waiting: int = 0  # begun, and not done

    def refill(self, now_s: float) -> None:
        self.tokens = min(self.most, self.tokens + (now_s - self.counted_s) * self.most / REFILL_S)
        self.counted_s = now_s

    def allows(self, at_once: float) -> bool:
        return self.waiting < at_once and self.tokens >= 1


class Porch:
    """`tlsstream.House`. `admit` gives the protocol for a client that has come in; `share`: of one address, at once."""

    def __init__(
        self,
        contexts: Callable[[], ssl.SSLContext],
        deadline_s: float,
        share: int,
        host: Host,
        admit: Callable[[], asyncio.Protocol],
    ) -> None:
        self._contexts = contexts
        self.deadline_s = deadline_s
        self._host = host
        self._admit = admit
        self._all = Budget(BURST, BURST, 0.0)
        self._most_of_one = float(share)
        self._shares: dict[str, Budget] = {}  # of strangers

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
        self._all.waiting += 1
        if (share := self._shares.get(stream.address)) is not None:
            share.waiting += 1
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
            self._all.waiting -= 1
            if (share := self._shares.get(stream.address)) is not None:
                share.waiting -= 1

    def _busy(self, address: str) -> Refusal | None:
        if self._host.is_plc(address):
            return None if self._all.waiting < PLC_AT_ONCE else Refusal.TLS_BUSY
        now_s = asyncio.get_running_loop().time()
        share = self._share(address, now_s)
        self._all.refill(now_s)
        if not (share.allows(self._most_of_one) and self._all.allows(AT_ONCE)):
            return Refusal.TLS_BUSY
        share.tokens -= 1
        self._all.tokens -= 1
        return None

    def _share(self, address: str, now_s: float) -> Budget:
        """The stranger's own, as of now. Never forgotten while a handshake of its waits."""
        share = self._shares.get(address)
        if share is None:
            if len(self._shares) >= MAX_ADDRESSES:
                idle = (known for known, its in self._shares.items() if its.waiting == 0)
                del self._shares[next(idle)]  # the first one that came; at most AT_ONCE of them wait
            share = self._shares[address] = Budget(self._most_of_one, self._most_of_one, now_s)
        share.refill(now_s)
        return share
