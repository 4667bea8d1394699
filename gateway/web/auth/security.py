"""The security middleware around the pages' application. A request that does not pass it reaches no route.

In this order: what a named proxy says of address and scheme, the Host header (DNS rebinding), the base path, the rule
of the address (`access`), the Origin of what changes anything and of WebSockets, who calls, whether they may, the token
against forged requests, the length of the body. Every answer, refusals too, has the headers of `headers`. When a
session ends, so do its WebSockets and its waiting requests.
"""

import asyncio
import hmac
import re
from collections import Counter
from collections.abc import Iterable, Iterator, MutableMapping, Sequence
from contextlib import contextmanager
from typing import Any

from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from gateway.clock import Clock
from gateway.net import own_host
from gateway.web.auth.access import Level, Rule, find
from gateway.web.auth.audit_log import AuditKind, AuditRecord, printable
from gateway.web.auth.bodies import complete_body
from gateway.web.auth.headers import (
    DOTS,
    cache_control,
    forwarded_for,
    forwarded_scheme,
    header,
    host_allowed,
    same_origin,
    security_headers,
)
from gateway.web.auth.login_throttle import is_of_network, spelled
from gateway.web.auth.logins import CHALLENGE, Logins
from gateway.web.auth.page_files import KEPT, missing_page
from gateway.web.auth.refusals import RefusalError, answer_to, is_missing_page, to_login
from gateway.web.auth.sessions import Caller, with_caller

REQUEST_S = 120.0  # a request must be answered within this, by a route and by the one who reads
EXPORT_S = 630.0  # the same of a file that is taken away
ENDED = 4401  # close code of a WebSocket whose session has ended
OTHER_SITES = (b"cross-site", b"same-site")  # Sec-Fetch-Site: another site, or another origin of this one
BEFORE_REFUSED = ("/healthz", "/api/login")  # of what else needs no login, while nobody has made the first password
UNSAFE_PATH = re.compile(rf"[\x00-\x1f\x7f\\]|{DOTS.pattern}")


