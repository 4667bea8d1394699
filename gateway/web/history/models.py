"""The models of what was recorded, as JSON for pages and programs. Pure. Times: Unix time, ms."""

from typing import Literal

from pydantic import Field

from gateway.sinks.mqtt.values import Count
from gateway.sinks.mqtt.visit_payload import VisitPayload
from gateway.web.server.models import DetailedView, View


class RecordsView(View):
    """What there is of one bay."""

    bay: str
    recorded: bool = Field(description="is anything recorded by the configuration?")
    why: str = Field(description="why nothing can be shown; empty: it can")
    first_ms: Count | None = Field(description="the first minute of the index; null: there is none")
    last_ms: Count | None = Field(description="the end of its newest; it grows about once a minute")
    pictures: Literal["shown", "not_kept", "not_for_you"] = Field(description="kept pictures, for this caller")
    alarms: dict[str, str] = Field(description="title of each that visits can be searched by, by its name")


class KeptPictureView(View):
    """One kept picture: `/api/bays/{bay}/kept-pictures/{file}/{place}.jpg`, or `.png`."""

    file: Count = Field(description="number of its file")
    place: Count = Field(description="its place in that file, from 0")
    t_ms: Count = Field(description="when it was taken")
    frame_id: Count
    why: tuple[str, ...] = Field(description="what happened round it")
    changed: str = Field(description="empty: as it came from the camera; blurred: outside records.picture_region_px")


class KeptPicturesView(View):
    """The oldest first."""

    bay: str
    pictures: tuple[KeptPictureView, ...]
    more: bool = Field(description="there are older ones in that time")


class RecordedVisitView(VisitPayload):
    """A visit that is over."""

    unintended: bool = Field(
        description="the truck rolled though it was to stand; not: it left where no PLC writes and none is released"
    )
    picture: KeptPictureView | None = Field(
        description="kept within 2 s of the moment when it was last found in place, the nearest; null: none, or not "
        "for this caller"
    )


class VisitsView(View):
    """The newest first."""

    bay: str
    visits: tuple[RecordedVisitView, ...]
    more: bool = Field(description="there are older ones in that time")


class BucketView(View):
    """A part of the trend. What is left of its length after `recorded_s` was not recorded."""

    t_ms: Count = Field(description="its begin")
    recorded_s: float
    may_move_s: float
    in_place_s: float
    stop_s: dict[str, float] = Field(description="seconds of `stop` by reason")
    frames: Count
    faults: Count = Field(description="sensor faults")
    r_min: float | None = Field(description="px, of frames with a marker; null: none")
    r_mean: float | None
    r_max: float | None
    z_min: float | None = Field(description="mm, of good distances; null: none")
    z_mean: float | None
    z_max: float | None


class TrendView(View):
    """The oldest first. A bucket of which nothing was recorded is left out: a gap."""

    bay: str
    bucket_ms: Count = Field(description="length of each")
    buckets: tuple[BucketView, ...]


class MarkedEventView(DetailedView):
    """An event as the index has it."""

    t_ms: Count
    kind: str
    sensor: str
    quality: str = Field(description="of the sensor; empty: it is of none")


class MarkedEventsView(View):
    """The oldest first."""

    bay: str
    events: tuple[MarkedEventView, ...]
    more: bool = Field(description="there are older ones in that time")
