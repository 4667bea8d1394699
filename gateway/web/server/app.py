"""The web process's application: all addresses behind the security middleware. Served by `process`."""

from fastapi import FastAPI
from starlette.types import ASGIApp

from gateway.clock import Clock
from gateway.web.auth import login
from gateway.web.auth.logins import Logins
from gateway.web.auth.security import SecurityMiddleware
from gateway.web.server import api, openapi, pages
from gateway.web.server.problems import HANDLERS
from gateway.web.server.services import Services
from gateway.web.tuning import routes as tuning

GROUPS = (login.ADDRESSES, pages.ADDRESSES, api.ADDRESSES, openapi.ADDRESSES, tuning.ADDRESSES)
RULES = tuple(rule for group in GROUPS for rule in group.rules)


def routes_app(services: Services, logins: Logins) -> FastAPI:
    """Without security. The description is at /api/openapi.json; FastAPI's own pages would load from elsewhere."""
    made = FastAPI(
        routes=[route for group in GROUPS for route in group.routes],
        exception_handlers=HANDLERS,  # type: ignore[arg-type]
        openapi_url=None,
        redirect_slashes=False,
    )
    made.state.services, made.state.logins, made.state.bays = services, logins, services.client.bays
    return made


def app(services: Services, logins: Logins, pace: Clock) -> ASGIApp:
    return SecurityMiddleware(routes_app(services, logins), RULES, logins, pace, services.refusals)


def markdown() -> str:
    """Who may call what, by level, for docs/hmi-security.md."""
    lines = ["| who | method | address | what |", "|---|---|---|---|"]
    for rule in sorted(RULES, key=lambda rule: rule.least):
        who = "everybody" if rule.least == 0 else rule.least.role
        lines.append(f"| {who} | {rule.method} | `{rule.path}` | {rule.summary} |")
    return "\n".join(lines)
