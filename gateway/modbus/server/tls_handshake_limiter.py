"""TLS handshakes in progress: bounded in number, in rate and in time.

A handshake costs a hundred times what an answer costs, and it runs on the event loop. So unknown addresses may begin
only a few of them at once and a few a second, and one address no more than its share of these; the configured PLCs are
not delayed by that. A failure is reported with its reason and the address. After its handshake a connection is handled
as if it had just been made.
"""

import asyncio
import ssl
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from gateway.durations import NS_PER_S
from gateway.modbus.server.limits import Refusal
from gateway.net.rate_limit import KeyedBuckets, Rate, plain_address

AT_ONCE = 16  # unfinished handshakes of unknown addresses
BURST = 20  # of unknown addresses, at once
PER_S = 5.0  # of unknown addresses, continuously
REFILL_S = BURST / PER_S  # after which a burst is possible again
PLC_AT_ONCE = 64  # with those of the PLCs
MAX_ADDRESSES = 1024  # remembered; one that is forgotten has its share anew


class HandshakeOwner(Protocol):
    """The server that the limiter belongs to."""

    def refusal_of(self, address: str) -> Refusal | None:
        """Why that address may not connect; None: it may."""

    def is_plc(self, address: str) -> bool: ...
    def refused(self, address: str, why: Refusal, detail: str = "") -> None: ...
    def opened(self, transport: asyncio.Transport) -> None: ...
    def closed(self, transport: asyncio.Transport) -> None: ...


class PendingHandshake:
    """What the limiter notes of a connection."""

    address = ""
    counted = False


class TlsHandshakeLimiter:
    """Owner of the TLS streams. `make` gives the protocol of a client after its handshake; `share`: of one address."""

    def __init__(
        self,
        contexts: Callable[[], ssl.SSLContext],
        deadline_s: float,
        share: int,
        owner: HandshakeOwner,
        make: Callable[[], asyncio.Protocol],
    ) -> None:
        self._contexts = contexts
        self.deadline_s = deadline_s
        self._owner = owner
        self._make = make
        self._share = share
        self._all = KeyedBuckets(Rate(BURST, round(NS_PER_S / PER_S)), 1)
        self._by_address = KeyedBuckets(Rate(share, round(REFILL_S * NS_PER_S / share)), MAX_ADDRESSES)
        self._waiting: Counter[str] = Counter()  # handshakes begun and not done, by address

    @property
    def context(self) -> ssl.SSLContext:
        """For the next connection."""
        return self._contexts()

    def admit(self, stream: PendingHandshake, tcp: asyncio.Transport) -> bool:
        """A TCP connection has been made. False: it was refused, and must be aborted."""
        name = tcp.get_extra_info("peername")
        if not name:
            return False
        stream.address = plain_address(name[0])
        refusal = self._owner.refusal_of(stream.address) or self._busy(stream.address)
        if refusal is not None:
            self._owner.refused(stream.address, refusal)
            return False
        self._waiting[stream.address] += 1
        stream.counted = True
        self._owner.opened(tcp)
        return True

    def established(self, stream: PendingHandshake) -> asyncio.Protocol:
        """Its handshake is done: the protocol that handles its bytes from now on."""
        self._done(stream)
        return self._make()

    def failed(self, stream: PendingHandshake, error: Exception) -> None:
        self._done(stream)
        self._owner.refused(stream.address, Refusal.TLS_FAILED, failure_reason(error))

    def closed(self, stream: PendingHandshake, tcp: asyncio.Transport) -> None:
        self._done(stream)
        self._owner.closed(tcp)

    def _done(self, stream: PendingHandshake) -> None:
        if stream.counted:
            stream.counted = False
            self._waiting[stream.address] -= 1
            if self._waiting[stream.address] == 0:
                del self._waiting[stream.address]

    def _busy(self, address: str) -> Refusal | None:
        waiting = self._waiting.total()
        if self._owner.is_plc(address):
            return None if waiting < PLC_AT_ONCE else Refusal.TLS_BUSY
        now_ns = round(asyncio.get_running_loop().time() * NS_PER_S)
        if (
            self._waiting[address] >= self._share
            or waiting >= AT_ONCE
            or self._by_address.wait_ns(address, now_ns)
            or self._all.wait_ns("", now_ns)
        ):
            return Refusal.TLS_BUSY
        self._by_address.take(address, now_ns)
        self._all.take("", now_ns)
        return None


def failure_reason(error: Exception) -> str:
    """Why a TLS handshake failed, for the operator."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate was refused: {error.verify_message}"
    if isinstance(error, ssl.SSLError):
        reason = error.reason or str(error)
        return _REASONS.get(reason, f"TLS handshake failed: {reason.lower().replace('_', ' ')}")
    return "it ended the TLS handshake, or did not finish it in time"


_REASONS = {
    "PEER_DID_NOT_RETURN_A_CERTIFICATE": "it showed no certificate",
    "UNSUPPORTED_PROTOCOL": "it supports no TLS version from 1.2 up",
    "WRONG_VERSION_NUMBER": "it does not use TLS (plain Modbus on the TLS port?)",
    "HTTP_REQUEST": "it does not use TLS (a web browser?)",
    "TLSV1_ALERT_UNKNOWN_CA": "it does not trust the authority of the gateway's certificate",
    "SSLV3_ALERT_CERTIFICATE_EXPIRED": "it reports that the gateway's certificate has expired",
    "SSLV3_ALERT_BAD_CERTIFICATE": "it refuses the gateway's certificate",
    "NO_SHARED_CIPHER": "it has no cipher with forward secrecy and authenticated encryption",
}
