"""The addresses of what was recorded: visits, trend, events and kept pictures. IO.

All of it is read by the web process itself, which may read files; nothing here reaches the main process.
"""

from collections.abc import Collection
from pathlib import Path as FilePath
from typing import Annotated, Literal

from fastapi import Query
from starlette.responses import Response

from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.config import GatewayConfig
from gateway.core.events import EventKind
from gateway.core.state import Reason
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_MS
from gateway.records import kept_pictures, picture_search, visits_csv
from gateway.records.index_reader import IndexReader
from gateway.records.kept_pictures import KeptPicture
from gateway.records.record import NotedKind
from gateway.records.visit_search import VisitKind, VisitSearch, pictures_of
from gateway.sinks.mqtt.visit_payload import visit_payload
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses, whole_number
from gateway.web.auth.refusals import RefusalError
from gateway.web.auth.sessions import Caller
from gateway.web.history.models import (
    BucketView,
    KeptPicturesView,
    KeptPictureView,
    MarkedEventsView,
    MarkedEventView,
    RecordedVisitView,
    RecordsView,
    TrendView,
    VisitsView,
)
from gateway.web.server.models import view_of
from gateway.web.server.pictures import encoded
from gateway.web.server.services import Bay, RequestCaller, Services, WebServices

LAST_MS = 4_102_444_800_000  # 2100
DAY_MS = 86_400_000
MAX_VISITS, MAX_ROWS = 500, 20_000  # of one answer; of one file
MAX_POINTS, MAX_EVENTS, MAX_PICTURES = 2000, 5000, 1000
BAY = "/api/bays/{bay}"
PICTURE = f"{BAY}/kept-pictures/{{file}}/{{place}}"

ERRORS = {
    400: "a number out of its range",
    404: "no such bay",
    503: "nothing is recorded, or the index cannot be read now; the reason is in `detail`",
}
ADDRESSES = ApiAddresses(least=Level.VIEWER, errors=ERRORS)
_PICTURE_ERRORS = {404: "no such bay or picture", 403: "records.pictures_for does not let this role see it"}


Since = Annotated[
    int | None, whole_number(0, LAST_MS), Query(description="Unix time, ms; a day before `until_ms` by default")
]
Until = Annotated[int | None, whole_number(0, LAST_MS), Query(description="Unix time, ms; now by default")]
Begun = Annotated[int, whole_number(0, LAST_MS)]
Number = Annotated[int, whole_number(0, 10**9)]
Visits = Annotated[int, whole_number(1, MAX_VISITS), Query(description="at most so many, the newest of them")]
Rows = Annotated[int, whole_number(1, MAX_ROWS), Query(description="at most so many, the newest of them")]
Points = Annotated[int, whole_number(1, MAX_POINTS), Query(description="at most so many buckets")]
Marks = Annotated[int, whole_number(1, MAX_EVENTS), Query(description="at most so many, the newest of them")]
Shots = Annotated[int, whole_number(1, MAX_PICTURES), Query(description="at most so many, the newest of them")]
What = Annotated[
    list[VisitKind],
    Query(max_length=len(VisitKind), description="only those to which all of these apply; none: all"),
]
Stops = Annotated[
    list[str], Query(max_length=len(Reason), description="only those with one of these faults, by reason; none: all")
]
Alarms = Annotated[
    list[str],
    Query(
        max_length=len(ALARM_DEFINITIONS), description="only those in which one of these alarms was active; none: all"
    ),
]
Width = Annotated[int, whole_number(64, 4096), Query(description="px; a wider picture is made smaller")]
Kinds = Annotated[
    list[EventKind | NotedKind], Query(max_length=len(EventKind) + len(NotedKind), description="only these; none: all")
]


@ADDRESSES.get(f"{BAY}/records", "records", "what there is of one bay's records", errors={400: "", 503: ""})
async def _records(services: WebServices, caller: RequestCaller, bay: Bay) -> RecordsView:
    span, why = None, ""
    try:
        span = await services.records.index(lambda reader: reader.span(bay.name))
    except RefusalError as error:
        why = str(error)
    config = services.client.about.config
    allowed = may_see_pictures(config, caller)
    return RecordsView(
        bay=bay.name,
        recorded=services.records.folder is not None,
        why=why,
        first_ms=None if span is None else span[0],
        last_ms=None if span is None else span[1],
        alarms={name: alarm.title for name, alarm in ALARM_DEFINITIONS.items()},
        pictures="not_for_you" if not allowed else "shown" if config.records.pictures else "not_kept",
    )


