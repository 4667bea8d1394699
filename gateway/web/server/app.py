"""The web process's application: all addresses behind the security middleware. Served by `process`."""

from fastapi import FastAPI
from starlette.middleware.gzip import GZipMiddleware
from starlette.types import ASGIApp, Receive, Scope, Send

from gateway.clock import Clock
from gateway.web.auth import common_pages, login
from gateway.web.auth.logins import Logins
from gateway.web.auth.problems import handlers
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
HANDLERS = handlers(
    (EndedError, 204, ""),  # not an error: the page has sent a newer request meanwhile
    (ChangedOnDiskError, 409, "changed"),
    (RefusedError, 409, "refused"),
    (TeachInError, 409, "refused"),
    (CalibrationError, 409, "refused"),
    (TrialsBusyError, 503, "busy"),
    (UnencodableError, 500, "fault"),
)


GROUPS = (  # in the order of docs/openapi.json
    login.ADDRESSES, common_pages.ADDRESSES, pages.ADDRESSES, api.ADDRESSES, history.ADDRESSES, why.ADDRESSES,
    manager.ADDRESSES, tuning.ADDRESSES, test_sets.ADDRESSES, teach_in.ADDRESSES, calibration.ADDRESSES,
    camera.ADDRESSES, devices.ADDRESSES, setup.ADDRESSES, release.ADDRESSES, update.ADDRESSES, doctor.ADDRESSES,
    openapi.ADDRESSES, manual.ADDRESSES,
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
        exception_handlers=HANDLERS,
        openapi_url=None,
        redirect_slashes=False,
    )
    made.add_middleware(_Compressing, minimum_size=1000, compresslevel=6)
    made.state.services, made.state.logins = services, logins
    config = services.client.about.config
    made.state.bays = {bay.name: bay.title for bay in config.bays}
    made.state.base_path, made.state.languages = config.hmi.base_path, services.languages
    return made


def app(services: Services, logins: Logins, pace: Clock) -> ASGIApp:
    return SecurityMiddleware(routes_app(services, logins), RULES, logins, pace, services.refusals)
