"""Who calls: what the security middleware found out, for the routes behind it. Pure."""

from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from typing import Any

from gateway.core.plc import Writer
from gateway.web.auth.access import Level
from gateway.web.auth.sessions import Session

_KEY = "gateway.web.caller"
NOBODY = "without login"


@dataclass(frozen=True, slots=True)
class Caller:
    """`name` is empty without a login. `csrf` must come back in X-CSRF-Token with all that changes anything."""

    name: str
    level: Level
    address: str  # of the peer, without port
    csrf: str
    session: Session | None = None

    @property
    def writer(self) -> Writer:
        """As orders to the main process and events name it."""
        return Writer(self.address, self.name or NOBODY, self.level.role)


def caller_of(scope: Mapping[str, Any]) -> Caller:
    """Of a request or WebSocket (its `scope`). Raises KeyError where the security middleware has not seen it."""
    found: Caller = scope[_KEY]
    return found


def with_caller(scope: MutableMapping[str, Any], caller: Caller) -> dict[str, Any]:
    """The scope that the application gets. HEAD is a GET whose body the server leaves out."""
    method = {"method": "GET"} if scope.get("method") == "HEAD" else {}
    return {**scope, **method, _KEY: caller}
