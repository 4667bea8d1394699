"""The addresses of the pages themselves: HTML, live views and their pictures."""

from starlette.requests import Request
from starlette.responses import Response
from starlette.websockets import WebSocket

from gateway.durations import NS_PER_MS
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import Addresses
from gateway.web.auth.page_files import STATIC, page_file
from gateway.web.server import views
from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.pictures import Picture
from gateway.web.server.services import Bay, WebServices

ADDRESSES = Addresses()


def _page(path: str, least: Level, name: str, summary: str) -> None:
    @ADDRESSES.get(path, least, summary)
    async def page(request: Request, services: WebServices) -> Response:
        """Of an unknown bay, too, with 404: the driver's display then shows STOP."""
        bay = request.path_params.get("bay")
        base_path = services.client.about.config.hmi.base_path
        return page_file(STATIC / name, base_path, 200 if bay is None or bay in services.client.bays else 404)


_page("/driver", Level.DRIVER, "driver.html", "the driver's display of the first bay")
_page("/driver/{bay}", Level.DRIVER, "driver.html", "the driver's display")


@ADDRESSES.web_socket("/api/driver", Level.DRIVER, "what the driver's display shows, live")
async def _driver(page: WebSocket, services: WebServices) -> None:
    await services.drivers.serve(page)


_page("/", Level.VIEWER, "index.html", "the operator's page")


_page("/history", Level.VIEWER, "history.html", "the history page")


@ADDRESSES.web_socket("/api/live", Level.VIEWER, "what the operator's page shows, live")
async def _live(page: WebSocket, services: WebServices) -> None:
    await services.live.serve(page)


@ADDRESSES.web_socket("/api/alarms/live", Level.VIEWER, "the alarm that the other pages show first, live")
async def _alarms(page: WebSocket, services: WebServices) -> None:
    await services.alarms.serve(page)


@ADDRESSES.get("/api/bays/{bay}/picture", Level.VIEWER, "the pages' pictures")
async def _picture(services: WebServices, bay: Bay, after: int | None = None, width: int = 640) -> Response:
    """The newest frame as JPEG, if it is another than `after`; waits for it. 204: none came."""
    asked_ns = services.client.clock.now_ns()
    picture = await services.pictures.newer(bay.name, after, width)
    if picture is None:
        return Response(status_code=204)
    return Response(picture.jpeg, media_type="image/jpeg", headers=_headers(services.client, picture, asked_ns))


def _headers(client: GatewayClient, picture: Picture, asked_ns: int) -> dict[str, str]:
    """About the picture: so that it can't be taken for another's."""
    age_ms = (client.clock.now_ns() - picture.t_capture_ns) / NS_PER_MS
    headers = {
        "Cache-Control": "no-store",
        "X-Frame-Id": str(picture.seq),
        "X-Frame-Age-Ms": f"{age_ms:.1f}",
        "X-Frame-Held-Ms": f"{client.age_ms(asked_ns)}",
        "X-Frame-Size": f"{picture.width_px}x{picture.height_px}",
    }
    if picture.reading is not None:
        headers["X-Frame-View"] = views.frame_json(picture.reading)
    return headers


_page("/manager", Level.VIEWER, "manager.html", "the manager's page: what a bay did on some days")
_page("/tune/{bay}", Level.TECHNICIAN, "tune.html", "the technician's page")
_page("/calibrate/{bay}", Level.TECHNICIAN, "calibrate.html", "calibrates a bay's camera with a board")
_page("/setup", Level.TECHNICIAN, "setup.html", "the settings page: every key of the configuration's file")
_page("/setup/release", Level.TECHNICIAN, "release.html", "the checklist up to a bay's release for operation")
_page("/setup/update", Level.TECHNICIAN, "update.html", "puts another version into service, or goes back")
_page("/setup/new-bay", Level.TECHNICIAN, "new-bay.html", "sets up a bay: cameras and boards found, the file saved")
