"""Modbus/TCP Security (MB-TCP-Security v36): the TLS context, and what a client's certificate allows it to do.

TLS 1.2 or 1.3, certificates on both sides, checked against `ca` (and `crl`). The role stands in the certificate;
one without a role, or with a role that the configuration does not know, may connect and is answered exception 01 to
everything, as the specification's authorisation says.
"""

import logging
import ssl
from asyncio import Transport
from pathlib import Path

from cryptography import x509
from cryptography.x509.oid import NameOID

from gateway.certs import pair
from gateway.certs.role import role_of
from gateway.certs.validity import Serial, revoked, standing
from gateway.clock import NS_PER_S, Clock
from gateway.config import TlsConfig
from gateway.errors import ConfigError
from gateway.modbus.protocol.answers import Access, Peer
from gateway.modbus.server.limits import Refusal, plain_address

log = logging.getLogger(__name__)

CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"  # of TLS 1.2: forward secrecy and authenticated encryption; 1.3 has no others
MAX_SHOWN = 200  # characters of a subject or a role
LOOK_NS = 1_000_000_000  # between two looks at the files, at most so often
DAY_NS = 24 * 3600 * NS_PER_S
WARN_NS = DAY_NS  # a gateway runs for years


def server_context(config: TlsConfig) -> ssl.SSLContext:
    """The context of a server that wants a certificate from every client.

    Raises ConfigError, naming key and file, for files that can't be read, are no PEM or don't fit together.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_ciphers(CIPHERS)
    context.verify_mode = ssl.CERT_REQUIRED
    # A resumed session would not look at the certificate again, which may have expired or been taken back since.
    context.options |= ssl.OP_NO_TICKET | ssl.OP_NO_RENEGOTIATION
    context.num_tickets = 0
    for key, name in (("cert", config.cert), ("key", config.key), ("ca", config.ca), ("crl", config.crl)):
        if name is not None:
            pair.readable((f"modbus.tls.{key}", name))
    pair.load_pair(context, ("modbus.tls.cert", config.cert), ("modbus.tls.key", config.key))
    for key, name in (("ca", config.ca), ("crl", config.crl)):
        if name is None:
            continue
        try:
            context.load_verify_locations(name)
        except OSError as error:
            raise ConfigError(f"modbus.tls.{key}: {name}: nothing in PEM form in it: {pair.said(error)}") from error
    loaded = context.cert_store_stats()
    if loaded["x509_ca"] == 0:
        raise ConfigError(f"modbus.tls.ca: {config.ca}: holds no certificate of an authority")
    if config.crl is not None:
        if loaded["crl"] == 0:
            raise ConfigError(f"modbus.tls.crl: {config.crl}: holds no revocation list")
        context.verify_flags |= ssl.VerifyFlags.VERIFY_CRL_CHECK_LEAF
    return context


def warnings(config: TlsConfig, wall_ns: int) -> list[str]:
    """What an operator should mend soon: certificates about to expire, a key that others may read."""
    certs = [("modbus.tls.cert", config.cert), ("modbus.tls.ca", config.ca)]
    return pair.warnings(certs, ("modbus.tls.key", config.key), wall_ns)


class Contexts:
    """The context for the next connection: its files are looked at anew when they have changed.

    So a renewed certificate or a newer revocation list holds without a restart, for every connection made from then
    on; and `ended` says which of the connections that stand have to go. Files that are no good any more are told, and
    the last good ones go on.
    """

    def __init__(self, config: TlsConfig, clock: Clock) -> None:
        """Raises ConfigError as `server_context` does."""
        self._config = config
        self._clock = clock
        self._context, self._revoked = server_context(config), _revoked(config)
        self._files = (config.cert, config.key, config.ca, config.crl)
        self._stamps = pair.stamps(*self._files)
        self._clients_warned_ns: dict[Serial, int] = {}  # of those that the authority has signed
        self._looked_ns = self._warned_ns = clock.now_ns()
        self._warn()

    def current(self) -> ssl.SSLContext:
        now_ns = self._clock.now_ns()
        if now_ns - self._looked_ns >= LOOK_NS:
            self._looked_ns = now_ns
            self._renew()
            if now_ns - self._warned_ns >= WARN_NS:
                self._warned_ns = now_ns
                self._warn()
        return self._context

    def ended(self, peer: Peer) -> Refusal | None:
        """Why the connection of `peer`, whose certificate was good when it came, has to go now; None: it may stand."""
        if peer.certificate is None:
            return None
        self.current()
        left_ns = peer.certificate.until_ns - self._clock.wall_ns()
        if left_ns < 0:
            return Refusal.CERTIFICATE_EXPIRED
        if left_ns < pair.WARN_DAYS * DAY_NS:
            self._warn_of(peer, peer.certificate.serial, left_ns // DAY_NS)
        return Refusal.CERTIFICATE_REVOKED if peer.certificate.serial in self._revoked else None

    def _renew(self) -> None:
        stamps = pair.stamps(*self._files)
        if stamps == self._stamps:
            return
        self._stamps = stamps
        try:
            self._context, self._revoked = server_context(self._config), _revoked(self._config)
        except ConfigError as error:
            log.error("%s; the files read before stay in force", error)
        else:
            log.info("modbus: the files of [modbus.tls] were read anew")

    def _warn_of(self, peer: Peer, serial: Serial, days: int) -> None:
        now_ns = self._clock.now_ns()
        if now_ns - self._clients_warned_ns.get(serial, -WARN_NS) >= WARN_NS:
            self._clients_warned_ns[serial] = now_ns
            log.warning(
                "modbus: %s: its certificate (%s) expires in %d days, which ends its connection; renew it",
                peer.address, peer.subject, days,
            )  # fmt: skip

    def _warn(self) -> None:
        try:
            for line in warnings(self._config, self._clock.wall_ns()):
                log.warning("%s", line)
        except (OSError, ValueError) as error:  # told by _renew, if it matters
            log.debug("no look at the certificates' ends: %s", error)


class Roles:
    """Which role may do what."""

    def __init__(self, config: TlsConfig) -> None:
        read = dict.fromkeys(config.read_roles, Access.READ)
        self._access: dict[str, Access] = read | dict.fromkeys(config.write_roles, Access.WRITE)

    def access(self, role: str | None) -> Access:
        return Access.NONE if role is None else self._access.get(role, Access.NONE)

    def peer_of(self, transport: Transport) -> Peer | None:
        """Who is at the other end of a TLS connection; None: it is gone already."""
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
        shown = None if role is None else _shown(role)
        return Peer(plain_address(name[0]), self.access(role), shown, subject, standing(certificate))


def _revoked(config: TlsConfig) -> frozenset[Serial]:
    """Raises ConfigError for a list that can't be read."""
    if config.crl is None:
        return frozenset()
    try:
        return revoked(Path(config.crl).read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(f"modbus.tls.crl: {config.crl}: cannot be read: {pair.said(error)}") from error


def subject_of(certificate: x509.Certificate) -> str:
    """The common name, for people; the whole subject where there is none."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return _shown(str(names[0].value) if names else certificate.subject.rfc4514_string())


def _shown(text: str) -> str:
    """One line of bearable length: what stands in a certificate goes into the log, and must not look like a record."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text[:MAX_SHOWN])


def why(error: Exception) -> str:
    """In the operator's words, why a TLS handshake failed."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate was refused: {error.verify_message}"
    if isinstance(error, ssl.SSLError):
        reason = error.reason or str(error)
        return _REASONS.get(reason, f"TLS handshake failed: {reason.lower().replace('_', ' ')}")
    return "it ended the TLS handshake, or did not finish it in time"


_REASONS = {
    "PEER_DID_NOT_RETURN_A_CERTIFICATE": "it showed no certificate",
    "UNSUPPORTED_PROTOCOL": "it speaks no TLS version from 1.2 up",
    "WRONG_VERSION_NUMBER": "it does not speak TLS (plain Modbus on the TLS port?)",
    "HTTP_REQUEST": "it does not speak TLS (a web browser?)",
    "TLSV1_ALERT_UNKNOWN_CA": "it does not know the authority of the gateway's certificate",
    "SSLV3_ALERT_CERTIFICATE_EXPIRED": "it says that the gateway's certificate has expired",
    "SSLV3_ALERT_BAD_CERTIFICATE": "it refuses the gateway's certificate",
    "NO_SHARED_CIPHER": "it has no cipher with forward secrecy and authenticated encryption",
}
