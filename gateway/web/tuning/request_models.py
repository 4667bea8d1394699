"""The requests of the tuning page: the bodies of its POSTs, checked strictly. Pure."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from gateway.web.profile.profile import MAX_PROFILE_CHARS
from gateway.web.tuning.snapshots import LONGEST_S
from gateway.web.tuning.stages import LARGEST_PX, WIDTH_PX
from gateway.web.tuning.standing_warnings import MAX_ID
from gateway.web.tuning.uploads import MAX_TEXT

Name = Annotated[str, Field(pattern=r"^[sr][0-9]{1,9}$")]
Tab = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,32}$")]
Accepted = Annotated[
    list[Annotated[str, Field(max_length=MAX_ID)]],
    Field(max_length=64, description="ids of the standing warnings that were read and are accepted"),
]
Vision = Annotated[dict[str, Any], Field(max_length=64)]


class Body(BaseModel):
    """Of a technician's request: nothing more than is described, and of no other type."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class EmptyBody(Body):
    """Nothing more to say."""


class FunctionCheckBody(Body):
    """Begin or end a function check."""

    mode: Literal["off", "may_move_off", "may_move_kept"]


class FreezeBody(Body):
    """Keep a frame."""

    trial: int | None = Field(
        None, ge=0, description="number of a trial on the running picture: its frame; else the newest"
    )


class UploadBody(Body):
    """Keep a picture."""

    name: str = Field(min_length=1, max_length=100, description="of the file, for the list")
    data: str = Field(min_length=4, max_length=MAX_TEXT, description="a JPEG or PNG file in base64")


class RecordBody(Body):
    """Keep the frames of the next seconds."""

    seconds: float = Field(3.0, ge=0.2, le=LONGEST_S, description="for this time")


class FrameBody(Body):
    """Exactly one of: a frozen frame, a recording (with the number of a frame in it), the newest frame there is."""

    snapshot: Name | None = None
    recording: Name | None = None
    live: bool = False
    frame: int = Field(0, ge=0, le=10_000)
    tab: Tab = Field("tab", description="identifies a page: its newer request cancels its older one")

    @model_validator(mode="after")
    def _one(self) -> "FrameBody":
        if (self.snapshot is not None) + (self.recording is not None) + self.live != 1:
            raise ValueError("one of snapshot, recording, live")
        return self


class TrialBody(FrameBody):
    """Try these settings; keys that are left out are as in force."""

    vision: Vision
    timed: bool = Field(False, description="often enough to measure the time, and with a check of the exposure")
    width_px: int = Field(WIDTH_PX, ge=80, le=LARGEST_PX)


class EyedropperBody(FrameBody):
    """What is there in the picture, and which settings of the method would admit it."""

    u_px: float = Field(ge=-1, le=20_000)
    v_px: float = Field(ge=-1, le=20_000)
    size_px: int = Field(9, ge=1, le=201)
    mode: Literal["replace", "widen"] = Field("replace", description="of the paper's ranges")
    vision: Vision


class SettingsBody(Body):
    """Settings to go live, to be compared with the file, or to be exported."""

    vision: Vision


class ApplyBody(SettingsBody):
    over: Vision | None = Field(None, description="what the page takes to be in force; refused where it is not")
    accepted: Accepted = []


class UndoBody(Body):
    """Back to what was in force before."""

    over: Vision | None = Field(None, description="what the page takes to be in force; refused where it is not")


class SaveBody(SettingsBody):
    digest: str = Field(pattern=r"^[0-9a-f]{64}$", description="of the file whose difference was shown")
    accepted: Accepted = []


class ImportBody(Body):
    text: str = Field(max_length=MAX_PROFILE_CHARS)
    name: str = Field("profile", max_length=200, description="of the file, for messages")
