"""TLS of a listener: its context, made from the files of the configuration and made anew when they change. IO."""

import logging
import ssl
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.certs.validity import DAY_NS, Serial, Validity
from gateway.clock import Clock
from gateway.config import GatewayConfig, OpcuaConfig, TlsConfig
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.systemd import state_folder

log = logging.getLogger(__name__)

CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"  # of TLS 1.2: forward secrecy and authenticated encryption; 1.3 has no others
LOOK_NS = NS_PER_S  # between two checks of the files, at least
WARN_NS = DAY_NS  # warnings are repeated: a gateway runs for years


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """`keys`: what the configuration keys begin with. With `ca` every client must have a certificate."""

    keys: str
    cert: str
    key: str
    ca: str | None = None
    crl: str | None = None
    alpn: tuple[str, ...] = ()

    @classmethod
    def of_modbus(cls, config: TlsConfig) -> "TlsFiles":
        return cls("modbus.tls.", config.cert, config.key, config.ca, config.crl)

    @classmethod
    def of_pages(cls, config: GatewayConfig) -> "TlsFiles | None":
        """None: without TLS. Those of a certificate of its own may be still to be made."""
        cert, key = config.hmi.tls_cert, config.hmi.tls_key
        if config.hmi.own_certificate and (folder := state_folder(config.state_dir)) is not None:
            cert, key = str(folder / "pages.pem"), str(folder / "pages.key")
        return None if cert is None or key is None else cls("hmi.tls_", cert, key, alpn=("http/1.1",))

    @classmethod
    def of_opcua(cls, config: OpcuaConfig | None) -> "TlsFiles | None":
        """None: no server, or without certificates."""
        if config is None or config.cert is None or config.key is None:
            return None
        return cls("opcua.", config.cert, config.key, config.ca, config.crl)

    def named(self) -> Iterator[tuple[str, str]]:
        """Configuration key and file, of those that are configured."""
        for name, path in (("cert", self.cert), ("key", self.key), ("ca", self.ca), ("crl", self.crl)):
            if path is not None:
                yield f"{self.keys}{name}", path


_HTTPS_ONLY = (
    b"<!doctype html><meta charset=utf-8><title>https</title><script>location.protocol = 'https:'</script>"
    b"<p>These pages are at https://, not at http://."
)
_TO_HTTPS = (
    b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/html\r\nContent-Length: %d\r\nCache-Control: no-store\r\n"
    b"Connection: close\r\n\r\n%b" % (len(_HTTPS_ONLY), _HTTPS_ONLY)
)


class _BrowsersObject(ssl.SSLObject):
    """Browsers take an address without a scheme for http://: such a request is answered with the way to https://."""

    outgoing: ssl.MemoryBIO
    answered = False

    def do_handshake(self) -> None:
        if self.answered:
            raise ssl.SSLError("plain http, and answered")
        try:
            super().do_handshake()
        except ssl.SSLError as error:
            if getattr(error, "reason", "") != "HTTP_REQUEST":
                raise
            self.answered = True
            self.outgoing.write(_TO_HTTPS)
            raise ssl.SSLWantReadError from None  # what is to be sent is sent then


class _BrowsersContext(ssl.SSLContext):
    sslobject_class = _BrowsersObject

    def wrap_bio(self, incoming: ssl.MemoryBIO, outgoing: ssl.MemoryBIO, *args: Any, **more: Any) -> ssl.SSLObject:
        made = super().wrap_bio(incoming, outgoing, *args, **more)
        assert isinstance(made, _BrowsersObject)
        made.outgoing = outgoing
        return made


