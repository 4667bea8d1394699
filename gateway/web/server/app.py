"""The pages' application: one table of routes, behind one guard. Assembled here, served by `process`."""

from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from gateway.clock import NS_PER_MS, Clock
from gateway.web.auth import login
from gateway.web.auth.logins import Logins
from gateway.web.auth.refusals import RefusalError, answer
from gateway.web.auth.security import protected
from gateway.web.server import api, openapi, views
from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.live import Live
from gateway.web.server.metrics.family import PageStatistics
from gateway.web.server.pictures import Picture, Pictures
from gateway.web.server.problems import of_starlette
from gateway.web.tuning import routes as tuning_routes
from gateway.web.tuning.service import TuningService

STATIC = Path(str(files("gateway.web") / "static"))


@dataclass(frozen=True, slots=True)
class Services:
    """What the routes work with."""

    client: GatewayClient
    pictures: Pictures
    live: Live
    drivers: Live
    workshop: TuningService


def services_of(client: GatewayClient, pace: Clock) -> Services:
    config = client.about.config.hmi
    return Services(
        client=client,
        pictures=Pictures(client, pace, max_hz=config.picture_max_hz, max_width_px=config.picture_max_width_px),
        live=Live(client, views.live_json, config.max_viewers, config.viewers_per_address),
        drivers=Live(client, views.driver_json, config.max_viewers, config.viewers_per_address),
        workshop=TuningService(client, pace),
    )


def routes(site: Services) -> list[BaseRoute]:
    """Every address there is. Who may call which stands in `access`."""
    return [
        Route("/", _page("index.html")),
        Route("/driver", _page("driver.html")),
        Route("/driver/{bay}", _page("driver.html")),
        Route("/tune/{bay}", _page("tune.html")),
        Route("/login", _page("login.html")),
        Route("/api/bays/{bay}/picture", _picture(site)),
        WebSocketRoute("/api/live", site.live.serve),
        WebSocketRoute("/api/driver", site.drivers.serve),
        *tuning_routes.routes(site.workshop),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]


def app(site: Services, logins: Logins, pace: Clock) -> ASGIApp:
    """All routes behind the guard. Raises GatewayError for a route that has no row in `access`."""
    refusals: Counter[str] = Counter()

    def pages() -> PageStatistics:
        viewers = {"live": site.live.counts, "driver": site.drivers.counts}
        return PageStatistics(viewers, site.pictures.encoded, refusals)

    programs = api.routes(site.client, pages, openapi.document(logins.cookie))
    table = [*routes(site), *login.routes(logins, site.client.bays), *programs]
    problems = {HTTPException: of_starlette, Exception: of_starlette}
    guard = protected(Starlette(routes=table, exception_handlers=problems), table, logins, pace)
    refusals = guard.counts
    return guard


Endpoint = Callable[[Request], Awaitable[Response]]


def _page(name: str) -> Endpoint:
    async def page(request: Request) -> Response:
        return FileResponse(STATIC / name)

    return page


def _picture(site: Services) -> Endpoint:
    async def picture(request: Request) -> Response:
        """The newest frame as JPEG, if it is another than `after`; waits for it. 204: none came."""
        bay = request.path_params["bay"]
        if bay not in site.client.bays:
            return answer(RefusalError(404, "bay", f"there is no bay {bay!r}"))
        try:
            after = int(request.query_params["after"]) if "after" in request.query_params else None
            width_px = int(request.query_params.get("width", "640"))
        except ValueError:
            return answer(RefusalError(400, "number", "after and width: whole numbers"))
        made = await site.pictures.newer(bay, after, width_px)
        if made is None:
            return Response(status_code=204)
        return Response(made.jpeg, media_type="image/jpeg", headers=_told(site.client, made))

    return picture


def _told(client: GatewayClient, picture: Picture) -> dict[str, str]:
    """About the picture, in its headers: so that it can't be taken for another's."""
    age_ms = (client.clock.now_ns() - picture.t_capture_ns) / NS_PER_MS
    headers = {
        "Cache-Control": "no-store",
        "X-Frame-Id": str(picture.seq),
        "X-Frame-Age-Ms": f"{age_ms:.1f}",
        "X-Frame-Size": f"{picture.width_px}x{picture.height_px}",
    }
    if picture.reading is not None:
        headers["X-Frame-View"] = views.frame_json(picture.reading)
    return headers