@ADDRESSES.get(f"{BAY}/visits", "visits", "visits that are over, the newest first")
async def _visits(
    services: WebServices,
    caller: RequestCaller,
    bay: Bay,
    since_ms: Since = None,
    until_ms: Until = None,
    limit: Visits = 100,
    what: What = [],  # noqa: B006 - FastAPI makes a new one for each request
    reason: Stops = [],  # noqa: B006
    alarm: Alarms = [],  # noqa: B006
) -> VisitsView:
    begin_ms, end_ms = _span(services, since_ms, until_ms)
    search = _search(what, reason, alarm)
    found = await services.records.index(lambda reader: search.found(reader, bay.name, begin_ms, end_ms, limit + 1))
    views = await _with_pictures(services, caller, bay.name, found[:limit])
    return VisitsView(bay=bay.name, visits=tuple(views), more=len(found) > limit)


@ADDRESSES.get(f"{BAY}/visits.csv", "visits_csv", "visits as CSV", media="text/csv")
async def _visits_csv(
    services: WebServices,
    bay: Bay,
    since_ms: Since = None,
    until_ms: Until = None,
    limit: Rows = MAX_ROWS,
    what: What = [],  # noqa: B006
    reason: Stops = [],  # noqa: B006
    alarm: Alarms = [],  # noqa: B006
) -> Response:
    begin_ms, end_ms = _span(services, since_ms, until_ms)
    search = _search(what, reason, alarm)

    def made(reader: IndexReader) -> str:
        found = search.found(reader, bay.name, begin_ms, end_ms, limit)
        return visits_csv.text((bay.name, visit) for visit in found)

    text = await services.records.index(made)
    headers = {"Content-Disposition": f'attachment; filename="visits-{bay.name}.csv"'}
    return Response(text, media_type="text/csv; charset=utf-8", headers=headers)


@ADDRESSES.get(f"{BAY}/visits/{{begun_ms}}", "visit", "one visit", errors={404: "no such bay or visit"})
async def _visit(services: WebServices, caller: RequestCaller, bay: Bay, begun_ms: Begun) -> RecordedVisitView:
    found = await visit_of(services, bay.name, begun_ms)
    (view,) = await _with_pictures(services, caller, bay.name, [found])
    return view


async def visit_of(services: Services, bay: str, begun_ms: int) -> VisitSummary:
    """Raises RefusalError where there is none."""
    found = await services.records.index(lambda reader: reader.visit(bay, begun_ms))
    if found is None:
        raise RefusalError(404, "visit", f"no visit of {bay} began at {begun_ms}")
    return found


@ADDRESSES.get(
    f"{BAY}/trend", "trend", "R, Z and the outputs over some time, in buckets of whole minutes", errors=ERRORS
)
async def _trend(
    services: WebServices, bay: Bay, since_ms: Since = None, until_ms: Until = None, points: Points = 500
) -> TrendView:
    begin_ms, end_ms = _span(services, since_ms, until_ms)
    bucket_ms, found = await services.records.index(lambda reader: reader.trend(bay.name, begin_ms, end_ms, points))
    buckets = tuple(BucketView.model_validate(bucket) for bucket in found)
    return TrendView(bay=bay.name, bucket_ms=bucket_ms, buckets=buckets)


@ADDRESSES.get(f"{BAY}/history-events", "history_events", "recorded events of one bay, the oldest first")
async def _history_events(
    services: WebServices,
    bay: Bay,
    kind: Kinds = [],  # noqa: B006 - FastAPI makes a new one for each request
    since_ms: Since = None,
    until_ms: Until = None,
    limit: Marks = 1000,
) -> MarkedEventsView:
    begin_ms, end_ms = _span(services, since_ms, until_ms)
    kinds = [each.value for each in kind]
    found = await services.records.index(lambda reader: reader.marks(bay.name, begin_ms, end_ms, limit + 1, kinds))
    events = tuple(MarkedEventView.model_validate(event) for event in found[-limit:])
    return MarkedEventsView(bay=bay.name, events=events, more=len(found) > limit)


