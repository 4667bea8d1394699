"""What the pages' guard tells of people: logins, refusals, changes. The same record for log, events and tests. Pure."""

from dataclasses import dataclass
from enum import StrEnum


class What(StrEnum):
    LOGIN = "login"
    LOGOUT = "logout"
    LOGIN_FAILED = "login_failed"
    LOGIN_THROTTLED = "login_throttled"  # too many failures; the password was not even looked at
    REFUSED = "refused"  # a forged, foreign or forbidden request
    CHANGED = "changed"  # something was asked for that is more than looking, and was answered


CAUTION = (What.LOGIN_FAILED, What.LOGIN_THROTTLED, What.REFUSED)


@dataclass(frozen=True, slots=True)
class Told:
    """One thing a person did or tried. Nothing in it is longer than a line, or could look like another record."""

    what: What
    who: str  # name as logged in or as tried; empty: nobody
    address: str  # of the peer, without port
    detail: str = ""
    untold: int = 0  # so many before this one were only counted

    def __str__(self) -> str:
        more = f" ({self.untold} more were not told)" if self.untold else ""
        return f"{self.what.value.replace('_', ' ')}: {self.who or 'nobody'} at {self.address}: {self.detail}{more}"


def shown(text: str, most: int = 80) -> str:
    """Text of a stranger's, made fit for one line of a log."""
    kept = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text[:most])
    return kept + "…" if len(text) > most else kept
