"""A plant's certificates for the tests, good and bad ones."""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509

from gateway.certs import issue
from gateway.certs.folder import Folder
from gateway.clock import SystemClock
from gateway.config import TlsConfig

NOW = datetime.now(UTC)
DAYS = 30


@dataclass(frozen=True)
class LaterClock(SystemClock):
    """Put forward by the sum of `days`, to which a test appends."""

    days: list[float] = field(default_factory=list)

    def now_ns(self) -> int:
        return SystemClock.now_ns(self) + self._ahead_ns

    def wall_ns(self) -> int:
        return SystemClock.wall_ns(self) + self._ahead_ns

    @property
    def _ahead_ns(self) -> int:
        return round(sum(self.days) * 24 * 3600 * 1e9)


class Plant:
    """An authority with a gateway's certificate for 127.0.0.1, and as many clients as are asked for."""

    def __init__(self, path: Path, now: datetime = NOW, kind: issue.KeyType = "ec") -> None:
        self.folder = Folder(path)
        self.folder.create()
        key = issue.new_key(kind)
        self.folder.add("ca", issue.authority("Plant", key, now, 3650), key)
        self.by = self.folder.authority()
        self.folder.replace_crl(issue.revocations(self.by, None, None, now, 365))
        key = issue.new_key()
        self.folder.add("gateway", issue.server(self.by, "gateway", ["127.0.0.1", "localhost"], key, now, DAYS), key)

    def client(self, name: str, role: str | None = "operator", now: datetime = NOW) -> x509.Certificate:
        key = issue.new_key()
        made = issue.client(self.by, name, role, key, now, DAYS)
        self.folder.add(name, made, key)
        return made

    def opcua(self, name: str, role: str | None = None, now: datetime = NOW) -> x509.Certificate:
        """Of an OPC UA client with this role; without one, of the server. The URI is `urn:<name>`."""
        key, uri = issue.new_key("rsa"), f"urn:{name}"
        if role is None:
            made = issue.server(self.by, name, ["127.0.0.1"], key, now, DAYS, uri)
        else:
            made = issue.client(self.by, name, role, key, now, DAYS, uri)
        self.folder.add(name, made, key)
        return made

    def revoke(self, certificate: x509.Certificate) -> None:
        crl = issue.revocations(self.by, self.folder.crl(), certificate.serial_number, NOW, 365)
        self.folder.replace_crl(crl)

    def config(self, **more: object) -> TlsConfig:
        """`modbus.tls` of a gateway in this plant, on a free port."""
        made = {
            "port": 0,
            "cert": str(self.folder.certificate_path("gateway")),
            "key": str(self.folder.key_path("gateway")),
            "ca": str(self.folder.certificate_path("ca")),
            "crl": str(self.folder.crl_path),
            "handshake_deadline_s": 2.0,
        }
        return TlsConfig.model_validate(made | more)


LONG_AGO = NOW - timedelta(days=400)
