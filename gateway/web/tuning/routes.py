"""The tuning page's addresses below /api/bays/{bay}/. Uses Starlette; `security` has asked who calls, and may they."""

from collections.abc import Awaitable, Callable, Sequence
from typing import Any, TypeVar

from pydantic import ValidationError
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from gateway.config import VisionConfig
from gateway.core.model import FunctionCheck
from gateway.errors import ConfigError, GatewayError, LinkError
from gateway.vision.transport.ring import Snapshot
from gateway.web.auth.caller import Caller, caller_of
from gateway.web.auth.refusals import RefusalError, answer
from gateway.web.ipc.messages import ChangedOnDiskError
from gateway.web.profile import parameter_schema, profile
from gateway.web.server.gateway_client import RefusedError
from gateway.web.tuning import response_models
from gateway.web.tuning.request_models import (
    ApplyAsked,
    Asked,
    CheckAsked,
    FrameAsked,
    ImportAsked,
    Nothing,
    PickAsked,
    RecordAsked,
    SaveAsked,
    SettingsAsked,
    TrialAsked,
)
from gateway.web.tuning.service import TuningService
from gateway.web.tuning.snapshots import Capture, listing
from gateway.web.tuning.trial import EndedError
from gateway.web.tuning.trial_thread import BusyError

PICTURE_PX = 1280  # width of a kept frame's picture, unless asked otherwise
MIN_PX, MAX_PX = 80, 4096

_ANSWERS: tuple[tuple[type[GatewayError], int, str], ...] = (
    (ChangedOnDiskError, 409, "changed"),
    (RefusedError, 409, "refused"),
    (ConfigError, 422, "settings"),
    (BusyError, 503, "busy"),
    (LinkError, 503, "link"),
)
"""What may go wrong, with the answer's status and its code for programs; the first that fits."""

Does = Callable[["Call"], Awaitable[Response]]
Body = TypeVar("Body", bound=Asked)


class Call:
    """One request, its bay known to exist."""

    def __init__(self, shop: TuningService, request: Request, body: bytes) -> None:
        self.shop = shop
        self.request = request
        self.bay: str = request.path_params["bay"]
        self.caller: Caller = caller_of(request.scope)
        self._body = body

    def asked(self, model: type[Body]) -> Body:
        """The body. Raises RefusalError for anything else than the model."""
        try:
            return model.model_validate_json(self._body or b"{}")
        except ValidationError as error:
            said = "; ".join(
                f"{'.'.join(map(str, fault['loc'])) or 'body'}: {fault['msg']}" for fault in error.errors()
            )
            raise RefusalError(400, "json", said) from None

    def taken(self, name: str) -> Capture:
        taken = self.shop.store.get(self.bay, name)
        if taken is None:
            raise RefusalError(404, "gone", f"{name} is not kept (any more): freeze or record anew")
        return taken

    async def frames(self, asked: FrameAsked) -> tuple[Sequence[Snapshot], int]:
        """Frames, and which of them is looked at. No frames: live, and there is none to be had at this moment."""
        if asked.live:
            newest = await self.shop.newest(self.bay)
            return ([] if newest is None else [newest]), 0
        frames = self.taken(asked.snapshot or asked.recording or "").frames
        return frames, min(asked.frame, len(frames) - 1)

    async def settings(self, given: dict[str, Any]) -> VisionConfig:
        return parameter_schema.validated(given, await self.shop.in_force(self.bay))

    def who(self, tab: str) -> str:
        session = self.caller.session
        return f"{self.caller.address} {session.key if session else ''} {self.bay} {tab}"


def routes(shop: TuningService) -> list[BaseRoute]:
    """To be put among the application's."""
    above = "/api/bays/{bay}"
    table: tuple[tuple[str, str, Does], ...] = (
        ("POST", "/function-check", _function_check),
        ("POST", "/freeze", _freeze),
        ("POST", "/record", _record),
        ("GET", "/taken", _taken),
        ("GET", "/taken/{name}/{frame}", _frame),
        ("POST", "/trial", _trial),
        ("GET", "/trial/{number}/{panel}", _panel),
        ("POST", "/eyedropper", _eyedropper),
        ("GET", "/profile", _profile),
        ("POST", "/profile/apply", _apply),
        ("POST", "/profile/undo", _undo),
        ("POST", "/profile/diff", _diff),
        ("POST", "/profile/save", _save),
        ("GET", "/profile/export", _export),
        ("POST", "/profile/export", _export_draft),
        ("POST", "/profile/import", _import),
    )
    return [Route(above + path, _endpoint(shop, does), methods=[method]) for method, path, does in table]


def _endpoint(shop: TuningService, does: Does) -> Callable[[Request], Awaitable[Response]]:
    async def endpoint(request: Request) -> Response:
        bay = request.path_params["bay"]
        names = [found.name for found in shop.client.about.config.bays]
        if bay not in names:
            return answer(RefusalError(404, "bay", f"there is no bay {bay}"))
        try:
            return await does(Call(shop, request, await request.body()))
        except EndedError:
            return Response(status_code=204)  # no fault: the page has asked for something newer meanwhile
        except GatewayError as error:
            return answer(_refusal(error))

    return endpoint


def _refusal(error: GatewayError) -> RefusalError:
    """Raises whatever nobody expects here: that is a bug."""
    if isinstance(error, RefusalError):
        return error
    for kind, status, code in _ANSWERS:
        if isinstance(error, kind):
            return RefusalError(status, code, str(error), headers={"Retry-After": "1"} if status == 503 else None)
    raise error


async def _function_check(call: Call) -> Response:
    mode = FunctionCheck[call.asked(CheckAsked).mode.upper()]
    await call.shop.check(call.bay, mode, call.caller.writer)
    return await _profile(call)


