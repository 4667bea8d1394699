"""Modbus/TCP Security (MB-TCP-Security v36): what a client's certificate allows it to do, and for how long.

TLS 1.2 or 1.3, certificates on both sides, checked against `ca` (and `crl`). The role is in the certificate; a client
without a role, or with a role that the configuration does not name, may connect and is answered exception 01 to
everything, as the specification's authorisation demands.
"""

import logging
import ssl
from asyncio import Transport

from cryptography import x509

from gateway.certs.client_certificate import printable, role_of, subject_of, validity_of
from gateway.certs.validity import Serial
from gateway.clock import Clock
from gateway.config import TlsConfig
from gateway.modbus.protocol.answers import Access, Peer
from gateway.modbus.server.limits import Refusal
from gateway.net.rate_limit import plain_address
from gateway.net.tls import WARN_NS, ReloadingContext, TlsFiles

log = logging.getLogger(__name__)


class ModbusTls:
    """The TLS side of a server: contexts, and the certificates of connections that are open."""

    def __init__(self, config: TlsConfig, clock: Clock) -> None:
        """Raises ConfigError for files that can't be used."""
        self.config = config
        self._clock = clock
        self._context = ReloadingContext(TlsFiles.of_modbus(config), clock)
        self._clients_warned_ns: dict[Serial, int] = {}  # of those that the authority has signed
        read = dict.fromkeys(config.read_roles, Access.READ)
        self._access: dict[str, Access] = read | dict.fromkeys(config.write_roles, Access.WRITE)

    def context(self) -> ssl.SSLContext:
        """For the next connection."""
        return self._context.current()

    def ended(self, peer: Peer) -> Refusal | None:
        """Why the connection of `peer`, whose certificate was valid at first, must be closed; None: it stays open."""
        if peer.certificate is None:
            return None
        self._context.current()
        wall_ns = self._clock.wall_ns()
        if peer.certificate.until_ns < wall_ns:
            return Refusal.CERTIFICATE_EXPIRED
        if peer.certificate.expiring(wall_ns):
            self._warn_of(peer, peer.certificate.serial, peer.certificate.days_left(wall_ns))
        return Refusal.CERTIFICATE_REVOKED if peer.certificate.serial in self._context.revoked else None

    def access(self, role: str | None) -> Access:
        return Access.NONE if role is None else self._access.get(role, Access.NONE)

    def peer_of(self, transport: Transport) -> Peer | None:
        """Who is at the other end of a TLS connection; None: it is closed already."""
        name = transport.get_extra_info("peername")
        tls = transport.get_extra_info("ssl_object")
        der = tls.getpeercert(binary_form=True) if tls is not None else None
        if not name or der is None:
            return None
        try:
            certificate = x509.load_der_x509_certificate(der)
            role, subject = role_of(certificate), subject_of(certificate)
        except ValueError as error:  # OpenSSL is less strict than this reader of certificates
            log.warning("modbus: %s: its certificate can't be read: %s", name[0], error)
            return None
        shown = None if role is None else printable(role)
        return Peer(plain_address(name[0]), self.access(role), shown, subject, validity_of(certificate))

    def _warn_of(self, peer: Peer, serial: Serial, days: int) -> None:
        now_ns = self._clock.now_ns()
        if now_ns - self._clients_warned_ns.get(serial, -WARN_NS) >= WARN_NS:
            self._clients_warned_ns[serial] = now_ns
            log.warning(
                "modbus: %s: its certificate (%s) expires in %d days, which ends its connection; renew it",
                peer.address, peer.subject, days,
            )  # fmt: skip
