"""`/api/login`, `/api/logout`, `/api/session`: JSON, for the pages. `security` has checked each request already."""

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import JSONResponse

from gateway.records.days import known_zone
from gateway.web.auth.access import LOGIN_BYTES, Level
from gateway.web.auth.addresses import Addresses
from gateway.web.auth.headers import safe_next
from gateway.web.auth.logins import Logins
from gateway.web.auth.passwords import MAX_LENGTH
from gateway.web.auth.refusals import RefusalError
from gateway.web.auth.sessions import Caller, caller_of


class LoginBody(BaseModel):
    """What the login page sends."""

    model_config = ConfigDict(extra="forbid", strict=True)

    name: str = Field(max_length=64, description="as in hmi.users")
    password: str = Field(max_length=MAX_LENGTH, repr=False)
    next: str | None = Field(None, max_length=2048, description="the page that was requested before the login")


class SessionView(BaseModel):
    """Who the caller is. Every POST needs `csrf` in the header X-CSRF-Token; it changes with the login."""

    name: str | None = Field(description="null without a login")
    role: str = Field(description="none, driver, viewer or technician: the most that the caller may do")
    can_login: bool = Field(description="there are users")
    first_password: bool = Field(description="there are none yet, and POST /api/setup/first-password makes the first")
    csrf: str
    expires_in_s: int | None = Field(description="until the login ends in any case; null without a login")
    bays: list[str] = Field(description="names, in the configuration's order; empty for role none")
    titles: dict[str, str] = Field(description="of the bays that have one, by name")
    time_zone: str = Field(
        description="of the times on the pages: that of the gateway's machine, by name or offset; empty for role none"
    )
    next: str | None = Field(None, description="after a login: where to go")


ADDRESSES = Addresses()


def _view(request: Request, caller: Caller, next_page: str | None = None) -> dict[str, object]:
    logins: Logins = request.app.state.logins
    bays: dict[str, str] = request.app.state.bays if caller.level > Level.OPEN else {}
    return SessionView(
        name=caller.name or None,
        role=caller.level.role,
        can_login=bool(logins.config.users),
        first_password=logins.config.awaits_first_user,
        csrf=caller.csrf,
        expires_in_s=None if caller.session is None else int(logins.remaining_s(caller.session)),
        bays=list(bays),
        titles={name: title for name, title in bays.items() if title},
        time_zone=known_zone() if bays else "",
        next=next_page,
    ).model_dump()


@ADDRESSES.get("/api/session", Level.OPEN, "who is logged in, and the token against forged requests")
async def _session(request: Request) -> JSONResponse:
    return JSONResponse(_view(request, caller_of(request.scope)))


@ADDRESSES.post("/api/login", Level.OPEN, "log in", body_bytes=LOGIN_BYTES)
async def _login(request: Request) -> JSONResponse:
    caller = caller_of(request.scope)
    logins: Logins = request.app.state.logins
    kind = Headers(scope=request.scope).get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":  # what another site's form can't send
        raise RefusalError(415, "json", "application/json")
    try:
        body = LoginBody.model_validate_json(await request.body())
    except ValidationError as error:
        places = sorted({".".join(map(str, fault["loc"])) or "body" for fault in error.errors()})
        raise RefusalError(400, "body", f"name and password, as text; see {', '.join(places)}") from None
    identity, session = await logins.login(caller.address, body.name, body.password, caller.session)
    new = Caller(session.user, session.level, caller.address, session.csrf, session)
    response = JSONResponse(_view(request, new, safe_next(body.next, logins.config.base_path)))
    secure = request.scope["scheme"] == "https"
    response.set_cookie(
        logins.cookie(secure=secure),
        identity,
        max_age=int(logins.remaining_s(session)),
        path=logins.config.base_path or "/",
        secure=secure,
        httponly=True,
        samesite="strict",
    )
    return response


@ADDRESSES.post("/api/logout", Level.OPEN, "log out", body_bytes=LOGIN_BYTES)
async def _logout(request: Request) -> JSONResponse:
    logins: Logins = request.app.state.logins
    logins.logout(caller_of(request.scope))
    response = JSONResponse({})
    secure = request.scope["scheme"] == "https"
    path = logins.config.base_path or "/"
    response.delete_cookie(logins.cookie(secure=secure), path=path, secure=secure, httponly=True, samesite="strict")
    return response
