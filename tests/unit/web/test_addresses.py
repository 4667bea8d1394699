"""An address added from outside the package: one entry makes its route, its rule and its description."""

from typing import Annotated

import pytest
from fastapi import FastAPI, Query
from pydantic import BaseModel

from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses, whole_number
from gateway.web.auth.login import ADDRESSES as LOGIN
from gateway.web.auth.security import SecurityMiddleware
from gateway.web.server.app import HANDLERS
from tests.unit.web.auth import Browser, secured_app
from tests.virtual_time import LoopClock, in_virtual_time

ADDED = ApiAddresses("/api/added", least=Level.VIEWER)


class UptimeView(BaseModel):
    uptime_s: float


class RestartBody(BaseModel):
    reason: str


@ADDED.get("/uptime", "uptime", "how long it has run", errors={400: "a wrong unit"})
async def _uptime(per: Annotated[int, whole_number(1, 60), Query()] = 1) -> UptimeView:
    return UptimeView(uptime_s=120 / per)


@ADDED.post("/restart", "restart", "begin anew", least=Level.TECHNICIAN, body_bytes=32)
async def _restart(body: RestartBody) -> dict[str, str]:
    return {"restarted": body.reason}


@pytest.fixture
def browser() -> Browser:
    """Of a caller without a login."""
    made = secured_app()
    app = FastAPI(routes=[*LOGIN.routes, *ADDED.routes], exception_handlers=HANDLERS)
    app.state.logins, app.state.bays = made.logins, {}
    made.middleware = SecurityMiddleware(app, (*LOGIN.rules, *ADDED.rules), made.logins, LoopClock())
    return Browser(made)


@in_virtual_time
async def test_the_entry_is_the_rule(browser: Browser) -> None:
    assert (await browser.get("/api/added/uptime")).status == 401
    await browser.login("vera")
    assert (await browser.get("/api/added/uptime", {})).json == {"uptime_s": 120.0}
    assert (await browser.post("/api/added/restart", {"reason": "x"})).status == 403
    await browser.login("tom")
    assert (await browser.post("/api/added/restart", {"reason": "x"})).json == {"restarted": "x"}
    assert (await browser.post("/api/added/restart", {"reason": "x" * 32})).status == 413
    assert (await browser.get("/api/added/restart")).status == 405
    assert (await browser.get("/api/added/else")).status == 404


@in_virtual_time
async def test_what_is_wrong_with_a_request_is_named(browser: Browser) -> None:
    await browser.login("tom")
    wrong = await browser.get("/api/added/uptime?per=61")
    assert (wrong.status, wrong.json["error"]) == (400, "query")
    assert wrong.json["detail"] == "per = '61': a whole number from 1 to 60"
    wrong = await browser.post("/api/added/restart", {})
    assert (wrong.status, wrong.json["error"], wrong.json["detail"]) == (400, "body", "reason: Field required")