@ADDRESSES.get(
    f"{BAY}/kept-pictures",
    "kept_pictures",
    "which pictures were kept, the oldest first",
    errors=_PICTURE_ERRORS | {404: "no such bay"},
)
async def _kept_pictures(
    services: WebServices,
    caller: RequestCaller,
    bay: Bay,
    since_ms: Since = None,
    until_ms: Until = None,
    limit: Shots = 500,
) -> KeptPicturesView:
    _check_pictures(services, caller)
    begin_ns, end_ns = (t_ms * NS_PER_MS for t_ms in _span(services, since_ms, until_ms))
    found = await services.records.pictures(
        bay.name, lambda folder: kept_pictures.kept(folder, begin_ns, end_ns, limit + 1)
    )
    views = tuple(_picture_view(picture) for picture in found[-limit:])
    return KeptPicturesView(bay=bay.name, pictures=views, more=len(found) > limit)


def _picture(ending: Literal["jpg", "png"], media: str, summary: str) -> None:
    @ADDRESSES.get(f"{PICTURE}.{ending}", f"kept_picture_{ending}", summary, media=media, errors=_PICTURE_ERRORS)
    async def picture(
        services: WebServices, caller: RequestCaller, bay: Bay, file: Number, place: Number, width: Width = 640
    ) -> Response:
        """`width` is of the JPEG only."""
        _check_pictures(services, caller)

        def read(folder: FilePath) -> tuple[int, bytes] | None:
            found = kept_pictures.picture(folder, file, place)
            if found is None:
                return None
            data = found.data if ending == "png" else encoded(picture_search.decoded(found), width)
            return found.head.unix_ns // NS_PER_MS, data

        answer = await services.records.pictures(bay.name, read)
        if answer is None:
            raise RefusalError(404, "picture", f"no picture {file}/{place} of {bay.name} is kept")
        taken_ms, data = answer
        return Response(data, media_type=media, headers={"X-Picture-Time-Ms": str(taken_ms)})


_picture("jpg", "image/jpeg", "a kept picture, made smaller")
_picture("png", "image/png", "a kept picture, without loss")


def may_see_pictures(config: GatewayConfig, caller: Caller) -> bool:
    """By `records.pictures_for`."""
    least = config.records.pictures_for
    return least != "nobody" and caller.level >= Level.of(least)


def _check_pictures(services: Services, caller: Caller) -> None:
    config = services.client.about.config
    if not may_see_pictures(config, caller):
        raise RefusalError(403, "pictures", f"records.pictures_for = {config.records.pictures_for}")


def _search(what: Collection[VisitKind], reasons: Collection[str], alarms: Collection[str]) -> VisitSearch:
    """Raises RefusalError."""
    known = {"reason": {reason.name.lower() for reason in Reason}, "alarm": set(ALARM_DEFINITIONS)}
    for name, asked in (("reason", reasons), ("alarm", alarms)):
        if unknown := set(asked) - known[name]:
            raise RefusalError(400, "query", f"no such {name}: {', '.join(sorted(unknown))}")
    return VisitSearch(tuple(what), tuple(reasons), tuple(alarms))


def _span(services: Services, since_ms: int | None, until_ms: int | None) -> tuple[int, int]:
    end_ms = services.client.server_time_ms if until_ms is None else until_ms
    return max(0, end_ms - DAY_MS) if since_ms is None else since_ms, end_ms


async def _with_pictures(
    services: Services, caller: Caller, bay: str, visits: list[VisitSummary]
) -> list[RecordedVisitView]:
    pictures: list[KeptPicture | None] = [None] * len(visits)
    if may_see_pictures(services.client.about.config, caller):
        pictures = await services.records.pictures(bay, lambda folder: pictures_of(folder, visits))
    return [
        RecordedVisitView(
            **dict(visit_payload(visit)),
            unintended=visit.rolled,
            picture=None if picture is None else _picture_view(picture),
        )
        for visit, picture in zip(visits, pictures, strict=True)
    ]


def _picture_view(picture: KeptPicture) -> KeptPictureView:
    t_ms = picture.head.unix_ns // NS_PER_MS
    return view_of(KeptPictureView, picture.head, file=picture.file, place=picture.place, t_ms=t_ms)
