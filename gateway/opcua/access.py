"""What a client's application certificate allows it: the role in it, as for Modbus/TCP Security. IO: reads files.

The certificate must be signed by one of the authorities, be valid now, for a client, and not revoked.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import ExtendedKeyUsageOID

from gateway.certs.client_certificate import printable, revoked, role_of, subject_of
from gateway.clock import Clock
from gateway.config import OpcuaConfig
from gateway.durations import NS_PER_S


@dataclass(frozen=True, slots=True)
class OpcuaCaller:
    """Who speaks. `writes`: its role is one of write_roles, and writes are on."""

    subject: str = ""
    role: str = ""
    writes: bool = False
    address: str = ""


class ClientAccess:
    """Reads authorities and revocation list at its making: a process lives as long as its files are the same."""

    def __init__(self, config: OpcuaConfig, clock: Clock) -> None:
        """Raises OSError, or ValueError for files that can't be read."""
        self._config, self._clock = config, clock
        ca, crl = config.ca, config.crl
        self._authorities = [] if ca is None else x509.load_pem_x509_certificates(Path(ca).read_bytes())
        self._revoked = frozenset() if crl is None else revoked(Path(crl).read_bytes())

    def of(self, der: bytes | None) -> OpcuaCaller | None:
        """None: it may do nothing. `der` None or empty: a channel without security."""
        if not der:
            return OpcuaCaller() if self._config.without_security else None
        try:
            found = x509.load_der_x509_certificate(der)
            if not self._trusted(found):
                return None
            role, subject = role_of(found), subject_of(found)
        except ValueError:
            return None
        writes = self._config.writes and role in self._config.write_roles
        if role is None or role not in (*self._config.read_roles, *self._config.write_roles):
            return None
        return OpcuaCaller(subject, printable(role), writes)

    def _trusted(self, found: x509.Certificate) -> bool:
        now = datetime.fromtimestamp(self._clock.wall_ns() / NS_PER_S, UTC)
        if (found.issuer, found.serial_number) in self._revoked or not _for_clients(found):
            return False
        return _current(found, now) and any(_signed(found, by) and _current(by, now) for by in self._authorities)


def _current(found: x509.Certificate, now: datetime) -> bool:
    return found.not_valid_before_utc <= now <= found.not_valid_after_utc


def _for_clients(found: x509.Certificate) -> bool:
    try:
        return ExtendedKeyUsageOID.CLIENT_AUTH in found.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except x509.ExtensionNotFound:
        return False


def _signed(found: x509.Certificate, by: x509.Certificate) -> bool:
    try:
        if not by.extensions.get_extension_for_class(x509.BasicConstraints).value.ca:
            return False
        found.verify_directly_issued_by(by)
    except (x509.ExtensionNotFound, ValueError, TypeError, InvalidSignature):
        return False
    return True
