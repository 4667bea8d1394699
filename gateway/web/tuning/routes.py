"""The tuning page's addresses below /api/bays/{bay}/. `security` has checked who calls."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Query
from starlette.responses import PlainTextResponse, Response

from gateway.config import VisionConfig
from gateway.core.state import FunctionCheck
from gateway.errors import ConfigError
from gateway.vision.transport.ring import Snapshot
from gateway.web.auth.access import BODY_BYTES, PROFILE_BYTES, Level
from gateway.web.auth.addresses import Addresses, Description, Endpoint, whole_number
from gateway.web.auth.audit_log import printable
from gateway.web.auth.refusals import RefusalError
from gateway.web.auth.sessions import Caller
from gateway.web.ipc.messages import (
    ApplySettings,
    FilePreview,
    FileSaved,
    FileSettings,
    FormerSettings,
    PreviewFile,
    ReadFile,
    ReadFormerSettings,
    SaveFile,
    SetFunctionCheck,
    UndoSettings,
)
from gateway.web.profile import parameter_schema, profile
from gateway.web.server.gateway_client import Question, Result
from gateway.web.server.services import Bay, RequestCaller, WebServices
from gateway.web.tuning import responses, warning_gate
from gateway.web.tuning.request_models import (
    ApplyBody,
    EyedropperBody,
    FrameBody,
    FreezeBody,
    FunctionCheckBody,
    ImportBody,
    RecordBody,
    SaveBody,
    SettingsBody,
    TrialBody,
    UndoBody,
    UploadBody,
)
from gateway.web.tuning.response_models import (
    CaptureView,
    ColourPickView,
    ImportedView,
    ParameterView,
    ProfileDiffView,
    ProfileFileView,
    ProfileSavedView,
    ProfileView,
    TrialView,
    VisionInForceView,
)
from gateway.web.tuning.service import TuningService
from gateway.web.tuning.snapshots import Capture
from gateway.web.tuning.standing_warnings import LIVE
from gateway.web.tuning.uploads import MAX_TEXT, UploadError

PICTURE_PX = 1280  # width of a kept frame's picture, unless requested otherwise
MIN_PX, MAX_PX = 80, 4096
NEWER_S = 3.0  # the main process reports new settings within this
UPLOAD_BYTES = MAX_TEXT + 4096  # with the rest of its request
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

    async def ask(self, question: Question, kind: type[Result]) -> Result:
        return await self.service.client.ask(question, kind, self.caller.writer)

    async def command(self, action: SetFunctionCheck | ApplySettings | UndoSettings) -> None:
        """Executed, and reported by the main process, so that what is asked next is the new state."""
        client = self.service.client
        await client.command(action, self.caller.writer)
        report = client.report(self.bay)
        await client.newer(self.bay, report.number if report else 0, NEWER_S)

    async def gate(self, settings: VisionConfig, accepted: Sequence[str], what: str) -> None:
        await warning_gate.check(self.service, {self.bay: settings}, accepted, what, self.caller.writer)

    def who(self, tab: str) -> str:
        session = self.caller.session
        return f"{self.caller.address} {session.key if session else ''} {self.bay} {tab}"


async def _request(services: WebServices, bay: Bay, caller: RequestCaller) -> TuningRequest:
    return TuningRequest(services.tuning, bay.name, caller)


Tuning = Annotated[TuningRequest, Depends(_request)]


_NOT_MEASURED = {204: "the live picture has no frame now, or a newer request of the same page has replaced this one"}
_ERRORS = {404: "no such bay", 503: "the gateway has not reported the bay, or is busy"}
_BODY = {400: "the body is not what is described here"}
_GONE = {400: "a number out of its range", 404: "no such bay, or it is not kept (any more)"}
_SETTINGS = _BODY | {422: "these settings are not possible"}
_FILE = _SETTINGS | {422: "these settings are not possible, or the file can't be read or written"}


def _described(
    operation_id: str,
    model: object = None,
    errors: Mapping[int, str] | None = None,
    *,
    media: str | None = None,
    empty: Mapping[int, str] | None = None,
) -> Description:
    return Description(operation_id, model, media, {**_ERRORS, **(errors or {})}, empty=empty or {})


def _get(path: str, summary: str, described: Description) -> Callable[[Endpoint], Endpoint]:
    return ADDRESSES.get(path, Level.TECHNICIAN, summary, described)


def _post(path: str, summary: str, described: Description) -> Callable[[Endpoint], Endpoint]:
    return ADDRESSES.post(path, Level.TECHNICIAN, summary, described)


def _try(
    path: str, summary: str, described: Description, body_bytes: int = BODY_BYTES
) -> Callable[[Endpoint], Endpoint]:
    """Changes nothing but what its own page shows: not in the audit log."""
    return ADDRESSES.post(path, Level.TECHNICIAN, summary, described, body_bytes=body_bytes, audited=False)


@_post(
    "/function-check",
    "begin or end a function check",
    _described(
        "function_check",
        ProfileView,
        _BODY | {409: "refused: keys of the bay's decision wait for a restart, or too many commands"},
    ),
)
async def _function_check(request: Tuning, body: FunctionCheckBody) -> ProfileView:
    await request.command(SetFunctionCheck(request.bay, FunctionCheck[body.mode.upper()]))
    return await _profile(request)


@_try(
    "/freeze",
    "keep the newest frame, or that of a trial, to try settings on",
    _described("freeze", CaptureView, _BODY | {404: "no such bay, or the trial's frame is not kept any more"}),
)
async def _freeze(request: Tuning, body: FreezeBody) -> CaptureView:
    capture = await request.service.freeze(request.bay, body.trial)
    if capture is None:
        raise RefusalError(404, "gone", "this picture is not kept any more: it was too long ago; try again")
    return responses.described(capture)


@_try(
    "/upload",
    "keep a picture from a file, to try settings on",
    _described("upload", CaptureView, _BODY | {422: "it is no picture that can be kept"}),
    UPLOAD_BYTES,
)
async def _upload(request: Tuning, body: UploadBody) -> CaptureView:
    try:
        return responses.described(await request.service.upload(request.bay, body.name, body.data))
    except UploadError as error:
        raise RefusalError(422, "picture", f"{printable(body.name)}: {error}") from None


@_try("/record", "keep the frames of the next few seconds", _described("record", CaptureView, _BODY))
async def _record(request: Tuning, body: RecordBody) -> CaptureView:
    return responses.described(await request.service.record(request.bay, body.seconds))


@_get("/captures", "the kept frames and recordings", _described("captures", list[CaptureView]))
async def _captures(request: Tuning) -> list[CaptureView]:
    return [responses.described(capture) for capture in request.service.store.of(request.bay)]


@_get(
    "/captures/{name}/{frame}",
    "one of these frames as a picture",
    _described("capture_frame", errors=_GONE, media="image/jpeg", empty=_NOT_MEASURED),
)
async def _frame(request: Tuning, name: str, frame: Number, width: WidthPx = PICTURE_PX) -> Response:
    capture = request.capture(name)
    if frame >= len(capture.frames):
        raise RefusalError(400, "query", f"frame: a whole number from 0 to {len(capture.frames) - 1}")
    jpeg = await request.service.picture(request.who(f"{capture.name}/{frame}/{width}"), capture.frames[frame], width)
    return Response(jpeg, media_type="image/jpeg")


@_try(
    "/trial",
    "try settings on a kept frame or a recording",
    _described(
        "trial", TrialView, _SETTINGS | {404: "no such bay, or the frames are not kept any more"}, empty=_NOT_MEASURED
    ),
)
async def _trial(request: Tuning, body: TrialBody) -> TrialView | Response:
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
        picture=body.snapshot or body.recording or LIVE,
    )
    return responses.tried(request.bay, made)


@_get(
    "/trial/{number}/{panel}",
    "a stage of a trial as a picture",
    _described("trial_panel", errors=_GONE, media="image/*"),
)
async def _panel(request: Tuning, number: Number, panel: str) -> Response:
    found = request.service.panel(request.bay, number, panel)
    if found is None:
        raise RefusalError(404, "gone", "this trial's pictures are not kept any more")
    return Response(found[0], media_type=found[1])


@_try(
    "/eyedropper",
    "the red ranges that would admit a place in a frame",
    _described(
        "eyedropper",
        ColourPickView,
        _SETTINGS
        | {
            404: "no such bay, or the frames are not kept any more",
            422: "these settings are not possible, or the place is beside the picture",
        },
        empty=_NOT_MEASURED,
    ),
)
async def _eyedropper(request: Tuning, body: EyedropperBody) -> ColourPickView | Response:
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
    return responses.picked(made)


@_get("/profile", "the settings in force, and what may be set", _described("profile", ProfileView))
async def _profile(request: Tuning) -> ProfileView:
    file = await _file(request, await request.service.in_force(request.bay))
    schema = [ParameterView.model_validate(key) for key in parameter_schema.schema()]
    return ProfileView(**await _settings(request), schema=schema, file=file)


async def _file(request: TuningRequest, in_force: VisionConfig) -> ProfileFileView:
    """Where saving would write to, what prevents it, and which keys differ from the file."""
    path = request.service.file or None
    try:
        found = await request.ask(ReadFile(request.bay), FileSettings)
    except ConfigError as error:
        return ProfileFileView(path=path, why_not=str(error), unsaved=[], waiting=[])
    unsaved = list(parameter_schema.changes(found.vision, in_force))
    return ProfileFileView(path=path, why_not=found.why_not, unsaved=unsaved, waiting=list(found.waiting))


async def _settings(request: TuningRequest) -> dict[str, Any]:
    in_force = await request.service.in_force(request.bay)
    former = await request.ask(ReadFormerSettings(request.bay), FormerSettings)
    before = in_force if former.newest is None else former.newest
    undo = parameter_schema.values(before)
    return {
        "vision": parameter_schema.values(in_force),
        "function_check": request.service.function_check(request.bay).name.lower(),
        "untried": list(former.untried),
        "undo_steps": former.steps,
        "undo": {key: undo[key] for key in parameter_schema.changes(in_force, before)},
    }


@_get("/profile/export", "the settings in force as a file", _described("export_profile", media="application/toml"))
async def _export(request: Tuning) -> Response:
    return _exported(request, await request.service.in_force(request.bay))


@_try(
    "/profile/export",
    "other settings as a file",
    _described("export_settings", errors=_SETTINGS, media="application/toml"),
)
async def _export_draft(request: Tuning, body: SettingsBody) -> Response:
    return _exported(request, await request.settings(body.vision))


def _exported(request: TuningRequest, settings: VisionConfig) -> Response:
    client = request.service.client
    text = profile.export(request.bay, settings, site=client.about.config.site, wall_ns=client.clock.wall_ns())
    headers = {"Content-Disposition": f'attachment; filename="vision-{request.bay}.toml"'}
    return PlainTextResponse(text, media_type="application/toml", headers=headers)


@_try(
    "/profile/import",
    "read settings from a file",
    _described("import_profile", ImportedView, _BODY | {422: "what is wrong with the file"}),
    PROFILE_BYTES,
)
async def _import(request: Tuning, body: ImportBody) -> ImportedView:
    """Checked and returned: nothing is applied, nothing is written."""
    in_force = await request.service.in_force(request.bay)
    settings = await request.service.imported(request.bay, body.text, body.name)
    changes = list(parameter_schema.changes(in_force, settings))
    return ImportedView(vision=parameter_schema.values(settings), changes=changes)


@_try("/profile/diff", "what saving would change", _described("diff_profile", ProfileDiffView, _FILE))
async def _diff(request: Tuning, body: SettingsBody) -> ProfileDiffView:
    settings = await request.settings(body.vision)
    planned = await request.ask(PreviewFile(request.bay, settings), FilePreview)
    return ProfileDiffView(
        path=request.service.file,
        diff=planned.diff,
        changes=list(planned.changes),
        digest=planned.digest,
        why_not=planned.why_not,
    )


@_post(
    "/profile/apply",
    "let settings go live",
    _described(
        "apply_profile",
        VisionInForceView,
        _SETTINGS | {409: f"others are in force than `over`, or no function check, or {warning_gate.REFUSED}"},
    ),
)
async def _apply(request: Tuning, body: ApplyBody) -> VisionInForceView:
    settings = await request.settings(body.vision)
    over = None if body.over is None else await request.settings(body.over)
    await request.gate(settings, body.accepted, "go live")
    await request.command(ApplySettings(request.bay, settings, over))
    return VisionInForceView(**await _settings(request))


@_post(
    "/profile/undo",
    "go back to the settings before",
    _described(
        "undo_profile",
        VisionInForceView,
        _SETTINGS | {409: "there is nothing to go back to, or others are in force than `over`, or no function check"},
    ),
)
async def _undo(request: Tuning, body: UndoBody) -> VisionInForceView:
    over = None if body.over is None else await request.settings(body.over)
    await request.command(UndoSettings(request.bay, over))
    return VisionInForceView(**await _settings(request))


@_post(
    "/profile/save",
    "write settings into the configuration",
    _described(
        "save_profile",
        ProfileSavedView,
        _FILE | {409: f"the file was changed since it was read, or {warning_gate.REFUSED}"},
    ),
)
async def _save(request: Tuning, body: SaveBody) -> ProfileSavedView:
    settings = await request.settings(body.vision)
    await request.gate(settings, body.accepted, "are saved")
    saved = await request.ask(SaveFile(request.bay, settings, body.digest), FileSaved)
    return ProfileSavedView(path=request.service.file, changes=list(saved.changes), previous=saved.previous)
