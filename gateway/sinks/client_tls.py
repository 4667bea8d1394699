"""TLS of a connection to another system, with certificates that may be renewed on disk. IO: reads small files."""

import contextlib
import logging
import ssl

from cryptography import x509

from gateway.certs.client_certificate import validity_of
from gateway.certs.validity import Validity
from gateway.config.sections.common import ClientTls
from gateway.errors import SettingError
from gateway.net.tls import stamps, validities
from gateway.sinks.credentials import client_context

log = logging.getLogger(__name__)


class ClientCertificates:
    """`section`: where the keys are, as `mqtt.tls`, for errors. Raises SettingError for a file that can't be used."""

    def __init__(self, section: str, tls: ClientTls | None) -> None:
        self._section = section
        self._tls = tls
        self._stamps = stamps(self._paths())
        self.newest = client_context(section, tls)
        self._found = self._read()
        self._of_peer: tuple[str, Validity] | None = None

    def current(self) -> ssl.SSLContext:
        """The context for the next connection. Files that have changed are read anew; where they can't be used, that
        is logged, and what was read before stays in force."""
        found = stamps(self._paths())
        if found != self._stamps:
            self._stamps = found
            try:
                self.newest = client_context(self._section, self._tls)
            except SettingError as error:
                log.error("%s; the files read before stay in force", error)
            else:
                self._found = self._read()
                log.warning("%s: certificates and key were read anew", self._section)
        return self.newest

    def days_left(self, wall_ns: int) -> int | None:
        """Of the certificate in cert_file or ca_file that ends first, rounded down. None: no file is configured."""
        return min((one.days_left(wall_ns) for _, one in self._found), default=None)

    def use_peer(self, name: str, der: bytes | None) -> None:
        """The certificate that the other system has shown in the newest handshake."""
        self._of_peer = None
        if der is not None:
            with contextlib.suppress(ValueError):  # OpenSSL is less strict than this reader of certificates
                self._of_peer = f"the certificate of {name}", validity_of(x509.load_der_x509_certificate(der))

    def warning(self, wall_ns: int) -> str:
        """Which certificates have expired, or should be renewed. Empty: none."""
        known = self._found if self._of_peer is None else [*self._found, self._of_peer]
        return "; ".join(f"{name} {text}" for name, one in known if (text := one.expiring(wall_ns)))

    def _paths(self) -> list[str]:
        tls = self._tls or ClientTls()
        default = ssl.get_default_verify_paths()
        trusted = tls.ca_file or default.cafile or default.openssl_cafile
        return [path for path in (trusted, tls.cert_file, tls.key_file, tls.key_password_file) if path is not None]

    def _read(self) -> list[tuple[str, Validity]]:
        found = []
        for key in ("cert_file", "ca_file"):
            path = None if self._tls is None else getattr(self._tls, key)
            if path is not None:
                try:
                    found += [(f"{self._section}.{key}: {path}", one) for one in validities(path)]
                except (OSError, ValueError) as error:  # OpenSSL has read it
                    log.warning("%s.%s: %s: its end can't be read: %s", self._section, key, path, error)
        return found
