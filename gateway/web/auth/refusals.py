"""How the pages say no: one shape for browsers, programs and WebSockets. Uses Starlette."""

from collections.abc import Mapping
from urllib.parse import quote

from starlette.responses import RedirectResponse, Response
from starlette.types import Scope
from starlette.websockets import WebSocketClose

from gateway.errors import GatewayError
from gateway.web.server.problems import problem


class RefusalError(GatewayError):
    """`code` for programs, the text for people. `audited`: no honest page does this."""

    def __init__(
        self, status: int, code: str, said: str, *, headers: Mapping[str, str] | None = None, audited: bool = False
    ) -> None:
        super().__init__(said)
        self.status = status
        self.code = code
        self.headers = dict(headers or {})
        self.audited = audited


def answer(refusal: RefusalError) -> Response:
    """Problem details; `error` is the code, `detail` the text."""
    return problem(refusal.status, refusal.code, str(refusal), refusal.headers)


def to_login(scope: Scope, *, need: str) -> Response:
    """A person who wants to see a page is shown where to log in; `need` is the role that it takes."""
    query = scope.get("query_string", b"").decode("latin-1")
    wanted = scope["path"] + (f"?{query}" if query else "")
    return RedirectResponse(f"/login?next={quote(wanted, safe='/')}&need={need}", 303)


def answer_to(scope: Scope, refusal: RefusalError) -> Response | WebSocketClose:
    """A WebSocket is refused as HTTP where the server can, before it is one."""
    if scope["type"] == "websocket" and "websocket.http.response" not in scope.get("extensions", {}):
        return WebSocketClose(1008, refusal.code)
    return answer(refusal)
