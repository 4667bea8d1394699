"""The real pages behind their security: every address there is, called by those who may not."""

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute, APIWebSocketRoute
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles

from gateway.config import GatewayConfig, HmiConfig
from gateway.web.auth.logins import Logins
from gateway.web.auth.security import SecurityMiddleware
from gateway.web.server import app
from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.services import services_of
from tests.unit.web.auth import USERS, Browser, QuickPasswords, SecuredApp
from tests.unit.web.gateway_client import plant
from tests.virtual_time import LoopClock, in_virtual_time


@dataclass
class RealApp(SecuredApp):
    """With the web process's own application."""

    client: GatewayClient | None = None

    def __post_init__(self) -> None:
        assert self.client is not None
        clock = LoopClock()
        self.logins = Logins(self.config, clock, self.records.append, instance="g1")
        self.logins.passwords = QuickPasswords(self.config.users)
        made = app.app(services_of(self.client, clock), self.logins, clock)
        assert isinstance(made, SecurityMiddleware)
        self.middleware = made

    def routes(self) -> Iterator[tuple[str, str]]:
        application = self.middleware._app
        assert isinstance(application, FastAPI)
        for route in application.routes:
            match route:
                case APIRoute():
                    yield from ((method, route.path) for method in route.methods or {"(any)"})
                case APIWebSocketRoute():
                    yield "WS", route.path
                case Mount(app=StaticFiles()):
                    yield "GET", route.path + "/{path:path}"
                case _:
                    raise AssertionError(f"a route of an unknown kind: {route!r}")


@asynccontextmanager
async def site(without_login: str = "none") -> AsyncIterator[RealApp]:
    config = HmiConfig.model_validate({"host": "10.0.0.5", "without_login": without_login, "users": USERS})
    async with plant(config=GatewayConfig(hmi=config)) as made:
        yield RealApp(config, client=made.client)


@in_virtual_time
async def test_every_route_has_its_rule_and_no_other() -> None:
    """What each rule lets through: test_auth.py."""
    async with site() as real:
        assert sorted(real.routes()) == sorted((rule.method, rule.path) for rule in app.RULES)
        assert real.middleware._rules is app.RULES


@pytest.mark.parametrize(
    "path",
    ["/static/../web.py", "/static/../../../pyproject.toml", "/static//etc/passwd", "/static/lib/../../web.py",
     "/static/\\..\\web.py", "/static/./../web.py", "/static/", "/static/lib", "/static/web.py"],
)  # fmt: skip
@in_virtual_time
async def test_no_file_but_the_pages_own(path: str) -> None:
    async with site() as real:
        answer = await Browser(real).get(path)
        assert answer.status == 404
        assert "import" not in answer.text


@in_virtual_time
async def test_the_page_of_an_unknown_bay_is_404_and_shows_stop() -> None:
    async with site("driver") as real:
        shown, unknown = await Browser(real).get("/driver/bay1"), await Browser(real).get("/driver/bay9")
        assert (shown.status, unknown.status) == (200, 404)
        assert shown.text == unknown.text
        assert "STOP" in unknown.text


@in_virtual_time
async def test_the_pages_own_files() -> None:
    async with site() as real:
        answer = await Browser(real).get("/static/driver.js")
        assert (answer.status, answer.headers["cache-control"]) == (200, "no-cache")
        assert "javascript" in answer.headers["content-type"]
        again = await Browser(real).get("/static/driver.js", {"if-none-match": answer.headers["etag"]})
        assert (again.status, again.text) == (304, "")
