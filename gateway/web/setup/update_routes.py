"""The update page's addresses: a package in pieces, a request for the root part, and what that shows. `security` has
checked who calls."""

import base64
import binascii
from typing import Annotated, Literal

from pydantic import Field

from gateway.errors import ProtocolError
from gateway.update_request import MAX_PACKAGE_BYTES, NAME_PATTERN, UpdateRequest
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses
from gateway.web.auth.refusals import RefusalError
from gateway.web.helper_client import UPDATES
from gateway.web.ipc.updates import (
    PIECE_BYTES,
    UPDATE_NOW,
    AskUpdate,
    ReadUpdate,
    TakePiece,
    UpdateNow,
    UpdatesQuestion,
)
from gateway.web.server.models import View
from gateway.web.server.services import Services, WebServices
from gateway.web.tuning.request_models import Body

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
MAX_TEXT = 4 * -(-PIECE_BYTES // 3)  # characters of base64
ADDRESSES = ApiAddresses(
    "/api/setup/update",
    least=Level.TECHNICIAN,
    errors={
        409: "refused: the text has the reason",
        503: "this gateway was not installed from its package, the page is switched off, or the disk does not answer",
    },
)


class PieceBody(Body):
    """A piece of the package or of its signature; the pieces follow each other."""

    file: Literal["package", "signature"]
    offset: int = Field(ge=0, le=MAX_PACKAGE_BYTES, description="0: begin anew")
    size: int = Field(ge=1, le=MAX_PACKAGE_BYTES, description="of the whole file")
    data: str = Field(min_length=4, max_length=MAX_TEXT, description="base64, at most 1 MiB")


class UpdateBody(Body):
    """What the gateway's root part is asked for. It takes nothing on trust but the package's signature."""

    action: Literal["check", "install", "back"] = Field(description="check: a dry run; back: to the version before")
    bays: list[Name] = Field([], max_length=64, description="in which the new version may decide otherwise")
    alarms: list[Name] = Field([], max_length=64, description="ids of alarms that may be new afterwards")


class ShownUpdateView(View):
    """What the root part shows of the newest update."""

    version: str = Field(description="in use; empty: not known")
    previous: str = Field(description="to which `back` returns; empty: none")
    stage: str = Field(description="docs/update.md has them; empty: there was no update yet")
    old: str
    new: str
    outcome: str = Field(description="abandoned, updated, returned or not_proven; empty: none yet")
    why: str
    differing: list[str] = Field(description="bays in which the new version decides otherwise")
    log: list[str]


class UpdateView(View):
    """Where an update stands."""

    shown: ShownUpdateView
    package_bytes: int = Field(description="uploaded so far")
    signature_bytes: int
    pending: bool = Field(description="a request was not taken yet")


@ADDRESSES.get("", "update", "where an update stands")
async def _update(services: WebServices) -> UpdateView:
    return await _asked(services, ReadUpdate())


@ADDRESSES.post(
    "/piece",
    "upload_package",
    "upload a package and its signature, in pieces",
    body_bytes=MAX_TEXT + 4096,
    audited=False,
)
async def _piece(services: WebServices, body: PieceBody) -> UpdateView:
    try:
        data = base64.b64decode(body.data, validate=True)
    except (binascii.Error, ValueError):
        raise RefusalError(400, "body", "data: not base64") from None
    return await _asked(services, TakePiece(body.file, body.offset, body.size), data)


@ADDRESSES.post("", "request_update", "check or install what was uploaded, or return to the version before")
async def _request(services: WebServices, body: UpdateBody) -> UpdateView:
    request = UpdateRequest(action=body.action, bays=tuple(body.bays), alarms=tuple(body.alarms))
    return await _asked(services, AskUpdate(request))


async def _asked(services: Services, question: UpdatesQuestion, data: bytes | None = None) -> UpdateView:
    try:
        now: UpdateNow = UPDATE_NOW.unpacked(await services.updates.ask(question, data))
    except ProtocolError as error:
        raise RefusalError(503, UPDATES.code, str(error)) from None
    return UpdateView.model_validate(now)
