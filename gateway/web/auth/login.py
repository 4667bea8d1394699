"""`/api/login`, `/api/logout`, `/api/session`: JSON, for the pages. Uses Starlette; `security` has looked already."""

from collections.abc import Sequence

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from gateway.web.auth.access import Level
from gateway.web.auth.caller import Caller, caller_of
from gateway.web.auth.logins import Logins
from gateway.web.auth.origins import safe_next
from gateway.web.auth.passwords import MAX_LENGTH
from gateway.web.auth.refusals import RefusalError, answer
from gateway.web.auth.sessions import Session


class LoginBody(BaseModel):
    """What the login page sends."""

    model_config = ConfigDict(extra="forbid", strict=True)

    name: str = Field(max_length=64, description="as in hmi.users")
    password: str = Field(max_length=MAX_LENGTH, repr=False)
    next: str | None = Field(None, max_length=2048, description="the page that was asked for before the login")


class SessionView(BaseModel):
    """Who the caller is. Every POST needs `csrf` in the header X-CSRF-Token; it changes with the login."""

    name: str | None = Field(description="null without a login")
    role: str = Field(description="none, driver, viewer or technician: the most that the caller may do")
    can_login: bool = Field(description="there are users")
    csrf: str
    expires_in_s: int | None = Field(description="until the login ends whatever happens; null without a login")
    bays: list[str] = Field(description="names, in the configuration's order; empty for role none")
    next: str | None = Field(None, description="after a login: where to go")


def routes(logins: Logins, bays: Sequence[str]) -> list[BaseRoute]:
    """To be put among the application's."""

    def view(caller: Caller, next_page: str | None = None) -> dict[str, object]:
        return SessionView(
            name=caller.name or None,
            role=caller.level.role,
            can_login=bool(logins.config.users),
            csrf=caller.csrf,
            expires_in_s=None if caller.session is None else int(logins.left_s(caller.session)),
            bays=list(bays) if caller.level > Level.OPEN else [],
            next=next_page,
        ).model_dump()

    async def session(request: Request) -> Response:
        return JSONResponse(view(caller_of(request.scope)))

    async def login(request: Request) -> Response:
        caller = caller_of(request.scope)
        kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
        if kind != "application/json":
            return answer(RefusalError(415, "json", "application/json"))
        try:
            asked = LoginBody.model_validate_json(await request.body())
        except ValidationError as error:
            places = sorted({".".join(map(str, fault["loc"])) or "body" for fault in error.errors()})
            return answer(RefusalError(400, "json", f"name and password, as text; look at {', '.join(places)}"))
        try:
            identity, opened = await logins.login(caller.address, asked.name, asked.password, caller.session)
        except RefusalError as refusal:
            return answer(refusal)
        new = Caller(opened.user, opened.level, caller.address, opened.csrf, opened)
        response = JSONResponse(view(new, safe_next(asked.next)))
        _set_cookie(response, logins, identity, opened)
        return response

    async def logout(request: Request) -> Response:
        logins.logout(caller_of(request.scope))
        response = JSONResponse({})
        response.delete_cookie(logins.cookie, path="/", secure=logins.config.tls, httponly=True, samesite="strict")
        return response

    return [
        Route("/api/session", session, methods=["GET"]),
        Route("/api/login", login, methods=["POST"]),
        Route("/api/logout", logout, methods=["POST"]),
    ]


def _set_cookie(response: Response, logins: Logins, identity: str, session: Session) -> None:
    response.set_cookie(
        logins.cookie,
        identity,
        max_age=int(logins.left_s(session)),
        path="/",
        secure=logins.config.tls,
        httponly=True,
        samesite="strict",
    )
