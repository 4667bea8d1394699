"""The security middleware, called as a server would, in virtual time; behind it an application that echoes."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from http.cookies import SimpleCookie
from typing import Any

from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message
from starlette.websockets import WebSocket, WebSocketDisconnect

from gateway.clock import SystemClock
from gateway.config.sections.hmi import HmiConfig, HmiUser
from gateway.web.auth import login
from gateway.web.auth.access import Rule
from gateway.web.auth.audit_log import AuditKind, AuditRecord
from gateway.web.auth.logins import Logins
from gateway.web.auth.passwords import Passwords
from gateway.web.auth.security import SecurityMiddleware
from gateway.web.auth.sessions import caller_of
from gateway.web.server.app import HANDLERS, RULES
from tests.unit.web import asgi
from tests.unit.web.asgi import Answer, Headers, answer_to
from tests.virtual_time import LoopClock

# Both are "correct horse battery"; the smallest that the configuration takes.
HASH = "$argon2id$v=19$m=19456,t=1,p=1$c29tZXNhbHRzb21lc2FsdA$W+2f2aTQVuXP2kOFsVBogWmXqhlPdId3xAJac1/d60o"
PASSWORD = "correct horse battery"
USERS = (
    HmiUser(name="vera", role="viewer", password_hash=HASH),
    HmiUser(name="tom", role="technician", password_hash=HASH),
)
HOST = "10.0.0.5:8080"
ORIGIN = f"http://{HOST}"
BAYS = {"north": "Verladung 3 Süd", "south": ""}  # and their titles


class QuickPasswords(Passwords):
    """Looks at the password itself, at once: a thread's work takes no virtual time."""

    checks = 0

    async def check(self, name: str, password: str) -> HmiUser | None:
        self.checks += 1
        user = self._users.get(name)
        return user if password == PASSWORD else None


async def _echo(request: Request) -> Response:
    caller = caller_of(request.scope)
    body = (await request.body()).decode()
    return JSONResponse({"who": caller.name, "role": caller.level.role, "body": body, "by": str(caller.writer)})


async def _wait(request: Request) -> Response:
    await asyncio.sleep(float(request.query_params.get("wait_s", "0")))
    return await _echo(request)


async def _talk(socket: WebSocket) -> None:
    await socket.accept()
    try:
        while True:
            await socket.send_text("data")
            await socket.receive_text()
    except WebSocketDisconnect:
        pass


def stand_ins(logins: Logins) -> FastAPI:
    """A route for each rule; those of the login are the real ones."""
    made = list(login.ADDRESSES.routes)
    for rule in RULES:
        if rule.method == "WS":
            made.append(WebSocketRoute(rule.path, _talk))
        elif rule not in login.ADDRESSES.rules:
            made.append(Route(rule.path, _wait, methods=[rule.method]))
    app = FastAPI(routes=made, exception_handlers=HANDLERS)
    app.state.logins, app.state.bays = logins, BAYS
    return app


@dataclass
class SecuredApp:
    """The security middleware with its audit records."""

    config: HmiConfig
    records: list[AuditRecord] = field(default_factory=list)
    app: ASGIApp | None = None
    quick: bool = True
    real_time: bool = False

    def __post_init__(self) -> None:
        clock = SystemClock() if self.real_time else LoopClock()
        self.logins = Logins(self.config, clock, self.records.append, instance="g1")
        if self.quick:
            self.logins.passwords = QuickPasswords(self.config.users)
        app = self.app or stand_ins(self.logins)
        self.middleware = SecurityMiddleware(app, RULES, self.logins, clock)

    @property
    def checks(self) -> int:
        """Passwords that have been checked."""
        assert isinstance(self.logins.passwords, QuickPasswords)
        return self.logins.passwords.checks

    def kinds(self) -> list[AuditKind]:
        return [record.kind for record in self.records]


def secured_app(without_login: str = "driver", **keys: Any) -> SecuredApp:
    """On 10.0.0.5, without TLS, with vera (viewer) and tom (technician); `keys` as in `[hmi]`."""
    users = keys.pop("users", USERS)
    keys = {"host": "10.0.0.5", "without_login": without_login, **keys}
    return SecuredApp(HmiConfig.model_validate({"users": users, **keys}))