class SecurityMiddleware:
    """`counts`: refusals by code, since the start."""

    def __init__(
        self, app: ASGIApp, rules: Sequence[Rule], logins: Logins, clock: Clock, counts: Counter[str] | None = None
    ) -> None:
        self._app = app
        self._logins = logins
        self._clock = clock
        self._rules = rules
        self._config = logins.config
        self._hosts = self._config.hosts
        self._scheme = "https" if self._config.tls else "http"
        self._proxies = frozenset(self._config.trusted_proxies)
        self._headers = security_headers(self._config)
        self._names = {name for name, _ in self._headers} | {b"server", b"cache-control"}
        self._open: dict[str, set[asyncio.Timeout]] = {}  # by session: what ends with it
        self.counts: Counter[str] = Counter() if counts is None else counts
        logins.sessions.ended = self._end

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        scope, scheme = self._as_forwarded(scope)
        path: str = scope["path"]
        below = path.startswith(f"{self._config.base_path}/")
        if below:
            scope["path"] = path[len(self._config.base_path) :]
        outgoing = _Outgoing(self, scope, send)
        address = scope["client"][0] if scope.get("client") else "?"
        caller: Caller | None = None
        try:
            authority = self._check_host(scope, scheme)
            if not below and path == self._config.base_path and scope["type"] == "http":
                await RedirectResponse(f"{path}/", 307)(scope, receive, outgoing)
                return
            if self._config.awaits_first_user:
                self._check_first(scope, address)
            rule = self._find_rule(scope, below)
            self._check_origin(scope, rule, authority, scheme)
            caller = await self._logins.caller(scope["headers"], rule, address, secure=scheme == "https")
            self._check_role(rule, caller)
            if rule.acts:
                self._check_csrf(scope, caller)
            receive = await complete_body(scope, receive, rule, self._clock)
        except RefusalError as refusal:
            await self._refuse(scope, receive, outgoing, refusal, caller, address)
            return
        await self._serve(scope, receive, outgoing, rule, caller)

    def with_headers(self, path: str, headers: Iterable[tuple[bytes, bytes]]) -> list[tuple[bytes, bytes]]:
        """An answer's headers with ours, which hold against the application's own, but for files that never change."""
        own = list(headers)
        kept = [(name, value) for name, value in own if name.lower() not in self._names]
        never_changes = path.startswith("/static/") and (b"cache-control", KEPT) in own
        return [*kept, *self._headers, (b"cache-control", KEPT if never_changes else cache_control(path))]

    def _as_forwarded(self, scope: Scope) -> tuple[Scope, str]:
        """The scope with the client's address and the browser's scheme; the one of http and https that it is."""
        client, scheme = scope.get("client"), self._scheme
        if client and spelled(client[0]) in self._proxies:
            client = forwarded_for(scope["headers"], client[0], self._proxies), 0
            scheme = forwarded_scheme(scope["headers"], scheme)
        kept = scheme if scope["type"] == "http" else scheme.replace("http", "ws")
        return {**scope, "client": client, "scheme": kept}, scheme

    def _check_host(self, scope: Scope, scheme: str) -> str:
        try:
            authority = header(scope["headers"], b"host")
        except ValueError:
            authority = None
        hosts = self._hosts
        if self._config.own_hosts and scope.get("server"):
            hosts = hosts | own_host.request_hosts(scope["server"][0])
        if authority is None or not host_allowed(authority, hosts, scheme):
            text = f"{printable(authority or '(nothing)')} is not a host name of these pages; see hmi.allowed_hosts"
            raise RefusalError(400, "host", text, audited=True)
        return authority

    def _check_first(self, scope: Scope, address: str) -> None:
        """As long as nobody has made the first password: nothing of the plant, and nothing at all beyond this network.
        What needs a role is refused anyway: there is nobody who has one."""
        if not is_of_network(address):
            text = f"{address} is not of a private network: nobody else is answered before there is a first password"
            raise RefusalError(403, "address", text, audited=True)
        if scope["path"] in BEFORE_REFUSED:
            raise RefusalError(401, "login", "nobody has made the first password yet")

    def _find_rule(self, scope: Scope, below: bool) -> Rule:
        path: str = scope["path"] if below else ""
        web_socket = scope["type"] == "websocket"
        method = "WS" if web_socket else scope["method"]
        found = find(method, path, self._rules)
        if found.rule is not None and (found.rule.method == "WS") == web_socket and not UNSAFE_PATH.search(path):
            return found.rule
        allow = ", ".join(sorted({method for method in found.methods if method != "WS"}))
        if allow and not web_socket:
            raise RefusalError(405, "method", f"this address takes {allow}", headers={"Allow": allow})
        raise RefusalError(404, "unknown", "there is no such page")

    def _check_origin(self, scope: Scope, rule: Rule, authority: str, scheme: str) -> None:
        headers = scope["headers"]
        if rule.method != "GET":
            try:
                origin = header(headers, b"origin")
            except ValueError:
                origin = None
            if not same_origin(origin, authority, scheme):
                text = "only the gateway's own pages may request this (Origin)"
                raise RefusalError(403, "origin", text, audited=True)
        elif not rule.page:
            fetched = {name: value for name, value in headers if name in (b"sec-fetch-site", b"sec-fetch-dest")}
            followed = fetched.get(b"sec-fetch-dest") == b"document"  # a link, which shows nothing to who set it
            if fetched.get(b"sec-fetch-site") in OTHER_SITES and not followed:
                raise RefusalError(403, "origin", "not for the pages of others", audited=True)

    def _check_role(self, rule: Rule, caller: Caller) -> None:
        changes = rule.acts and rule.least > Level.OPEN
        if not caller.name and (
            caller.level < rule.least or (changes and caller.level < Level.TECHNICIAN)
        ):  # without a login one may read; changes need a name
            raise RefusalError(401, "login", f"needs a login as {rule.least.role}", headers=_challenge(rule))
        if caller.level < rule.least:
            text = f"{caller.name} is {caller.level.role}; this needs {rule.least.role}"
            raise RefusalError(403, "role", text, audited=not rule.page)

    def _check_csrf(self, scope: Scope, caller: Caller) -> None:
        try:
            token = header(scope["headers"], b"x-csrf-token") or ""
        except ValueError:
            token = ""
        if not hmac.compare_digest(token.encode(), caller.csrf.encode()):
            text = "the X-CSRF-Token is missing or is not that of this login; /api/session returns it"
            raise RefusalError(403, "csrf", text, audited=bool(token))

    async def _refuse(
        self,
        scope: Scope,
        receive: Receive,
        outgoing: "_Outgoing",
        refusal: RefusalError,
        caller: Caller | None,
        address: str,
    ) -> None:
        self.counts[refusal.code] += 1
        if refusal.audited:
            who = caller.name if caller is not None else ""
            what = f"{scope.get('method', 'WS')} {printable(scope['path'])}: {refusal}"
            self._logins.record(AuditRecord(AuditKind.REFUSED, who, address, what))
        response: Response | WebSocketClose = answer_to(scope, refusal)
        if refusal.code in ("login", "role") and scope["type"] == "http":
            rule = find(scope["method"], scope["path"], self._rules).rule
            if rule is not None and rule.page:
                response = to_login(scope, self._config.base_path, need=rule.least.role)
        elif refusal.code == "unknown" and scope["type"] == "http" and is_missing_page(scope):
            first = self._config.awaits_first_user
            response = RedirectResponse("/login", 303) if first else missing_page(self._config.base_path)
        await response(scope, receive, outgoing)

    async def _serve(self, scope: Scope, receive: Receive, outgoing: "_Outgoing", rule: Rule, caller: Caller) -> None:
        session = caller.session
        longest_s = EXPORT_S if rule.exports else REQUEST_S
        limits = [longest_s] if scope["type"] == "http" else []
        if session is not None:
            limits.append(self._logins.remaining_s(session))

        async def received() -> Message:
            message = await receive()
            if session is not None and message["type"] == "websocket.receive":
                self._logins.keep_alive(session)
            return message

        try:
            async with self._clock.timeout(min(limits)) if limits else asyncio.timeout(None) as until:
                with self._until_session_ends(caller, until, rule):
                    await self._app(with_caller(scope, caller), received, outgoing)
        except TimeoutError:
            if not until.expired():
                raise
            await self._abort(scope, receive, outgoing, over=session is not None)
        finally:  # in every case: it may have been done before the error
            changed = rule.acts and rule.audited and not 400 <= outgoing.status < 500
            if rule.least > Level.OPEN and (changed or (rule.exports and outgoing.status < 400)):
                what = f"{scope['path']}: {outgoing.status if outgoing.begun else 'no answer'}"
                self._logins.record(AuditRecord(AuditKind.CHANGED, caller.name, caller.address, printable(what)))

    async def _abort(self, scope: Scope, receive: Receive, outgoing: "_Outgoing", *, over: bool) -> None:
        self.counts["ended" if over else "slow"] += 1
        if outgoing.begun:
            if scope["type"] == "websocket" and not outgoing.closed:
                await outgoing({"type": "websocket.close", "code": ENDED, "reason": "the login has ended"})
            return
        refusal = (
            RefusalError(401, "login", "the login has ended") if over else RefusalError(503, "slow", "not done in time")
        )
        await answer_to(scope, refusal)(scope, receive, outgoing)

    @contextmanager
    def _until_session_ends(self, caller: Caller, until: asyncio.Timeout, rule: Rule) -> Iterator[None]:
        if caller.session is None or rule.acts:  # what was allowed and has begun is not left half done
            yield
            return
        key = caller.session.key
        mine = self._open.setdefault(key, set())
        mine.add(until)
        try:
            yield
        finally:
            mine.discard(until)
            if not mine:
                self._open.pop(key, None)

    def _end(self, key: str) -> None:
        """The session of this key is over: so is everything that it has open for looking."""
        now_s = asyncio.get_running_loop().time()
        for until in self._open.pop(key, ()):
            if not until.expired():
                until.reschedule(now_s)


class _Outgoing:
    """`send` with our headers; remembers whether an answer has begun, and with which status."""

    def __init__(self, middleware: SecurityMiddleware, scope: Scope, send: Send) -> None:
        self._middleware = middleware
        self._path: str = scope["path"]
        self._send = send
        self.begun = False
        self.closed = False
        self.status = 500

    async def __call__(self, message: MutableMapping[str, Any]) -> None:
        if message["type"] in ("http.response.start", "websocket.http.response.start"):
            self.begun, self.status = True, message["status"]
            message = {**message, "headers": self._middleware.with_headers(self._path, message.get("headers", ()))}
        elif message["type"] in ("websocket.accept", "websocket.close"):
            self.begun = True
            self.closed = message["type"] == "websocket.close"
        await self._send(message)


def _challenge(rule: Rule) -> dict[str, str]:
    """Programs get the challenge; a page's script must not make the browser open its own password dialog."""
    return CHALLENGE if rule.path == "/metrics" else {}
