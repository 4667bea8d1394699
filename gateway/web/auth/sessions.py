"""Sessions and callers. Ids are random and made here, never taken from a browser; nothing is kept on disk. Pure.

A session ends after its lifetime, after its idle time, by logging out, or when the same user opens too many others.
With the web process all end, but that of a technician who has the gateway start again (`resume`).
Only hashes of the ids are kept: from a copy of this memory no session can be used.
"""

import secrets
from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any

from gateway.core.plc import Writer
from gateway.web.auth.access import Level

MAX_SESSIONS = 256
MAX_PER_USER = 8
ID_BYTES = 32
MAX_ID_LENGTH = 64  # characters of a cookie worth looking at


@dataclass(frozen=True, slots=True)
class Session:
    """`key` names the session without opening it; `csrf` must be sent in a header with every change."""

    key: str
    user: str
    level: Level
    csrf: str
    opened_ns: int
    seen_ns: int


class Sessions:
    """At most MAX_SESSIONS; `ended(key)` is called for each that ends, for any reason."""

    def __init__(
        self,
        *,
        lifetime_ns: int,
        idle_ns: int,
        ended: Callable[[str], None] = lambda _: None,
        token: Callable[[int], str] = secrets.token_urlsafe,
    ) -> None:
        self._lifetime_ns = lifetime_ns
        self._idle_ns = idle_ns
        self.ended = ended
        self._token = token
        self._open: dict[str, Session] = {}

    def __len__(self) -> int:
        return len(self._open)

    def open(self, user: str, level: Level, now_ns: int) -> tuple[str, Session]:
        """A new session and its id, which only the browser keeps."""
        self.remove_expired(now_ns)
        own = [session for session in self._open.values() if session.user == user]
        if len(own) >= MAX_PER_USER:
            self.close(min(own, key=lambda session: session.seen_ns).key)
        if len(self._open) >= MAX_SESSIONS:
            self.close(min(self._open.values(), key=lambda session: session.seen_ns).key)
        identity = self._token(ID_BYTES)
        session = Session(_key(identity), user, level, self._token(ID_BYTES), now_ns, now_ns)
        self._open[session.key] = session
        return identity, session

    def resume(self, session: Session) -> None:
        """One that the web process before this one had opened. It ends when it would have ended there."""
        self._open[session.key] = session

    def find(self, identity: str, now_ns: int) -> Session | None:
        """The session of this id, if it is valid; it counts as seen."""
        return self.keep_alive(_key(identity), now_ns) if 0 < len(identity) <= MAX_ID_LENGTH else None

    def keep_alive(self, key: str, now_ns: int) -> Session | None:
        """The same by its key: an open page is not idle."""
        session = self._open.get(key)
        if session is None:
            return None
        if self._expired(session, now_ns):
            self.close(key)
            return None
        session = replace(session, seen_ns=max(now_ns, session.seen_ns))
        self._open[key] = session
        return session

    def remaining_ns(self, session: Session, now_ns: int) -> int:
        """Until its lifetime ends."""
        return max(0, session.opened_ns + self._lifetime_ns - now_ns)

    def close(self, key: str) -> None:
        """Ends it; one that does not exist is not a fault."""
        if self._open.pop(key, None) is not None:
            self.ended(key)

    def remove_expired(self, now_ns: int) -> None:
        """Ends all that are over, seen again or not."""
        for key in [key for key, session in self._open.items() if self._expired(session, now_ns)]:
            self.close(key)

    def _expired(self, session: Session, now_ns: int) -> bool:
        return now_ns - session.opened_ns >= self._lifetime_ns or now_ns - session.seen_ns >= self._idle_ns


def _key(identity: str) -> str:
    return sha256(identity.encode("utf-8", "surrogatepass")).hexdigest()


# Who calls: what the security middleware found out, for the routes behind it.

_KEY = "gateway.web.caller"
NOBODY = "without login"


@dataclass(frozen=True, slots=True)
class Caller:
    """`name` is empty without a login. `csrf` must be sent in X-CSRF-Token with every change."""

    name: str
    level: Level
    address: str  # of the peer, without port
    csrf: str
    session: Session | None = None

    @property
    def writer(self) -> Writer:
        """As commands to the main process and events name it."""
        return Writer(self.address, self.name or NOBODY, self.level.role)


def caller_of(scope: Mapping[str, Any]) -> Caller:
    """Of a request or WebSocket (its `scope`). Raises KeyError where the security middleware has not seen it."""
    found: Caller = scope[_KEY]
    return found


def with_caller(scope: MutableMapping[str, Any], caller: Caller) -> dict[str, Any]:
    """The scope that the application gets. HEAD is a GET whose body the server leaves out."""
    method = {"method": "GET"} if scope.get("method") == "HEAD" else {}
    return {**scope, **method, _KEY: caller}