def server_context(files: TlsFiles) -> ssl.SSLContext:
    """Raises ConfigError, naming key and file, for files that can't be read, are not PEM or do not match."""
    context = (_BrowsersContext if files.alpn else ssl.SSLContext)(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_ciphers(CIPHERS)
    context.options |= ssl.OP_NO_RENEGOTIATION
    if files.alpn:
        context.set_alpn_protocols(list(files.alpn))
    for key, path in files.named():
        _check_readable(key, path)
    _load_certificate(context, files)
    if files.ca is not None:
        _demand_certificates(context, files)
    return context


def _load_certificate(context: ssl.SSLContext, files: TlsFiles) -> None:
    try:
        context.load_cert_chain(files.cert, files.key, password=_no_passphrase)
    except (OSError, ValueError) as error:  # OSError: an SSLError, or the file was just removed
        raise ConfigError(
            f"{files.keys}cert: {files.cert} and {files.keys}key {files.key}: not a certificate and its private key, "
            f"in PEM form, without a passphrase: {_reason(error)}"
        ) from error


def _demand_certificates(context: ssl.SSLContext, files: TlsFiles) -> None:
    context.verify_mode = ssl.CERT_REQUIRED
    # A resumed session would not check the certificate again, which may have expired or been revoked since.
    context.options |= ssl.OP_NO_TICKET
    context.num_tickets = 0
    for key, path in files.named():
        if key.endswith(("ca", "crl")):
            try:
                context.load_verify_locations(path)
            except OSError as error:
                raise ConfigError(f"{key}: {path}: nothing in PEM form in it: {_reason(error)}") from error
    loaded = context.cert_store_stats()
    if loaded["x509_ca"] == 0:
        raise ConfigError(f"{files.keys}ca: {files.ca}: holds no certificate of an authority")
    if files.crl is not None:
        if loaded["crl"] == 0:
            raise ConfigError(f"{files.keys}crl: {files.crl}: holds no revocation list")
        context.verify_flags |= ssl.VerifyFlags.VERIFY_CRL_CHECK_LEAF


def check(files: TlsFiles | None) -> None:
    """Raises ConfigError as `server_context` does."""
    if files is not None:
        server_context(files)


def warnings(files: TlsFiles | None, wall_ns: int) -> list[str]:
    """What an operator should correct soon: certificates about to expire, a key that others may read."""
    if files is None:
        return []
    found: list[str] = []
    for key, path in files.named():
        try:
            if key == f"{files.keys}key" and Path(path).stat().st_mode & 0o007:
                # Its group may: root's key is the service's by its group (docs/operations.md).
                found.append(f"{key}: {path} can be read by others; chmod o-rwx")
            if not key.endswith(("cert", "ca")):
                continue
            for one in validities(path):
                if text := one.expiring(wall_ns):
                    days = one.days_left(wall_ns)
                    more = ": no client will connect; renew it" if days < 0 else f", in {days} days"
                    found.append(f"{key}: {path} {text}{more}")
        except (OSError, ValueError) as error:
            found.append(f"{key}: {path}: can't be read: {error}")
    return found


def validities(path: str) -> list[Validity]:
    """Of the certificates in this PEM file. Raises OSError, or ValueError where it has none."""
    from gateway.certs.client_certificate import validities_in  # noqa: PLC0415 - only where there is a certificate

    return validities_in(Path(path).read_bytes())


class ReloadingContext:
    """The context for the next connection: its files are read anew when they have changed.

    A renewed certificate or a newer revocation list is in force without a restart, for every connection made from then
    on. Files that are no longer valid are reported, and the last valid ones stay in force. A server that keeps one
    context for ever takes `initial`: a renewed certificate and key are loaded into that, too.
    """

    def __init__(self, files: TlsFiles, clock: Clock) -> None:
        """Raises ConfigError as `server_context` does."""
        self.files = files
        self._clock = clock
        self.initial = server_context(files)
        self._context, self.revoked = self.initial, _revoked(files)
        self._stamps = _stamps_of(files)
        self._looked_ns = self._warned_ns = clock.now_ns()
        self._warn()

    def current(self) -> ssl.SSLContext:
        now_ns = self._clock.now_ns()
        if now_ns - self._looked_ns >= LOOK_NS:
            self._looked_ns = now_ns
            self._reload()
            if now_ns - self._warned_ns >= WARN_NS:
                self._warned_ns = now_ns
                self._warn()
        return self._context

    async def keep_current(self, period_s: float = 60.0) -> None:
        """Runs until cancelled; for a server that takes `initial` and calls nothing else here."""
        while True:
            await self._clock.sleep(period_s)
            self.current()

    def _reload(self) -> None:
        stamps = _stamps_of(self.files)
        if stamps == self._stamps:
            return
        self._stamps = stamps
        try:
            self._context, self.revoked = server_context(self.files), _revoked(self.files)
            _load_certificate(self.initial, self.files)
        except ConfigError as error:
            log.error("%s; the files read before stay in force", error)
        else:
            log.warning("%s: certificate and key were read anew", self.files.keys.rpartition(".")[0])

    def _warn(self) -> None:
        for line in warnings(self.files, self._clock.wall_ns()):
            log.warning("%s", line)


def _revoked(files: TlsFiles) -> frozenset[Serial]:
    """Raises ConfigError for a list that can't be read."""
    if files.crl is None:
        return frozenset()
    from gateway.certs.client_certificate import revoked  # noqa: PLC0415 - as above

    try:
        return revoked(Path(files.crl).read_bytes())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{files.keys}crl: {files.crl}: cannot be read: {_reason(error)}") from error


def _check_readable(key: str, path: str) -> None:
    try:
        with Path(path).open("rb") as file:
            file.read(1)
    except OSError as error:
        raise ConfigError(f"{key}: cannot read {path}: {error.strerror}") from error


def _stamps_of(files: TlsFiles) -> list[tuple[int, int] | None]:
    return stamps(path for _, path in files.named())


def stamps(paths: Iterable[str]) -> list[tuple[int, int] | None]:
    """Other than before: a file was written, replaced, put there or taken away."""
    found: list[tuple[int, int] | None] = []
    for path in paths:
        try:
            stat = Path(path).stat()
            found.append((stat.st_mtime_ns, stat.st_ino))
        except OSError:
            found.append(None)
    return found


def _reason(error: Exception) -> str:
    """OpenSSL's reason in readable letters."""
    return str(getattr(error, "reason", None) or error).lower().replace("_", " ")


def _no_passphrase() -> str:
    raise ValueError("the key has a passphrase, and the gateway can't enter one")
