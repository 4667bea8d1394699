"""Does another client use our client id? A broker keeps the newer connection of the two and ends the older. Pure.

MQTT 5 says so (reason 0x8E). MQTT 3.1.1 only closes the connection: one that was closed without a reason soon after it
was accepted, again and again without a refusal in between, is taken for it.
"""

from dataclasses import dataclass

from gateway.core import details
from gateway.durations import NS_PER_S

SHORT_NS = 30 * NS_PER_S
ENOUGH = 3
REMEMBERED_NS = 60 * NS_PER_S


@dataclass(frozen=True, slots=True)
class End:
    """How the broker's side ended a connection. `bare`: without any reason."""

    text: str
    taken_over: bool = False
    bare: bool = False


class Takeovers:
    def __init__(self, client_id: str) -> None:
        self._client_id = client_id
        self._short = 0  # one after the other
        self._found = ""
        self._found_ns = 0

    def lost(self, now_ns: int, lasted_ns: int, end: End | None) -> str:
        """A connection. Returns what was found, where that is news."""
        self._short = self._short + 1 if end is not None and end.bare and lasted_ns < SHORT_NS else 0
        if end is not None and end.taken_over:
            return self._note(now_ns, details.CLIENT_ID_TAKEN(self._client_id))
        if self._short >= ENOUGH:
            return self._note(now_ns, details.CLIENT_ID_SHARED(ENOUGH, self._client_id))
        return ""

    def refused(self) -> None:
        """A connection was not accepted: the broker itself is not well."""
        self._short = 0

    def detail(self, now_ns: int) -> str:
        """What was found within the last minute. Empty: nothing."""
        return self._found if now_ns < self._found_ns + REMEMBERED_NS else ""

    def _note(self, now_ns: int, found: str) -> str:
        news = found if self.detail(now_ns) != found else ""
        self._found, self._found_ns = found, now_ns
        return news
