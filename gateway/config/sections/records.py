"""`[records]`: what is recorded of each bay, where, and for how long. Pure."""

from typing import Annotated, Literal

from pydantic import Field

from gateway.config.strict.section import Section

Pixels = Annotated[int, Field(ge=0, le=20_000)]
Length = Annotated[int, Field(ge=1, le=20_000)]


class RecordsConfig(Section):
    """Everything that enters the decision is kept, and pictures round what happened (docs/records.md)."""

    enabled: bool = Field(True, description="false: nothing is recorded, and no recorder process runs")
    folder: str = Field(
        "auto", description="auto: `records` in the folder of `state_dir`; nothing is recorded where that is empty"
    )
    max_mb: int = Field(4000, ge=50, le=10_000_000, description="for each bay; the oldest files are deleted")
    max_days: float = Field(90, ge=0, le=36_500, description="older records are deleted; 0: only max_mb counts")
    visit_days: float = Field(
        730,
        ge=0,
        le=36_500,
        description="visits and the figures of each minute are kept for this time, also when their records are "
        "deleted, in a tenth of max_mb at most; 0: only that counts",
    )
    min_free_percent: float = Field(
        10,
        ge=0,
        le=90,
        description="of the disk, left free: the oldest files are deleted, and then nothing is recorded",
    )
    pictures: bool = Field(True, description="keep pictures round stops, faults, alarms and function checks")
    picture_region_px: tuple[Pixels, Pixels, Length, Length] | None = Field(
        None,
        description="left, top, width, height: outside of it pictures are stored in coarse squares, so that no face "
        "and no number plate is kept; absent: pictures as they are",
    )
    pictures_for: Literal["viewer", "technician", "nobody"] = Field(
        "viewer",
        description="least role that sees kept pictures on the pages, in the API and in reports made there; "
        "nobody: only who may read the files",
    )
    picture_days: float = Field(30, ge=0, le=36_500, description="older pictures are deleted; 0: as long as records")
    picture_mb_per_day: int = Field(
        500, ge=1, le=1_000_000, description="for each bay; when it is used up, one picture a time, then none"
    )
    picture_hz: float = Field(2.0, ge=0.2, le=30, description="pictures a second")
    picture_before_s: float = Field(3.0, ge=0, le=30, description="pictures from this time before; they wait in memory")
    picture_after_s: float = Field(2.0, ge=0, le=60, description="to this time after")
