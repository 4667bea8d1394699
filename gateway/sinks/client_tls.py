"""TLS of a connection to another system, with certificates that may be renewed on disk. IO: reads small files."""

import logging
import ssl
from datetime import UTC, datetime, timedelta

from gateway.config.sections.common import ClientTls
from gateway.durations import NS_PER_S
from gateway.errors import SettingError
from gateway.net.tls import WARN_DAYS, ends, stamps
from gateway.sinks.credentials import client_context

log = logging.getLogger(__name__)

DAY = timedelta(days=1)


class ClientCertificates:
    """`section`: where the keys are, as `mqtt.tls`, for errors. Raises SettingError for a file that can't be used."""

    def __init__(self, section: str, tls: ClientTls | None) -> None:
        self._section = section
        self._tls = tls
        self._stamps = stamps(self._paths())
        self.newest = client_context(section, tls)
        self._ends = self._read_ends()

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
                self._ends = self._read_ends()
                log.warning("%s: certificates and key were read anew", self._section)
        return self.newest

    def days_left(self, wall_ns: int) -> int | None:
        """Of the certificate in cert_file or ca_file that ends first, rounded down. None: no file is configured."""
        return min(((end - _utc(wall_ns)) // DAY for _, _, end in self._ends), default=None)

    def warning(self, wall_ns: int) -> str:
        """Which certificates have expired, or will within WARN_DAYS. Empty: none."""
        now = _utc(wall_ns)
        return "; ".join(
            f"{key}: {path} {'expired' if end < now else 'expires'} on {end:%Y-%m-%d}"
            for key, path, end in self._ends
            if end < now + WARN_DAYS * DAY
        )

    def _paths(self) -> list[str]:
        tls = self._tls or ClientTls()
        default = ssl.get_default_verify_paths()
        trusted = tls.ca_file or default.cafile or default.openssl_cafile
        return [path for path in (trusted, tls.cert_file, tls.key_file, tls.key_password_file) if path is not None]

    def _read_ends(self) -> list[tuple[str, str, datetime]]:
        found = []
        for key in ("cert_file", "ca_file"):
            path = None if self._tls is None else getattr(self._tls, key)
            if path is not None:
                try:
                    found += [(f"{self._section}.{key}", path, end) for end in ends(path)]
                except (OSError, ValueError) as error:  # OpenSSL has read it
                    log.warning("%s.%s: %s: its end can't be read: %s", self._section, key, path, error)
        return found


def _utc(wall_ns: int) -> datetime:
    return datetime.fromtimestamp(wall_ns // NS_PER_S, UTC)
