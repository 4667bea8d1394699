"""How the pages refuse: problem details (RFC 9457) for browsers, programs and WebSockets alike. Uses Starlette."""

from collections.abc import Mapping
from http import HTTPStatus
from typing import Any
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.types import Scope
from starlette.websockets import WebSocketClose

from gateway.errors import GatewayError

MEDIA_TYPE = "application/problem+json"
AGAIN = {"Retry-After": "1"}  # s, with a 503 that may be over by then
PROBLEM_CONTENT: dict[str, Any] = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}  # for OpenAPI


class Problem(BaseModel):
    """What went wrong: problem details after RFC 9457."""

    model_config = ConfigDict(frozen=True)
    type: str = Field("about:blank", description="`about:blank`: the status has the full meaning")
    title: str = Field(description="of the status")
    status: int
    detail: str = Field(description="in words, for people")
    error: str = Field(description="a short code, for programs")


class RefusalError(GatewayError):
    """`code` for programs, the text for people. `audited`: no honest page does this. `members`: more of the answer, by
    name (RFC 9457, extension members)."""

    def __init__(
        self,
        status: int,
        code: str,
        text: str,
        *,
        headers: Mapping[str, str] | None = None,
        audited: bool = False,
        members: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(text)
        self.status = status
        self.code = code
        self.headers = dict(headers or {})
        self.audited = audited
        self.members = dict(members or {})


def throttled(of: str, wait_s: int) -> RefusalError:
    text = f"too many {of}; try again in {wait_s} s"
    return RefusalError(429, "throttled", text, headers={"Retry-After": str(wait_s)})


def problem(
    status: int,
    error: str,
    detail: str,
    headers: Mapping[str, str] | None = None,
    members: Mapping[str, Any] | None = None,
) -> Response:
    """`error`: a short code for programs; `detail`: in words, for people; `members`: what else it says."""
    body = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail, error=error)
    return JSONResponse({**(members or {}), **body.model_dump()}, status, headers=headers, media_type=MEDIA_TYPE)


def to_login(scope: Scope, base_path: str, *, need: str) -> Response:
    """A person who requests a page is redirected to the login; `need` is the required role."""
    query = scope.get("query_string", b"").decode("latin-1")
    target = base_path + scope["path"] + (f"?{query}" if query else "")
    return RedirectResponse(f"{base_path}/login?next={quote(target, safe='/')}&need={need}", 303)


def is_missing_page(scope: Scope) -> bool:
    """Does a person look at this address, of which there is none?"""
    accepts = next((value for name, value in scope["headers"] if name == b"accept"), b"")
    for_programs = scope["path"].startswith(("/api/", "/static/"))
    return scope["method"] in ("GET", "HEAD") and b"text/html" in accepts and not for_programs


def answer_to(scope: Scope, refusal: RefusalError) -> Response | WebSocketClose:
    """A WebSocket is refused as HTTP where the server can, before it is one."""
    if scope["type"] == "websocket" and "websocket.http.response" not in scope.get("extensions", {}):
        return WebSocketClose(1008, refusal.code)
    return problem(refusal.status, refusal.code, str(refusal), refusal.headers, refusal.members)
