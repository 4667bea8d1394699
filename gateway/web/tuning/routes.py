"""The tuning page's addresses below /api/bays/{bay}/. `security` has checked who calls."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from fastapi import Depends, Query
from starlette.responses import JSONResponse, PlainTextResponse, Response

from gateway.config import VisionConfig
from gateway.core.state import FunctionCheck
from gateway.errors import ConfigError
from gateway.vision.transport.ring import Snapshot
from gateway.web.auth.access import BODY_BYTES, PROFILE_BYTES, Level
from gateway.web.auth.addresses import Addresses, Endpoint, whole_number
from gateway.web.auth.refusals import RefusalError
from gateway.web.auth.sessions import Caller
from gateway.web.ipc.messages import FilePreview, FileSaved, FileSettings, PreviewFile, ReadFile, SaveFile
from gateway.web.profile import parameter_schema, profile
from gateway.web.server.gateway_client import Result
from gateway.web.server.services import Bay, RequestCaller, WebServices
from gateway.web.tuning import response_models
from gateway.web.tuning.request_models import (
    ApplyBody,
    EmptyBody,
    EyedropperBody,
    FrameBody,
    FunctionCheckBody,
    ImportBody,
    RecordBody,
    SaveBody,
    SettingsBody,
    TrialBody,
)
from gateway.web.tuning.service import TuningService
from gateway.web.tuning.snapshots import Capture, described

PICTURE_PX = 1280  # width of a kept frame's picture, unless requested otherwise
MIN_PX, MAX_PX = 80, 4096
ADDRESSES = Addresses("/api/bays/{bay}")

Number = Annotated[int, whole_number(0, 1 << 53)]
WidthPx = Annotated[int, whole_number(MIN_PX, MAX_PX), Query()]


@dataclass(frozen=True, slots=True)
class TuningRequest:
    """One request about one bay."""

    service: TuningService
    bay: str
    caller: Caller

    def capture(self, name: str) -> Capture:
        capture = self.service.store.get(self.bay, name)
        if capture is None:
            raise RefusalError(404, "gone", f"{name} is not kept (any more): freeze or record again")
        return capture

    async def frames(self, body: FrameBody) -> tuple[Sequence[Snapshot], int]:
        """Frames, and which of them is used. No frames: live, and none is available at this moment."""
        if body.live:
            newest = await self.service.newest(self.bay)
            return ([] if newest is None else [newest]), 0
        frames = self.capture(body.snapshot or body.recording or "").frames
        return frames, min(body.frame, len(frames) - 1)

    async def settings(self, given: dict[str, Any]) -> VisionConfig:
        return parameter_schema.validated(given, await self.service.in_force(self.bay))

    async def about_file(self, action: ReadFile | PreviewFile | SaveFile, kind: type[Result]) -> Result:
        return await self.service.client.about_file(action, kind, self.caller.writer)

    def who(self, tab: str) -> str:
        session = self.caller.session
        return f"{self.caller.address} {session.key if session else ''} {self.bay} {tab}"


async def _request(services: WebServices, bay: Bay, caller: RequestCaller) -> TuningRequest:
    return TuningRequest(services.tuning, bay.name, caller)


Tuning = Annotated[TuningRequest, Depends(_request)]


def _get(path: str, summary: str) -> Callable[[Endpoint], Endpoint]:
    return ADDRESSES.get(path, Level.TECHNICIAN, summary)


def _post(path: str, summary: str) -> Callable[[Endpoint], Endpoint]:
    return ADDRESSES.post(path, Level.TECHNICIAN, summary)


def _try(path: str, summary: str, body_bytes: int = BODY_BYTES) -> Callable[[Endpoint], Endpoint]:
    """Changes nothing but what its own page shows: not in the audit log."""
    return ADDRESSES.post(path, Level.TECHNICIAN, summary, body_bytes=body_bytes, audited=False)


@_post("/function-check", "begin or end a function check")
async def _function_check(request: Tuning, body: FunctionCheckBody) -> JSONResponse:
    await request.service.check(request.bay, FunctionCheck[body.mode.upper()], request.caller.writer)
    return await _profile(request)


@_try("/freeze", "keep the newest frame to try settings on")
async def _freeze(request: Tuning, body: EmptyBody) -> JSONResponse:
    return JSONResponse(described(await request.service.freeze(request.bay)))


@_try("/record", "keep the frames of the next few seconds")
async def _record(request: Tuning, body: RecordBody) -> JSONResponse:
    return JSONResponse(described(await request.service.record(request.bay, body.seconds)))


@_get("/taken", "the kept frames and recordings")
async def _taken(request: Tuning) -> JSONResponse:
    return JSONResponse([described(capture) for capture in request.service.store.of(request.bay)])


@_get("/taken/{name}/{frame}", "one of these frames as a picture")
async def _frame(request: Tuning, name: str, frame: Number, width: WidthPx = PICTURE_PX) -> Response:
    capture = request.capture(name)
    if frame >= len(capture.frames):
        raise RefusalError(400, "number", f"a whole number from 0 to {len(capture.frames) - 1}")
    jpeg = await request.service.picture(request.who(f"{capture.name}/{frame}/{width}"), capture.frames[frame], width)
    return Response(jpeg, media_type="image/jpeg")


@_try("/trial", "try settings on a kept frame or a recording")
async def _trial(request: Tuning, body: TrialBody) -> Response:
    frames, shown = await request.frames(body)
    if not frames:
        return Response(status_code=204)  # a page with the live picture requests again
    made = await request.service.try_(
        request.who(body.tab),
        request.bay,
        frames,
        await request.settings(body.vision),
        shown=shown,
        timed=body.timed,
        width_px=body.width_px,
        with_frame=body.live,
    )
    return JSONResponse(response_models.tried(request.bay, made))


@_get("/trial/{number}/{panel}", "a stage of a trial as a picture")
async def _panel(request: Tuning, number: Number, panel: str) -> Response:
    found = request.service.panel(request.bay, number, panel)
    if found is None:
        raise RefusalError(404, "gone", "this trial's pictures are not kept any more")
    return Response(found[0], media_type=found[1])


@_try("/eyedropper", "the red ranges that would admit a place in a frame")
async def _eyedropper(request: Tuning, body: EyedropperBody) -> Response:
    frames, at = await request.frames(body)
    if not frames:
        return Response(status_code=204)
    settings = await request.settings(body.vision)
    try:
        made = await request.service.pick(
            request.who(body.tab), frames[at], (body.u_px, body.v_px), body.size_px, settings, body.mode
        )
    except ValueError as error:
        raise RefusalError(422, "beside", str(error)) from None
    return JSONResponse(response_models.picked(made))


@_get("/profile", "the settings in force, and what may be set")
async def _profile(request: Tuning) -> JSONResponse:
    in_force = await request.service.in_force(request.bay)
    file = await _file(request, in_force)
    schema = [asdict(key) for key in parameter_schema.schema()]
    return JSONResponse({**_settings(request, in_force), "schema": schema, "file": file})


async def _file(request: TuningRequest, in_force: VisionConfig) -> dict[str, object]:
    """Where saving would write to, what prevents it, and which keys differ from the file."""
    path = request.service.file or None
    try:
        found = await request.about_file(ReadFile(request.bay), FileSettings)
    except ConfigError as error:
        return {"path": path, "why_not": str(error), "unsaved": []}
    return {"path": path, "why_not": found.why_not, "unsaved": list(parameter_schema.changes(found.vision, in_force))}


def _settings(request: TuningRequest, in_force: VisionConfig) -> dict[str, Any]:
    service, bay = request.service, request.bay
    return {
        "vision": parameter_schema.values(in_force),
        "function_check": service.function_check(bay).name.lower(),
        "undo_steps": service.undo_steps(bay),
    }


@_get("/profile/export", "the settings in force as a file")
async def _export(request: Tuning) -> Response:
    return _exported(request, await request.service.in_force(request.bay))


@_try("/profile/export", "other settings as a file")
async def _export_draft(request: Tuning, body: SettingsBody) -> Response:
    return _exported(request, await request.settings(body.vision))


def _exported(request: TuningRequest, settings: VisionConfig) -> Response:
    client = request.service.client
    text = profile.export(request.bay, settings, site=client.about.config.site, wall_ns=client.clock.wall_ns())
    headers = {"Content-Disposition": f'attachment; filename="vision-{request.bay}.toml"'}
    return PlainTextResponse(text, media_type="application/toml", headers=headers)


@_try("/profile/import", "read settings from a file", PROFILE_BYTES)
async def _import(request: Tuning, body: ImportBody) -> JSONResponse:
    """Checked and returned: nothing is applied, nothing is written."""
    in_force = await request.service.in_force(request.bay)
    settings = await request.service.imported(request.bay, body.text, body.name)
    changes = list(parameter_schema.changes(in_force, settings))
    return JSONResponse({"vision": parameter_schema.values(settings), "changes": changes})


@_try("/profile/diff", "what saving would change")
async def _diff(request: Tuning, body: SettingsBody) -> JSONResponse:
    settings = await request.settings(body.vision)
    planned = await request.about_file(PreviewFile(request.bay, settings), FilePreview)
    return JSONResponse(
        {
            "path": request.service.file,
            "diff": planned.diff,
            "changes": list(planned.changes),
            "digest": planned.digest,
            "why_not": planned.why_not,
        }
    )


@_post("/profile/apply", "let settings go live")
async def _apply(request: Tuning, body: ApplyBody) -> JSONResponse:
    settings = await request.settings(body.vision)
    over = None if body.over is None else await request.settings(body.over)
    in_force = await request.service.apply(request.bay, settings, request.caller.writer, over)
    return JSONResponse(_settings(request, in_force))


@_post("/profile/undo", "go back to the settings before")
async def _undo(request: Tuning, body: EmptyBody) -> JSONResponse:
    settings = await request.service.undo(request.bay, request.caller.writer)
    if settings is None:
        raise RefusalError(409, "undo", "there is nothing to go back to")
    return JSONResponse(_settings(request, settings))


@_post("/profile/save", "write settings into the configuration")
async def _save(request: Tuning, body: SaveBody) -> JSONResponse:
    settings = await request.settings(body.vision)
    saved = await request.about_file(SaveFile(request.bay, settings, body.digest), FileSaved)
    return JSONResponse({"path": request.service.file, "changes": list(saved.changes), "backup": saved.backup})
