"""How long a certificate is valid. Pure, and without the library that reads one."""

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from gateway.durations import NS_PER_S

if TYPE_CHECKING:  # 2 MB, for a gateway that may have no certificate at all
    from cryptography.x509 import Name

DAY_NS = 24 * 3600 * NS_PER_S
Serial = tuple["Name", int]
"""Identifies a certificate: the name of its issuer and its serial number."""


@dataclass(frozen=True, slots=True)
class Validity:
    """What must be known of a certificate while it is in use. `until_ns`: the last valid moment, Unix time;
    `renewal_ns`: it should have been renewed by then."""

    serial: Serial
    until_ns: int
    renewal_ns: int

    def days_left(self, wall_ns: int) -> int:
        """Rounded down."""
        return (self.until_ns - wall_ns) // DAY_NS

    def expiring(self, wall_ns: int) -> str:
        """`expires on` or `expired on`, and the day. Empty: there is no need to renew it yet."""
        if wall_ns < self.renewal_ns:
            return ""
        end = datetime.fromtimestamp(self.until_ns // NS_PER_S, UTC)
        return f"{'expired' if self.until_ns < wall_ns else 'expires'} on {end:%Y-%m-%d}"