async def _freeze(call: Call) -> Response:
    call.asked(Nothing)
    (one,) = listing([await call.shop.freeze(call.bay)])
    return JSONResponse(one)


async def _record(call: Call) -> Response:
    (one,) = listing([await call.shop.record(call.bay, call.asked(RecordAsked).seconds)])
    return JSONResponse(one)


async def _taken(call: Call) -> Response:
    return JSONResponse(list(listing(call.shop.store.of(call.bay))))


async def _frame(call: Call) -> Response:
    taken = call.taken(call.request.path_params["name"])
    number = _whole(call.request.path_params["frame"], 0, len(taken.frames) - 1)
    width_px = _whole(call.request.query_params.get("width", str(PICTURE_PX)), MIN_PX, MAX_PX)
    jpeg = await call.shop.picture(call.who(f"{taken.name}/{number}/{width_px}"), taken.frames[number], width_px)
    return Response(jpeg, media_type="image/jpeg")


async def _trial(call: Call) -> Response:
    asked = call.asked(TrialAsked)
    frames, shown = await call.frames(asked)
    if not frames:
        return Response(status_code=204)  # a page that looks at the running picture asks again
    settings = await call.settings(asked.vision)
    made = await call.shop.try_(
        call.who(asked.tab),
        call.bay,
        frames,
        settings,
        shown=shown,
        timed=asked.timed,
        width_px=asked.width_px,
        whole=asked.live,
    )
    return JSONResponse(response_models.tried(call.bay, made))


async def _panel(call: Call) -> Response:
    params = call.request.path_params
    found = call.shop.panel(call.bay, _whole(params["number"], 0, 1 << 53), params["panel"])
    if found is None:
        raise RefusalError(404, "gone", "this trial's pictures are not kept any more")
    return Response(found[0], media_type=found[1])


async def _eyedropper(call: Call) -> Response:
    asked = call.asked(PickAsked)
    frames, at = await call.frames(asked)
    if not frames:
        return Response(status_code=204)
    settings = await call.settings(asked.vision)
    try:
        made = await call.shop.pick(
            call.who(asked.tab), frames[at], (asked.u_px, asked.v_px), asked.size_px, settings, asked.mode
        )
    except ValueError as error:
        raise RefusalError(422, "beside", str(error)) from None
    return JSONResponse(response_models.picked(made))


async def _profile(call: Call) -> Response:
    in_force = await call.shop.in_force(call.bay)
    return JSONResponse(
        {
            **_settings(call, in_force),
            "schema": response_models.schema(),
            "file": await _file(call, in_force),
        }
    )


async def _file(call: Call, in_force: VisionConfig) -> dict[str, object]:
    """Where saving would write to, what stands in the way, and which keys are not as the file has them."""
    path = call.shop.file or None
    try:
        found = await call.shop.client.in_file(call.bay, call.caller.writer)
    except ConfigError as error:
        return {"path": path, "why_not": str(error), "unsaved": []}
    return {"path": path, "why_not": found.why_not, "unsaved": response_models.changes(found.vision, in_force)}


async def _apply(call: Call) -> Response:
    asked = call.asked(ApplyAsked)
    settings = await call.settings(asked.vision)
    over = None if asked.over is None else await call.settings(asked.over)
    return JSONResponse(_settings(call, await call.shop.apply(call.bay, settings, call.caller.writer, over)))


async def _undo(call: Call) -> Response:
    call.asked(Nothing)
    settings = await call.shop.undo(call.bay, call.caller.writer)
    if settings is None:
        raise RefusalError(409, "undo", "there is nothing to go back to")
    return JSONResponse(_settings(call, settings))


def _settings(call: Call, in_force: VisionConfig) -> dict[str, Any]:
    return response_models.settings(in_force, call.shop.function_check(call.bay), call.shop.undo_steps(call.bay))


async def _diff(call: Call) -> Response:
    settings = await call.settings(call.asked(SettingsAsked).vision)
    planned = await call.shop.client.plan(call.bay, settings, call.caller.writer)
    return JSONResponse(
        {
            "path": call.shop.file,
            "diff": planned.diff,
            "changes": list(planned.changes),
            "digest": planned.digest,
            "why_not": planned.why_not,
        }
    )


async def _save(call: Call) -> Response:
    asked = call.asked(SaveAsked)
    settings = await call.settings(asked.vision)
    saved = await call.shop.client.save(call.bay, settings, asked.digest, call.caller.writer)
    return JSONResponse({"path": call.shop.file, "changes": list(saved.changes), "backup": saved.backup})


async def _export(call: Call) -> Response:
    return _exported(call, await call.shop.in_force(call.bay))


async def _export_draft(call: Call) -> Response:
    return _exported(call, await call.settings(call.asked(SettingsAsked).vision))


def _exported(call: Call, settings: VisionConfig) -> Response:
    client = call.shop.client
    text = profile.export(call.bay, settings, site=client.about.config.site, wall_ns=client.clock.wall_ns())
    headers = {"Content-Disposition": f'attachment; filename="vision-{call.bay}.toml"'}
    return PlainTextResponse(text, media_type="application/toml", headers=headers)


async def _import(call: Call) -> Response:
    """Checked, and told back: nothing goes live, nothing is written."""
    asked = call.asked(ImportAsked)
    in_force = await call.shop.in_force(call.bay)
    settings = await call.shop.imported(call.bay, asked.text, asked.name)
    return JSONResponse(
        {"vision": parameter_schema.values(settings), "changes": response_models.changes(in_force, settings)}
    )


def _whole(text: str, low: int, high: int) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 17 and low <= int(text) <= high):
        raise RefusalError(400, "number", f"a whole number from {low} to {high}")
    return int(text)
