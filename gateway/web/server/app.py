"""The web process's application: all addresses behind the security middleware. Served by `process`.

Exceptions become problem details after RFC 9457.
"""

from typing import Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from gateway.clock import Clock
from gateway.errors import ConfigError, GatewayError, LinkError
from gateway.web.auth import login
from gateway.web.auth.logins import Logins
from gateway.web.auth.refusals import AGAIN, RefusalError, problem
from gateway.web.auth.security import SecurityMiddleware
from gateway.web.calibration import routes as calibration
from gateway.web.calibration.sessions import CalibrationError
from gateway.web.history import routes as history
from gateway.web.history import why
from gateway.web.ipc.messages import ChangedOnDiskError
from gateway.web.manager import routes as manager
from gateway.web.server import api, manual, openapi, pages
from gateway.web.server.gateway_client import RefusedError
from gateway.web.server.pictures import UnencodableError
from gateway.web.server.services import Services
from gateway.web.setup import device_routes as devices
from gateway.web.setup import doctor_routes as doctor
from gateway.web.setup import release_routes as release
from gateway.web.setup import routes as setup
from gateway.web.setup import update_routes as update
from gateway.web.testsets import routes as test_sets
from gateway.web.tuning import camera_routes as camera
from gateway.web.tuning import routes as tuning
from gateway.web.tuning import teach_in_routes as teach_in
from gateway.web.tuning.teach_in import TeachInError
from gateway.web.tuning.trial import EndedError
from gateway.web.tuning.trial_thread import TrialsBusyError

COMPRESSED = ("/static/", "/api/languages/", "/api/setup/settings")
_STATUS: tuple[tuple[type[GatewayError], int, str], ...] = (  # the first that matches: status and code
    (ChangedOnDiskError, 409, "changed"),
    (RefusedError, 409, "refused"),
    (TeachInError, 409, "refused"),
    (CalibrationError, 409, "refused"),
    (ConfigError, 422, "settings"),
    (TrialsBusyError, 503, "busy"),
    (LinkError, 503, "link"),
    (UnencodableError, 500, "fault"),
)


async def of_http(_: Request, error: Exception) -> Response:
    """Starlette's own: no such address, not this method."""
    assert isinstance(error, HTTPException)
    return problem(error.status_code, "http", str(error.detail), error.headers)


async def of_validation(_: Request, error: Exception) -> Response:
    """Every fault with its place. What a body contains is not repeated."""
    assert isinstance(error, RequestValidationError)
    faults = error.errors()
    if faults[0]["loc"][0] != "body":
        return problem(400, "query", "; ".join(map(_query_fault, faults))[:1000])
    return problem(400, "body", "; ".join(map(_body_fault, faults))[:1000])


def _query_fault(fault: dict[str, Any]) -> str:
    return f"{_place(fault)} = {str(fault['input'])[:40]!r}: {_message(fault)}"


def _body_fault(fault: dict[str, Any]) -> str:
    return f"{_place(fault)}: {_message(fault)}"


def _place(fault: dict[str, Any]) -> str:
    if fault["type"] == "json_invalid":
        return "body"
    where: tuple[str, ...] = fault["loc"]
    return ".".join(map(str, where[1:])) or "body"


def _message(fault: dict[str, Any]) -> str:
    context = fault.get("ctx")
    return str(context["error"]) if isinstance(context, dict) and "error" in context else str(fault["msg"])


async def of_gateway(_: Request, error: Exception) -> Response:
    """Raises again what no route should raise: a fault in the software."""
    if isinstance(error, EndedError):
        return Response(status_code=204)  # not an error: the page has sent a newer request meanwhile
    if isinstance(error, RefusalError):
        return problem(error.status, error.code, str(error), error.headers, error.members)
    for kind, status, code in _STATUS:
        if isinstance(error, kind):
            return problem(status, code, str(error), AGAIN if status == 503 else None)
    raise error


async def of_fault(_: Request, error: Exception) -> Response:
    """An unexpected exception; its text is not shown."""
    return problem(500, "fault", "a fault in the software; see the gateway's log")


HANDLERS = {
    HTTPException: of_http,
    RequestValidationError: of_validation,
    GatewayError: of_gateway,
    Exception: of_fault,
}

GROUPS = (  # in the order of docs/openapi.json
    login.ADDRESSES, pages.ADDRESSES, api.ADDRESSES, history.ADDRESSES, why.ADDRESSES, manager.ADDRESSES,
    tuning.ADDRESSES, test_sets.ADDRESSES, teach_in.ADDRESSES, calibration.ADDRESSES, camera.ADDRESSES,
    devices.ADDRESSES, setup.ADDRESSES, release.ADDRESSES, update.ADDRESSES, doctor.ADDRESSES, openapi.ADDRESSES,
    manual.ADDRESSES,
)  # fmt: skip
RULES = tuple(rule for group in GROUPS for rule in group.rules)
ROUTES = tuple(route for group in GROUPS for route in group.routes)


class _Compressing(GZipMiddleware):
    """Only answers without secrets, of which their length would tell; pictures are compressed already."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        compressed = scope["path"].startswith(COMPRESSED)
        await (super().__call__ if compressed else self.app)(scope, receive, send)


def routes_app(services: Services, logins: Logins) -> FastAPI:
    """Without security. The description is at /api/openapi.json; FastAPI's own pages would load from elsewhere."""
    made = FastAPI(
        routes=list(ROUTES),
        exception_handlers=HANDLERS,  # type: ignore[arg-type]
        openapi_url=None,
        redirect_slashes=False,
    )
    made.add_middleware(_Compressing, minimum_size=1000, compresslevel=6)
    made.state.services, made.state.logins = services, logins
    made.state.bays = {bay.name: bay.title for bay in services.client.about.config.bays}
    return made


def app(services: Services, logins: Logins, pace: Clock) -> ASGIApp:
    return SecurityMiddleware(routes_app(services, logins), RULES, logins, pace, services.refusals)
