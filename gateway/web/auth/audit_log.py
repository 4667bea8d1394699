"""What people did or tried: logins, refusals, changes. The same record for log, events and tests. Pure."""

from dataclasses import dataclass
from enum import StrEnum


class AuditKind(StrEnum):
    LOGIN = "login"
    LOGOUT = "logout"
    LOGIN_FAILED = "login_failed"
    LOGIN_THROTTLED = "login_throttled"  # too many failures; the password was not checked
    REFUSED = "refused"  # a forged, foreign or forbidden request
    CHANGED = "changed"  # a request that changes something, or takes evidence away, was answered


WARNINGS = (AuditKind.LOGIN_FAILED, AuditKind.LOGIN_THROTTLED, AuditKind.REFUSED)


@dataclass(frozen=True, slots=True)
class AuditRecord:
    """One action or attempt of a person. It fits on one line and can't imitate another record."""

    kind: AuditKind
    who: str  # name as logged in or as tried; empty: none
    address: str  # of the peer, without port
    detail: str = ""
    unreported: int = 0  # so many records before this one were only counted

    def __str__(self) -> str:
        more = f" ({self.unreported} more were not reported)" if self.unreported else ""
        return f"{self.kind.value.replace('_', ' ')}: {self.who or 'no user'} at {self.address}: {self.detail}{more}"


def printable(text: str, most: int = 80) -> str:
    """Text of unknown origin as one line of a log."""
    kept = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text[:most])
    return kept + "…" if len(text) > most else kept
