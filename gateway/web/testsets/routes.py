"""The addresses of a bay's test sets, /api/bays/{bay}/test-sets. `security` has checked who calls."""

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Path, Query
from starlette.responses import Response

from gateway.config import VisionConfig
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses, whole_number
from gateway.web.auth.refusals import RefusalError
from gateway.web.ipc.testsets import (
    AddPicture,
    DeleteSet,
    MakeSet,
    MarkerPlace,
    RemovePicture,
    RenameSet,
    SetLabel,
    SetsQuestion,
)
from gateway.web.profile import parameter_schema
from gateway.web.server.services import Bay, RequestCaller, WebServices
from gateway.web.testsets import models, pictures
from gateway.web.testsets.models import ProposalView, SetScoreView, TestSetsView
from gateway.web.testsets.request_models import LabelBody, PictureBody, ScoreBody, SetBody
from gateway.web.testsets.scoring_service import ScoringService
from gateway.web.tuning.request_models import EmptyBody
from gateway.web.tuning.tuning_service import TuningService
from gateway.web.tuning.uploads import MAX_TEXT, UploadError

PICTURE_BYTES = MAX_TEXT + 4096  # with the rest of its request
PICTURE_PX = 1280

Name = Annotated[str, Path(min_length=1, max_length=100, description="of the test set")]
File = Annotated[str, Path(min_length=1, max_length=150, description="of the picture")]
WidthPx = Annotated[int, whole_number(32, 4096), Query(description="px; a wider picture is made smaller")]


@dataclass(frozen=True, slots=True)
class SetsRequest:
    """One request about one bay's test sets."""

    sets: ScoringService
    tuning: TuningService
    bay: str
    who: str

    async def change(self, question: SetsQuestion, picture: bytes | None = None) -> TestSetsView:
        made = await self.sets.client.change(question, picture)
        return models.sets_view(made.sets, added=made.added)

    async def settings(self, given: dict[str, Any]) -> VisionConfig:
        return parameter_schema.validated(given, await self.tuning.in_force(self.bay))

    def image_of(self, body: PictureBody) -> tuple[Any, str]:
        """A kept frame, and what its file is to be called."""
        kept = body.snapshot or body.recording or ""
        capture = self.tuning.store.get(self.bay, kept)
        if capture is None:
            raise RefusalError(404, "gone", f"{kept} is not kept (any more): freeze or record again")
        frame = capture.frames[min(body.frame, len(capture.frames) - 1)]
        return frame.image, capture.title or f"frame-{frame.seq}"


async def _request(services: WebServices, bay: Bay, caller: RequestCaller) -> SetsRequest:
    return SetsRequest(services.test_sets, services.tuning, bay.name, caller.address)


Sets = Annotated[SetsRequest, Depends(_request)]

_ERRORS = {404: "no such bay, test set or picture", 503: "no test sets can be kept or read now; `detail` says why"}
_CHANGE = {409: "a limit, a name that is taken or not possible, damaged labels; `detail` says which"}
ADDRESSES = ApiAddresses("/api/bays/{bay}/test-sets", least=Level.TECHNICIAN, errors=_ERRORS)


@ADDRESSES.get("", "test_sets", "the test sets of a bay, and their pictures")
async def _sets(request: Sets) -> TestSetsView:
    if not request.sets.client.kept:
        return models.sets_view((), kept=False)
    return models.sets_view(await request.sets.client.sets(request.bay))


@ADDRESSES.post("", "make_test_set", "make a test set", errors=_CHANGE)
async def _make(request: Sets, body: SetBody) -> TestSetsView:
    return await request.change(MakeSet(request.bay, body.name))


@ADDRESSES.post("/{name}/rename", "rename_test_set", "rename a test set", errors=_CHANGE)
async def _rename(request: Sets, name: Name, body: SetBody) -> TestSetsView:
    made = await request.change(RenameSet(request.bay, name, body.name))
    request.sets.forget(request.bay, name)
    return made


@ADDRESSES.post("/{name}/delete", "delete_test_set", "delete a test set with its pictures", errors=_CHANGE)
async def _delete(request: Sets, name: Name, body: EmptyBody) -> TestSetsView:
    made = await request.change(DeleteSet(request.bay, name))
    request.sets.forget(request.bay, name)
    return made


@ADDRESSES.post(
    "/{name}/pictures", "add_test_picture", "add a picture to a test set", errors=_CHANGE, body_bytes=PICTURE_BYTES
)
async def _add(request: Sets, name: Name, body: PictureBody) -> TestSetsView:
    try:
        if body.data is not None:
            data, title = await pictures.uploaded(request.sets.thread, body.data), body.title
        else:
            image, title = request.image_of(body)
            data = await pictures.file_of(request.sets.thread, image)
    except UploadError as error:
        raise RefusalError(409, "picture", str(error)) from None
    return await request.change(AddPicture(request.bay, name, title), data)


@ADDRESSES.post(
    "/{name}/pictures/{file}/label", "label_test_picture", "say what is in a picture of a test set", errors=_CHANGE
)
async def _label(request: Sets, name: Name, file: File, body: LabelBody) -> TestSetsView:
    marker = body.marker
    place = None if marker is None else MarkerPlace(marker.u_px, marker.v_px, marker.radius_px)
    return await request.change(SetLabel(request.bay, name, file, place))


@ADDRESSES.post(
    "/{name}/pictures/{file}/remove", "remove_test_picture", "remove a picture from a test set", errors=_CHANGE
)
async def _remove(request: Sets, name: Name, file: File, body: EmptyBody) -> TestSetsView:
    return await request.change(RemovePicture(request.bay, name, file))


@ADDRESSES.get("/{name}/pictures/{file}", "test_picture", "a picture of a test set", media="image/jpeg")
async def _picture(request: Sets, name: Name, file: File, width: WidthPx = PICTURE_PX) -> Response:
    data = await request.sets.client.picture(request.bay, name, file)
    try:
        jpeg = await request.sets.shown.jpeg(data, width)
    except UploadError as error:
        raise RefusalError(404, "picture", f"{file}: {error}") from None
    return Response(jpeg, media_type="image/jpeg")


@ADDRESSES.get("/{name}/pictures/{file}/proposal", "propose_label", "where the robust method finds the marker")
async def _proposal(request: Sets, name: Name, file: File) -> ProposalView:
    data = await request.sets.client.picture(request.bay, name, file)
    try:
        found = await request.sets.shown.proposal(data, await request.tuning.in_force(request.bay))
    except UploadError as error:
        raise RefusalError(404, "picture", f"{file}: {error}") from None
    return ProposalView.model_validate(found)


@ADDRESSES.post(
    "/{name}/score",
    "score_test_set",
    "score settings on a test set, beside those in force",
    errors={422: "these settings are not possible"},
    audited=False,
)
async def _score(request: Sets, name: Name, body: ScoreBody) -> SetScoreView:
    settings = await request.settings(body.vision)
    in_force = await request.tuning.in_force(request.bay)
    return models.score_view(await request.sets.begin(request.bay, name, settings, in_force))


@ADDRESSES.get("/{name}/score", "test_set_score", "how far the newest score of a test set is, and its result")
async def _scored(request: Sets, name: Name) -> SetScoreView:
    return models.score_view(request.sets.job(request.bay, name))


@ADDRESSES.post("/{name}/score/cancel", "cancel_test_score", "end a score that runs", audited=False)
async def _cancel(request: Sets, name: Name, body: EmptyBody) -> SetScoreView:
    request.sets.cancel(request.bay, name)
    return models.score_view(request.sets.job(request.bay, name))
