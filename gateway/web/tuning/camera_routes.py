"""The addresses of the camera's controls, /api/bays/{bay}/camera: read, tried while a function check is on."""

import asyncio
from collections.abc import Container
from typing import Literal

from pydantic import Field

from gateway.config import ControlsConfig
from gateway.config.sections.vision import BeaconConfig, CropConfig
from gateway.vision.source.v4l2_controls import AUTOMATIC_OF, CONTROLS, FLAGS, MENUS, OfferedControl, in_file
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses
from gateway.web.ipc.messages import CameraControlsNow, ReadControls, TryControls
from gateway.web.server.models import View
from gateway.web.server.services import Bay, RequestCaller, WebServices
from gateway.web.tuning.request_models import Body

ADDRESSES = ApiAddresses(
    "/api/bays/{bay}/camera",
    least=Level.TECHNICIAN,
    errors={404: "no such bay", 503: "the gateway does not answer"},
)
UNITS = {"exposure_time_absolute": "100 µs", "white_balance_temperature": "K"}
LOOK_S, ANSWER_LOOKS = 0.1, 20  # the camera answers with its next frame
Value = bool | int | str


class TryControlsBody(Body):
    """All that is to be tried over the file; an empty table: as the file has it."""

    controls: ControlsConfig = Field(description="the keys of [camera.controls]")


class ControlView(View):
    """One control of the camera, with values as the file has them."""

    name: str
    meaning: str
    kind: Literal["flag", "choice", "number"]
    unit: str
    low: int
    high: int
    step: int
    choices: list[str] = Field(description="of a choice, those within the camera's range")
    automatic: str = Field(description="control that sets this one while it is on; empty: none")
    value: Value
    default: Value
    fixed: Value | None = Field(description="what the file sets; null: nothing")
    tried: bool
    owned: bool = Field(description='`camera.exposure = "marker"` sets it')


class CameraView(View):
    """What the camera has, and is set to."""

    known: bool = Field(description="false: the camera has not answered yet")
    controls: list[ControlView] = Field(description="none: the camera has none that the gateway can set")
    tried: dict[str, Value]
    fault: str = Field(description="what the camera refuses; empty: nothing")
    rotation_deg: int = Field(description="of the file that the gateway was started with")
    crop: CropConfig | None
    beacon: BeaconConfig | None
    blinks: bool | None = Field(description="the ranger's board blinks the beacon's code; null: it has none that can")


@ADDRESSES.get("", "camera", "the camera's controls and what is tried")
async def _camera(services: WebServices, bay: Bay, caller: RequestCaller) -> CameraView:
    now = await services.client.ask(ReadControls(bay.name), CameraControlsNow, caller.writer)
    report, tried, camera = now.report, now.tried.model_dump(exclude_none=True), bay.camera
    return CameraView(
        known=report is not None,
        controls=[]
        if report is None
        else [_view(one, tried, camera.owned_controls) for one in report.offered if one.name in CONTROLS],
        tried=tried,
        fault="" if report is None else report.fault,
        rotation_deg=camera.rotation_deg,
        crop=camera.crop,
        beacon=camera.beacon,
        blinks=bay.ranger.has_beacon if bay.ranger.type == "hcsr04" else None,
    )


@ADDRESSES.post(
    "/try",
    "try_camera",
    "set the camera's controls until the function check ends",
    errors={409: "refused by the main process"},
)
async def _try(services: WebServices, bay: Bay, caller: RequestCaller, body: TryControlsBody) -> CameraView:
    await services.client.command(TryControls(bay.name, body.controls), caller.writer)
    for _ in range(ANSWER_LOOKS):
        view = await _camera(services, bay, caller)
        if view.known:
            break
        await asyncio.sleep(LOOK_S)
    return view


def _view(one: OfferedControl, tried: Container[str], owned: Container[str]) -> ControlView:
    menu = MENUS.get(one.name, ())
    return ControlView(
        name=one.name,
        meaning=ControlsConfig.model_fields[one.name].description or "",
        kind="choice" if menu else "flag" if one.name in FLAGS else "number",
        unit=UNITS.get(one.name, ""),
        low=one.least,
        high=one.most,
        step=one.step,
        choices=list(menu[one.least : one.most + 1]),
        automatic=AUTOMATIC_OF.get(one.name, ""),
        value=in_file(one.name, one.value),
        default=in_file(one.name, one.default),
        fixed=None if one.fixed is None else in_file(one.name, one.fixed),
        tried=one.name in tried,
        owned=one.name in owned,
    )
