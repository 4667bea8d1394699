"""The requests about test sets: the bodies of their POSTs, checked strictly. Pure."""

from typing import Annotated

from pydantic import Field, model_validator

from gateway.web.ipc.testsets import MAX_NAME
from gateway.web.tuning.request_models import Body, Name, Vision
from gateway.web.tuning.uploads import MAX_TEXT

SetName = Annotated[str, Field(min_length=1, max_length=MAX_NAME, description="letters, digits, spaces, - and _")]
Pixel = Annotated[float, Field(ge=-100_000, le=100_000)]


class SetBody(Body):
    """Make or rename a test set."""

    name: SetName


class PictureBody(Body):
    """Add a picture: a kept frame, a frame of a recording, or a file."""

    snapshot: Name | None = None
    recording: Name | None = None
    frame: int = Field(0, ge=0, le=10_000, description="of the recording")
    title: str = Field("", max_length=100, description="of the file, for its name")
    data: str | None = Field(None, min_length=4, max_length=MAX_TEXT, description="a JPEG or PNG file in base64")

    @model_validator(mode="after")
    def _one(self) -> "PictureBody":
        if (self.snapshot is not None) + (self.recording is not None) + (self.data is not None) != 1:
            raise ValueError("one of snapshot, recording, data")
        return self


class MarkerBody(Body):
    """Where the marker is: centre and radius of its rim, px; pixel centres lie at integers."""

    u_px: Pixel
    v_px: Pixel
    radius_px: float = Field(gt=0, le=100_000)


class LabelBody(Body):
    """What is in the picture."""

    marker: MarkerBody | None = Field(description="null: no marker")


class ScoreBody(Body):
    """Score these settings beside those in force; keys that are left out are as in force."""

    vision: Vision
