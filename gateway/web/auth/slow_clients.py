"""Time limits for requests to the pages, and the number of connections. Uses uvicorn.

uvicorn bounds the size of a request but not the time it takes: a client that opens connections and is silent,
or sends one letter a minute, would hold them all. Here a connection that is not working on a request must have sent a
complete head within HEAD_S, and one address never has them all. (Of more than `limit_concurrency` connections uvicorn
answers the newest with 503; of many more than that they are closed without an answer.)

uvicorn has no public interface for this: H11Protocol's methods are overridden, and `cycle`, `client`, `connections` and
`limit_concurrency` are read. So uvicorn and h11 are pinned exactly, and a test fails when one of these parts changes.
"""

import asyncio
from collections.abc import Iterable
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from gateway.web.auth.login_throttle import spelled

HEAD_S = 15.0  # longer than uvicorn keeps an idle connection (5 s)
CHECK_S = 2.5
BEYOND = 64  # connections more than uvicorn's limit, to be answered 503
SHARE_OF_ONE = 0.75  # of the limit, for one address; many tablets may share one


class HeadDeadlineProtocol(H11Protocol):
    """For `uvicorn.Config(http=...)`."""

    head_s = HEAD_S
    check_s = CHECK_S
    proxies: frozenset[str] = frozenset()  # whose address is that of many

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._next_check: asyncio.TimerHandle | None = None
        self._asked_s = self.loop.time()
        self._answered = self.cycle
        if self._too_many():
            transport.abort()
            return
        self._check()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_checks()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        self._stop_checks()  # from here on `live` limits how long a page may be silent
        super().handle_websocket_upgrade(event)

    def _too_many(self) -> bool:
        most = self.limit_concurrency
        if most is None or self.client is None:
            return False
        peers = [getattr(other, "client", None) for other in self.connections]  # WebSockets are among them
        same = [peer for peer in peers if peer is not None and peer[0] == self.client[0]]
        return len(peers) > most + BEYOND or (
            len(same) > most * SHARE_OF_ONE and spelled(self.client[0]) not in self.proxies
        )

    def _check(self) -> None:
        now_s = self.loop.time()
        working = self.cycle is not None and not self.cycle.response_complete
        if working or self.cycle is not self._answered:  # another request has been answered since the last check
            self._asked_s, self._answered = now_s, self.cycle
        elif now_s - self._asked_s > self.head_s:
            self.transport.abort()
            return
        self._next_check = self.loop.call_later(self.check_s, self._check)

    def _stop_checks(self) -> None:
        if self._next_check is not None:
            self._next_check.cancel()
            self._next_check = None


def settings(context: Any, trusted: Iterable[str] = ()) -> dict[str, Any]:
    """What of `uvicorn.Config` is about safety. `context`: the ssl.SSLContext, or None; `trusted`: proxies."""

    class Protocol(HeadDeadlineProtocol):
        proxies = frozenset(trusted)

    return {
        "http": Protocol,
        "ws": "websockets-sansio",  # the others are legacy, or wait for wsproto
        "access_log": False,
        "log_level": "error",  # bad requests must not fill the log
        "lifespan": "off",
        "server_header": False,
        "proxy_headers": False,  # an address in a header can be forged: `security` reads those of named proxies
        "ws_per_message_deflate": False,
        **({} if context is None else {"ssl_context_factory": lambda *_: context}),
    }
