"""Logins, and who sends a request: by cookie, by HTTP Basic, or anonymous. One event loop, no locks."""

import base64
import binascii
import hmac
import secrets
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace

from gateway.clock import Clock
from gateway.config.sections.hmi import HmiConfig, HmiUser
from gateway.durations import NS_PER_S
from gateway.net import rate_limit
from gateway.web.auth.access import Level, Rule
from gateway.web.auth.audit_log import AuditKind, AuditRecord, printable
from gateway.web.auth.headers import Headers, header
from gateway.web.auth.login_throttle import LoginThrottle
from gateway.web.auth.passwords import Passwords
from gateway.web.auth.refusals import RefusalError, throttled
from gateway.web.auth.sessions import Caller, Session, Sessions

MAX_COOKIES = 4096  # characters of the header
MAX_BASIC = 1024
BASIC_CACHE_S = 300  # this long a program that logged in by HTTP Basic is known without checking its password again
MAX_BASIC_CACHE = 64
CHALLENGE = {"WWW-Authenticate": 'Basic realm="gateway", charset="UTF-8"'}

AuditSink = Callable[[AuditRecord], None]


class Logins:
    """`audit` receives each login, failure, refusal and change, limited in rate by kind."""

    def __init__(self, config: HmiConfig, clock: Clock, audit: AuditSink, *, instance: str = "gateway") -> None:
        self.config = config
        self._instance = instance
        self.sessions = Sessions(
            lifetime_ns=round(config.session_hours * 3600 * NS_PER_S),
            idle_ns=round(config.session_idle_minutes * 60 * NS_PER_S),
        )
        self.passwords = Passwords(config.users)
        self._anonymous = Level.OPEN if config.awaits_first_user else Level.of(config.without_login)
        self._throttle = LoginThrottle()
        self._clock = clock
        self._audit = audit
        self._buckets: dict[AuditKind, rate_limit.Bucket] = {}
        self._anonymous_csrf = secrets.token_urlsafe(32)  # no secret: the same for all; foreign pages can't read it
        self._secret = secrets.token_bytes(32)
        self._basic_cache: OrderedDict[bytes, tuple[HmiUser, int]] = OrderedDict()

    def close(self) -> None:
        self.passwords.close()

    def cookie(self, *, secure: bool) -> str:
        """The session's name; ports share cookies. `secure`: the browser uses TLS. `__Host-` needs the path /."""
        prefix = "__Secure-" if self.config.base_path else "__Host-"
        return f"{prefix if secure else ''}{self._instance}-session"

    async def login(self, address: str, name: str, password: str, old: Session | None = None) -> tuple[str, Session]:
        """A new session and its id; `old` ends. Raises RefusalError (401, 429, 503)."""
        user = await self._authenticated(address, name, password)
        if old is not None:
            self.sessions.close(old.key)
        opened = self.sessions.open(user.name, self._level(user), self._clock.now_ns())
        self.record(AuditRecord(AuditKind.LOGIN, user.name, address, f"as {user.role}"))
        return opened

    def resume(self, session: Session) -> None:
        """Whoever had the gateway start again stays logged in, if they are the same user still."""
        user = next((user for user in self.config.users if user.name == session.user), None)
        if user is not None and self._level(user) is session.level:
            self.sessions.resume(session)

    def logout(self, caller: Caller) -> None:
        """Ends the session and all that hangs on it. Without one: nothing to do."""
        if caller.session is not None:
            self.sessions.close(caller.session.key)
            self.record(AuditRecord(AuditKind.LOGOUT, caller.name, caller.address, "by itself"))

    async def caller(self, headers: Headers, rule: Rule, address: str, *, secure: bool) -> Caller:
        """The caller. A cookie that is not valid (any more) is ignored. Raises RefusalError for invalid HTTP Basic."""
        session = self._by_cookie(headers, self.cookie(secure=secure))
        if session is not None:
            return Caller(session.user, session.level, address, session.csrf, session)
        anonymous = Caller("", self._anonymous, address, self._anonymous_csrf)
        if not rule.for_programs:
            return anonymous
        user = await self._by_basic(headers, address)
        return anonymous if user is None else replace(anonymous, name=user.name, level=self._level(user))

    def remaining_s(self, session: Session) -> float:
        """Until the session ends in any case."""
        return self.sessions.remaining_ns(session, self._clock.now_ns()) / NS_PER_S

    def keep_alive(self, session: Session) -> None:
        """Its page has just sent something."""
        self.sessions.keep_alive(session.key, self._clock.now_ns())

    def record(self, record: AuditRecord) -> None:
        """Writes it to the audit log; only counts it where that is full of its kind already."""
        bucket, unreported = rate_limit.take(self._buckets.get(record.kind, rate_limit.Bucket()), self._clock.now_ns())
        self._buckets[record.kind] = bucket
        if unreported is not None:
            self._audit(replace(record, unreported=unreported))

    def _level(self, user: HmiUser) -> Level:
        return max(self._anonymous, Level.of(user.role))

    def _by_cookie(self, headers: Headers, cookie: str) -> Session | None:
        """Checks every cookie of our name: another one planted beside ours must not hide it."""
        now_ns = self._clock.now_ns()
        for key, line in headers:
            if key != b"cookie" or len(line) > MAX_COOKIES:
                continue
            for pair in line.decode("latin-1").split(";"):
                name, _, value = pair.partition("=")
                if name.strip() == cookie and (found := self.sessions.find(value.strip(), now_ns)) is not None:
                    return found
        return None

    async def _by_basic(self, headers: Headers, address: str) -> HmiUser | None:
        try:
            value = header(headers, b"authorization")
            if value is None:
                return None
            scheme, _, text = value.partition(" ")
            if scheme.lower() != "basic" or len(text) > MAX_BASIC:
                raise ValueError("not Basic")
            name, colon, password = base64.b64decode(text.strip(), validate=True).decode().partition(":")
            if not colon:
                raise ValueError("no colon")
        except (ValueError, binascii.Error):
            raise RefusalError(401, "basic", "HTTP Basic, with name and password", headers=CHALLENGE) from None
        now_ns = self._clock.now_ns()
        digest = hmac.digest(self._secret, value.encode(), "sha256")
        user, until_ns = self._basic_cache.get(digest, (None, 0))
        if user is None or until_ns <= now_ns:
            first = user is None
            try:
                user = await self._authenticated(address, name, password)
            except RefusalError as refusal:
                self._basic_cache.pop(digest, None)
                refusal.headers |= CHALLENGE if refusal.status == 401 else {}
                raise
            if first:
                self.record(AuditRecord(AuditKind.LOGIN, user.name, address, f"a program, as {user.role}"))
            self._basic_cache[digest] = (user, self._clock.now_ns() + BASIC_CACHE_S * NS_PER_S)
            while len(self._basic_cache) > MAX_BASIC_CACHE:
                self._basic_cache.popitem(last=False)
        return user

    async def _authenticated(self, address: str, name: str, password: str) -> HmiUser:
        wait_s = self._throttle.attempt(address, name, self._clock.now_ns())
        if wait_s:
            self.record(AuditRecord(AuditKind.LOGIN_THROTTLED, printable(name), address, f"{wait_s} s to wait"))
            raise throttled("failed logins", wait_s)
        user = await self.passwords.check(name, password)
        if user is None:
            self.record(AuditRecord(AuditKind.LOGIN_FAILED, printable(name), address, "wrong name or password"))
            raise RefusalError(401, "login", "wrong name or password")
        self._throttle.succeeded(address, name, self._clock.now_ns())
        return user
