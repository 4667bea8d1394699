"""How long a connection to the pages may take to ask, and how many there may be. Uses uvicorn.

uvicorn bounds what a request says but not how long it takes to say it: a stranger who opens connections and is silent,
or sends one letter a minute, would hold them all. Here a connection that is not working on a request must have sent a
whole head within HEAD_S, and one address never has them all. (Of more than `limit_concurrency` connections uvicorn
answers the newest with 503; of many more than that they are closed without an answer.)

uvicorn has no public interface for this: H11Protocol's methods are overridden, and `cycle`, `client`, `connections` and
`limit_concurrency` are read. So uvicorn and h11 are pinned exactly, and a test fails when one of these parts changes.
"""

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_S = 15.0  # longer than uvicorn keeps an idle connection (5 s)
LOOK_S = 2.5
BEYOND = 64  # connections more than uvicorn's limit, to be answered 503
SHARE_OF_ONE = 0.75  # of the limit, for one address; a wall of tablets may come through one


class HeadDeadlineProtocol(H11Protocol):
    """For `uvicorn.Config(http=...)`."""

    head_s = HEAD_S
    look_s = LOOK_S

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._looking: asyncio.TimerHandle | None = None
        self._asked_s = self.loop.time()
        if self._too_many():
            transport.abort()
            return
        self._look()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_looking()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        self._stop_looking()  # from here on `live` says how long a page may be silent
        super().handle_websocket_upgrade(event)

    def _too_many(self) -> bool:
        most = self.limit_concurrency
        if most is None or self.client is None:
            return False
        peers = [getattr(other, "client", None) for other in self.connections]  # WebSockets are among them
        same = [peer for peer in peers if peer is not None and peer[0] == self.client[0]]
        return len(peers) > most + BEYOND or len(same) > most * SHARE_OF_ONE

    def _look(self) -> None:
        now_s = self.loop.time()
        if self.cycle is not None and not self.cycle.response_complete:
            self._asked_s = now_s
        elif now_s - self._asked_s > self.head_s:
            self.transport.abort()
            return
        self._looking = self.loop.call_later(self.look_s, self._look)

    def _stop_looking(self) -> None:
        if self._looking is not None:
            self._looking.cancel()
            self._looking = None


def settings(context: Any) -> dict[str, Any]:
    """What of `uvicorn.Config` is about safety. `context`: the ssl.SSLContext, or None."""
    return {
        "http": HeadDeadlineProtocol,
        "ws": "websockets-sansio",  # the others are legacy, or wait for wsproto
        "access_log": False,
        "log_level": "error",  # a stranger's bad requests must not fill the log
        "lifespan": "off",
        "server_header": False,
        "proxy_headers": False,  # an address in a header is anybody's word
        "ws_per_message_deflate": False,
        **({} if context is None else {"ssl_context_factory": lambda *_: context}),
    }
