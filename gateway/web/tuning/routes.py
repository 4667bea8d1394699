"""The tuning page's addresses below /api/bays/{bay}/. `security` has checked who calls."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Query
from starlette.responses import PlainTextResponse, Response

from gateway.config import VisionConfig
from gateway.core.state import FunctionCheck
from gateway.errors import ConfigError
from gateway.vision.transport.ring import Snapshot
from gateway.web.auth.access import PROFILE_BYTES, Level
from gateway.web.auth.addresses import ApiAddresses, whole_number
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
from gateway.web.server.models import view_of
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
    MarkerPickView,
    ProfileDiffView,
    ProfileFileView,
    ProfileSavedView,
    ProfileView,
    TrialView,
    VisionInForceView,
)
from gateway.web.tuning.snapshots import Capture
from gateway.web.tuning.standing_warnings import LIVE
from gateway.web.tuning.tuning_service import TuningService
from gateway.web.tuning.uploads import MAX_TEXT, UploadError

PICTURE_PX = 1280  # width of a kept frame's picture, unless requested otherwise
MIN_PX, MAX_PX = 80, 4096
NEWER_S = 3.0  # the main process reports new settings within this
UPLOAD_BYTES = MAX_TEXT + 4096  # with the rest of its request
ADDRESSES = ApiAddresses(
    "/api/bays/{bay}",
    least=Level.TECHNICIAN,
    errors={404: "no such bay", 503: "the gateway has not reported the bay, or is busy"},
)

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
_GONE = {400: "a number out of its range", 404: "no such bay, or it is not kept (any more)"}
_SETTINGS = {422: "these settings are not possible"}
_FILE = _SETTINGS | {422: "these settings are not possible, or the file can't be read or written"}


@ADDRESSES.post(
    "/function-check",
    "function_check",
    "begin or end a function check",
    errors={409: "refused: keys of the bay's decision wait for a restart, or too many commands"},
)
async def _function_check(request: Tuning, body: FunctionCheckBody) -> ProfileView:
    await request.command(SetFunctionCheck(request.bay, FunctionCheck[body.mode.upper()]))
    return await _profile(request)


@ADDRESSES.post(
    "/freeze",
    "freeze",
    "keep the newest frame, or that of a trial, to try settings on",
    errors={404: "no such bay, or the trial's frame is not kept any more"},
    audited=False,
)
async def _freeze(request: Tuning, body: FreezeBody) -> CaptureView:
    capture = await request.service.freeze(request.bay, body.trial)
    if capture is None:
        raise RefusalError(404, "gone", "this picture is not kept any more: it was too long ago; try again")
    return responses.described(capture)


@ADDRESSES.post(
    "/upload",
    "upload",
    "keep a picture from a file, to try settings on",
    errors={422: "it is no picture that can be kept"},
    body_bytes=UPLOAD_BYTES,
    audited=False,
)
async def _upload(request: Tuning, body: UploadBody) -> CaptureView:
    try:
        return responses.described(await request.service.upload(request.bay, body.name, body.data))
    except UploadError as error:
        raise RefusalError(422, "picture", f"{printable(body.name)}: {error}") from None


@ADDRESSES.post("/record", "record", "keep the frames of the next few seconds", audited=False)
async def _record(request: Tuning, body: RecordBody) -> CaptureView:
    return responses.described(await request.service.record(request.bay, body.seconds))


@ADDRESSES.get("/captures", "captures", "the kept frames and recordings")
async def _captures(request: Tuning) -> list[CaptureView]:
    return [responses.described(capture) for capture in request.service.store.of(request.bay)]


@ADDRESSES.get(
    "/captures/{name}/{frame}",
    "capture_frame",
    "one of these frames as a picture",
    errors=_GONE,
    media="image/jpeg",
    empty=_NOT_MEASURED,
)
async def _frame(request: Tuning, name: str, frame: Number, width: WidthPx = PICTURE_PX) -> Response:
    capture = request.capture(name)
    if frame >= len(capture.frames):
        raise RefusalError(400, "query", f"frame: a whole number from 0 to {len(capture.frames) - 1}")
    jpeg = await request.service.picture(request.who(f"{capture.name}/{frame}/{width}"), capture.frames[frame], width)
    return Response(jpeg, media_type="image/jpeg")


@ADDRESSES.post(
    "/trial",
    "trial",
    "try settings on a kept frame or a recording",
    errors=_SETTINGS | {404: "no such bay, or the frames are not kept any more"},
    empty=_NOT_MEASURED,
    audited=False,
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


@ADDRESSES.get(
    "/trial/{number}/{panel}", "trial_panel", "a stage of a trial as a picture", errors=_GONE, media="image/*"
)
async def _panel(request: Tuning, number: Number, panel: str) -> Response:
    found = request.service.panel(request.bay, number, panel)
    if found is None:
        raise RefusalError(404, "gone", "this trial's pictures are not kept any more")
    return Response(found[0], media_type=found[1])


@ADDRESSES.post(
    "/eyedropper",
    "eyedropper",
    "the colour at a place in a frame, and the settings of the method that would admit it",
    errors=_SETTINGS
    | {
        404: "no such bay, or the frames are not kept any more",
        422: "these settings are not possible, or the place is beside the picture",
    },
    empty=_NOT_MEASURED,
    audited=False,
)
async def _eyedropper(request: Tuning, body: EyedropperBody) -> ColourPickView | MarkerPickView | Response:
    frames, at = await request.frames(body)
    if not frames:
        return Response(status_code=204)
    settings = await request.settings(body.vision)
    try:
        return await request.service.pick(
            request.who(body.tab), frames[at], (body.u_px, body.v_px), body.size_px, settings, body.mode
        )
    except ValueError as error:
        raise RefusalError(422, "beside", str(error)) from None


@ADDRESSES.get("/profile", "profile", "the settings in force, and what may be set")
async def _profile(request: Tuning) -> ProfileView:
    file = await _file(request, await request.service.in_force(request.bay))
    return ProfileView(**await _settings(request), schema=parameter_schema.schema(), file=file)


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


@ADDRESSES.get("/profile/export", "export_profile", "the settings in force as a file", media="application/toml")
async def _export(request: Tuning) -> Response:
    return _exported(request, await request.service.in_force(request.bay))


@ADDRESSES.post(
    "/profile/export",
    "export_settings",
    "other settings as a file",
    errors=_SETTINGS,
    media="application/toml",
    audited=False,
)
async def _export_draft(request: Tuning, body: SettingsBody) -> Response:
    return _exported(request, await request.settings(body.vision))


def _exported(request: TuningRequest, settings: VisionConfig) -> Response:
    client = request.service.client
    text = profile.export(request.bay, settings, site=client.about.config.site, wall_ns=client.clock.wall_ns())
    headers = {"Content-Disposition": f'attachment; filename="vision-{request.bay}.toml"'}
    return PlainTextResponse(text, media_type="application/toml", headers=headers)


@ADDRESSES.post(
    "/profile/import",
    "import_profile",
    "read settings from a file",
    errors={422: "what is wrong with the file"},
    body_bytes=PROFILE_BYTES,
    audited=False,
)
async def _import(request: Tuning, body: ImportBody) -> ImportedView:
    """Checked and returned: nothing is applied, nothing is written."""
    in_force = await request.service.in_force(request.bay)
    settings = await request.service.imported(request.bay, body.text, body.name)
    changes = list(parameter_schema.changes(in_force, settings))
    return ImportedView(vision=parameter_schema.values(settings), changes=changes)


@ADDRESSES.post("/profile/diff", "diff_profile", "what saving would change", errors=_FILE, audited=False)
async def _diff(request: Tuning, body: SettingsBody) -> ProfileDiffView:
    settings = await request.settings(body.vision)
    planned = await request.ask(PreviewFile(request.bay, settings), FilePreview)
    return view_of(ProfileDiffView, planned, path=request.service.file)


@ADDRESSES.post(
    "/profile/apply",
    "apply_profile",
    "let settings go live",
    errors=_SETTINGS | {409: f"others are in force than `over`, or no function check, or {warning_gate.REFUSED}"},
)
async def _apply(request: Tuning, body: ApplyBody) -> VisionInForceView:
    settings = await request.settings(body.vision)
    over = None if body.over is None else await request.settings(body.over)
    await request.gate(settings, body.accepted, "go live")
    await request.command(ApplySettings(request.bay, settings, over))
    return VisionInForceView(**await _settings(request))


@ADDRESSES.post(
    "/profile/undo",
    "undo_profile",
    "go back to the settings before",
    errors=_SETTINGS
    | {409: "there is nothing to go back to, or others are in force than `over`, or no function check"},
)
async def _undo(request: Tuning, body: UndoBody) -> VisionInForceView:
    over = None if body.over is None else await request.settings(body.over)
    await request.command(UndoSettings(request.bay, over))
    return VisionInForceView(**await _settings(request))


@ADDRESSES.post(
    "/profile/save",
    "save_profile",
    "write settings into the configuration",
    errors=_FILE | {409: f"the file was changed since it was read, or {warning_gate.REFUSED}"},
)
async def _save(request: Tuning, body: SaveBody) -> ProfileSavedView:
    settings = await request.settings(body.vision)
    await request.gate(settings, body.accepted, "are saved")
    saved = await request.ask(SaveFile(request.bay, settings, body.digest), FileSaved)
    return view_of(ProfileSavedView, saved, path=request.service.file)