@dataclass
class Browser:
    """Keeps its cookies; sends Host, and Origin where a browser does."""

    secured_app: SecuredApp
    address: str = "10.0.0.99"
    host: str = HOST
    scheme: str = "http"
    cookies: dict[str, str] = field(default_factory=dict)
    csrf: str = ""

    async def get(self, path: str, headers: Mapping[str, str] | None = None, *, method: str = "GET") -> Answer:
        return await self.call(method, path, headers or {})

    async def delete(self, path: str, headers: Mapping[str, str] | None = None) -> Answer:
        """As `post`, without a body."""
        sent = {"origin": f"{self.scheme}://{self.host}", "x-csrf-token": self.csrf}
        return await self.call("DELETE", path, {**sent, **(headers or {})})

    async def post(self, path: str, body: object = None, headers: Mapping[str, str] | None = None) -> Answer:
        """With everything that an honest page sends; a header with the value "-" is left out."""
        sent = {"origin": f"{self.scheme}://{self.host}", "content-type": "application/json", "x-csrf-token": self.csrf}
        return await self.call("POST", path, {**sent, **(headers or {})}, json.dumps(body or {}).encode())

    async def login(self, name: str, password: str = PASSWORD, **more: object) -> Answer:
        self.csrf = (await self.get("/api/session")).json["csrf"]
        answer = await self.post("/api/login", {"name": name, "password": password, **more})
        if answer.status == 200:
            self.csrf = answer.json["csrf"]
        return answer

    async def call(self, method: str, path: str, headers: Mapping[str, str], body: bytes | None = None) -> Answer:
        return await self.raw(method, path, self._headers(headers, body), [body or b""])

    def signed(self) -> Headers:
        """The headers of a POST, but for the length of its body."""
        return self._headers({"origin": ORIGIN, "x-csrf-token": self.csrf})

    async def raw(self, method: str, path: str, headers: Headers, parts: Sequence[bytes]) -> Answer:
        scope = asgi.scope("http", path, headers, address=self.address, scheme=self.scheme)
        answer = await answer_to(self.secured_app.middleware, method, scope, parts)
        for name, morsel in SimpleCookie(answer.headers.get("set-cookie", "")).items():
            if morsel.value:
                self.cookies[name] = morsel.value
            else:
                self.cookies.pop(name, None)
        return answer

    async def socket(self, path: str, headers: Mapping[str, str] | None = None) -> "Socket":
        """A WebSocket, after the server's first word."""
        sent = {"origin": f"{self.scheme}://{self.host}", **(headers or {})}
        scope = asgi.scope("websocket", path, self._headers(sent), address=self.address, scheme=self.scheme)
        made = Socket(self.secured_app.middleware, scope)
        await made.settle()
        return made

    def _headers(self, more: Mapping[str, str], body: bytes | None = None) -> Headers:
        sent = {"host": self.host}
        if self.cookies:
            sent["cookie"] = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        if body is not None:
            sent["content-length"] = str(len(body))
        sent.update(more)
        return [(key.encode(), value.encode("latin-1")) for key, value in sent.items() if value != "-"]


class Socket:
    """The page's end of a WebSocket."""

    def __init__(self, app: ASGIApp, scope: dict[str, Any]) -> None:
        self.sent: list[Message] = []
        self._inbox: asyncio.Queue[Message] = asyncio.Queue()
        self._inbox.put_nowait({"type": "websocket.connect"})
        scope = {**scope, "subprotocols": [], "extensions": {"websocket.http.response": {}}}
        self.task = asyncio.get_running_loop().create_task(self._run(app, scope))

    async def _run(self, app: ASGIApp, scope: dict[str, Any]) -> None:
        async def send(message: Any) -> None:
            self.sent.append(message)

        await app(scope, self._inbox.get, send)

    async def settle(self) -> None:
        for _ in range(20):
            await asyncio.sleep(0)

    async def say(self, text: str = "next") -> None:
        self._inbox.put_nowait({"type": "websocket.receive", "text": text})
        await self.settle()

    async def leave(self) -> None:
        self._inbox.put_nowait({"type": "websocket.disconnect", "code": 1001})
        await self.task

    @property
    def data(self) -> int:
        """Messages with data so far."""
        return sum(message["type"] == "websocket.send" for message in self.sent)

    @property
    def status(self) -> int | None:
        """101 when open, the HTTP status of a refusal, None: nothing yet."""
        for message in self.sent:
            if message["type"] == "websocket.accept":
                return 101
            if message["type"] == "websocket.http.response.start":
                return int(message["status"])
        return None

    @property
    def closed(self) -> int | None:
        return next((message["code"] for message in self.sent if message["type"] == "websocket.close"), None)


def example(rule: Rule) -> str:
    """A path that fits."""
    named = rule.path.replace("{bay}", "north").replace("{alarm}", "7").replace("{name}", "technician")
    return named.replace("{path:path}", "lib/api.js")
