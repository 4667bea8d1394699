"""The addresses of devices found and tried, for the pages that set up a bay. `security` has checked who calls."""

from collections.abc import Iterable
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import Query
from starlette.responses import JSONResponse, Response

from gateway.web.auth.access import Level
from gateway.web.auth.addresses import Addresses, whole_number
from gateway.web.auth.refusals import RefusalError
from gateway.web.ipc.devices import (
    CameraSeen,
    Finding,
    FlashRanger,
    FlashSeen,
    FoundDevices,
    FoundNetworkCameras,
    ListDevices,
    ListStreams,
    NetworkStreams,
    RangerSeen,
    SearchNetwork,
    TriedParts,
    TryBroker,
    TryPlc,
)
from gateway.web.ipc.messages import CameraPasswordKept, KeepCameraPassword, ReleaseRanger
from gateway.web.server import lists
from gateway.web.server.services import RequestCaller, Services, WebServices
from gateway.web.setup.device_bodies import BrokerBody, CameraPasswordBody, FlashBody, LookBody, StreamsBody
from gateway.web.setup.device_client import DevicePreview
from gateway.web.tuning.request_models import EmptyBody

ADDRESSES = Addresses("/api/setup")
WRITTEN = ("plc_heartbeat", "plc_control", "recipe_select", "plc_age", "plc_writes", "write_conflicts")
Number = Annotated[int, whole_number(0, 1 << 53)]


@ADDRESSES.get("/devices", Level.TECHNICIAN, "the cameras and serial ports of this machine")
async def _devices(services: WebServices) -> JSONResponse:
    found = await services.devices.ask(ListDevices(), FoundDevices)
    return JSONResponse({"cameras": [*map(asdict, found.cameras)], "ports": [*map(asdict, found.ports)]})


@ADDRESSES.get("/network-cameras", Level.TECHNICIAN, "the network cameras that answer to WS-Discovery; some seconds")
async def _network(services: WebServices) -> JSONResponse:
    found = await services.devices.ask(SearchNetwork(), FoundNetworkCameras)
    return JSONResponse({"cameras": [*map(asdict, found.cameras)]})


@ADDRESSES.post("/streams", Level.TECHNICIAN, "the streams of a network camera, asked by ONVIF")
async def _streams(services: WebServices, body: StreamsBody) -> JSONResponse:
    found = await services.devices.ask(ListStreams(body.service, body.username, body.password), NetworkStreams)
    return JSONResponse({"streams": [*map(asdict, found.streams)], "login": found.login, "why": found.why})


@ADDRESSES.post("/camera-password", Level.TECHNICIAN, "keep a camera's password in a file, for this address alone")
async def _camera_password(services: WebServices, caller: RequestCaller, body: CameraPasswordBody) -> JSONResponse:
    kept = await services.client.ask(KeepCameraPassword(body.url, body.password), CameraPasswordKept, caller.writer)
    return JSONResponse({"password_file": kept.path})


@ADDRESSES.post("/look", Level.TECHNICIAN, "look at a camera or a board that no bay has")
async def _begin(services: WebServices, body: LookBody) -> JSONResponse:
    return _look_json(services.devices.begin(body.question(), body.replaces))


@ADDRESSES.post("/flash", Level.TECHNICIAN, "put the gateway's firmware on an Arduino; followed as a look")
async def _flash(services: WebServices, caller: RequestCaller, body: FlashBody) -> JSONResponse:
    if body.bay:
        await services.client.command(ReleaseRanger(body.bay, body.port), caller.writer)
    return _look_json(services.devices.begin(FlashRanger(body.port, body.bay), body.replaces))


@ADDRESSES.get("/look/{number}", Level.TECHNICIAN, "what is seen of it; waits for more than is known")
async def _news(services: WebServices, number: Number, after: Annotated[Number, Query()] = 0) -> JSONResponse:
    return _look_json(await services.devices.news(number, after))


@ADDRESSES.get("/look/{number}/picture", Level.TECHNICIAN, "the newest picture of a camera that is looked at")
async def _picture(services: WebServices, number: Number) -> Response:
    look = await services.devices.news(number, -1)
    if not isinstance(look.seen, CameraSeen):
        raise RefusalError(404, "no_picture", "it has given no picture yet")
    return Response(look.seen.jpeg, media_type="image/jpeg", headers={"X-Look-Piece": str(look.pieces)})


@ADDRESSES.post("/look/{number}/end", Level.TECHNICIAN, "end a look")
async def _end(services: WebServices, number: Number, body: EmptyBody) -> JSONResponse:
    services.devices.end(number)
    return JSONResponse({})


@ADDRESSES.post("/plc", Level.TECHNICIAN, "try the Modbus port, and show who polls and what was written")
async def _plc(services: WebServices, body: EmptyBody) -> JSONResponse:
    client = services.client
    if client.links_ns is None:
        await client.update_links()
    port = next((server.port for server in client.links.modbus if not server.tls), None)
    found = await services.devices.ask(TryPlc(port), TriedParts)
    await client.update_links()
    servers = [server.model_dump(mode="json") for server in lists.links_view(client).modbus]
    return JSONResponse({"lines": _lines(found.lines), "servers": servers, "writes": _writes(services)})


@ADDRESSES.post("/broker", Level.TECHNICIAN, "log in to an MQTT broker, publish, read back")
async def _broker(services: WebServices, body: BrokerBody) -> JSONResponse:
    found = await services.devices.ask(TryBroker(body.settings()), TriedParts)
    return JSONResponse({"lines": _lines(found.lines)})


def _lines(lines: Iterable[Finding]) -> list[dict[str, Any]]:
    return [asdict(line) for line in lines]


def _look_json(look: DevicePreview) -> JSONResponse:
    seen, figures = look.seen, None
    match seen:
        case CameraSeen():
            figures = {name: getattr(seen, name) for name in seen.__struct_fields__ if name not in ("jpeg", "line")}
        case RangerSeen() | FlashSeen():
            figures = {name: getattr(seen, name) for name in seen.__struct_fields__ if name != "line"}
    return JSONResponse(
        {
            "look": look.number,
            "piece": look.pieces,
            "line": None if seen is None else asdict(seen.line),
            "figures": figures,
            "end": None if look.end is None else asdict(look.end),
        }
    )


def _writes(services: Services) -> list[dict[str, Any]]:
    """By bay, the handshake registers as the PLC has written them."""
    client = services.client
    if not client.about.config.modbus.writes:
        return []
    rows = []
    for bay in client.about.config.bays:
        view = lists.registers_view(client, bay)
        values = {} if view is None else {row.name: row for row in view.registers}
        shown = {name: values[name].value for name in WRITTEN if name in values}
        bits = [bit.name for bit in values["plc_control"].bits if bit.on] if "plc_control" in values else []
        rows.append({"bay": bay.name, "values": shown, "control_bits": bits})
    return rows
