"""The addresses for programs: state, events, registers, alarms, snapshots, health and metrics. IO.

Every answer is made from the gateway client's data; only actions on alarms go to the main process.
"""

import asyncio
import os
from collections.abc import Callable
from typing import Annotated, Literal

from fastapi import Depends, Path, Query
from starlette.requests import Request
from starlette.responses import Response

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.gateway_alarms import GATEWAY_ALARMS
from gateway.alarms.records import OperatorAction
from gateway.alarms.states import AlarmEvent
from gateway.alarms.table import alarm_id
from gateway.durations import NS_PER_MS
from gateway.errors import LinkError
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses, Endpoint, whole_number
from gateway.web.auth.refusals import AGAIN, RefusalError
from gateway.web.ipc.messages import MarkMoment
from gateway.web.server import health, lists, views
from gateway.web.server.gateway_client import KEPT_EVENTS
from gateway.web.server.metrics import text as metrics
from gateway.web.server.metrics.family import MetricsSource
from gateway.web.server.models import (
    AcknowledgeBody,
    AlarmsView,
    BayView,
    EventsView,
    HealthView,
    MarkBody,
    MarkView,
    RegistersView,
    ShelveBody,
)
from gateway.web.server.pictures import picture_file
from gateway.web.server.process_usage import process_usage
from gateway.web.server.services import Bay, RequestCaller, Services, WebServices

MAX_NUMBER = 2**53  # as JSON's readers count
ADDRESSES = ApiAddresses(least=Level.VIEWER)
BAY = "/api/bays/{bay}"

_NO_BAY = {404: "no such bay"}
_NO_STATE = _NO_BAY | {503: "nothing is known of it yet"}
_SILENT = {503: "the main process does not answer"}
_WRONG_QUERY = {400: "a number out of its range"}
_ACTION_ERRORS = {
    404: "no such alarm",
    409: "not possible in the alarm's state, or it has occurred again since",
} | _SILENT

After = Annotated[int, whole_number(0, MAX_NUMBER), Query(description="only events with a greater number")]
Limit = Annotated[int, whole_number(1, KEPT_EVENTS), Query(description="at most so many, the oldest of them")]


@ADDRESSES.get("/api/state", "state", "every bay as it is now")
async def _state(services: WebServices) -> list[BayView]:
    client = services.client
    await client.fresh(*client.bays)
    return [views.bay_view(client, bay) for bay in client.about.config.bays]


@ADDRESSES.get(f"{BAY}/state", "bay_state", "one bay as it is now", errors=_NO_BAY)
async def _bay_state(services: WebServices, bay: Bay) -> BayView:
    await services.client.fresh(bay.name)
    return views.bay_view(services.client, bay)


@ADDRESSES.get(
    f"{BAY}/events", "bay_events", "what happened in one bay, the oldest first", errors=_WRONG_QUERY | _NO_BAY
)
async def _bay_events(services: WebServices, bay: Bay, after: After = 0, limit: Limit = KEPT_EVENTS) -> EventsView:
    return lists.events_view(services.client, views.gateway_of(services.client), bay.name, after, limit)


@ADDRESSES.get(
    f"{BAY}/registers", "registers", "the registers as the PLC would read them now, decoded", errors=_NO_STATE
)
async def _registers(services: WebServices, bay: Bay) -> RegistersView:
    await services.client.fresh(bay.name)
    view = lists.registers_view(services.client, bay)
    if view is None:
        raise RefusalError(503, "not_known", f"nothing is known of {bay.name} yet")
    return view


def _snapshot(ending: Literal["jpg", "png"], media: str, summary: str) -> None:
    @ADDRESSES.get(f"{BAY}/snapshot.{ending}", f"snapshot_{ending}", summary, media=media, errors=_NO_STATE)
    async def snapshot(services: WebServices, bay: Bay) -> Response:
        """The newest frame, unscaled, without anything painted on it."""
        async with services.encoding:  # one at a time: a client with many requests waits for its own
            frame = services.client.snapshot(bay.name)
            if frame is None:
                raise RefusalError(503, "no_frame", f"the camera of {bay.name} has shown nothing yet")
            loop = asyncio.get_running_loop()
            data = await loop.run_in_executor(services.snapshots, picture_file, frame.image, ending)
        age_ms = (services.client.clock.now_ns() - frame.t_capture_ns) / NS_PER_MS
        headers = {"X-Frame-Id": str(frame.seq), "X-Frame-Age-Ms": f"{age_ms:.1f}"}
        return Response(data, media_type=media, headers=headers)


_snapshot("jpg", "image/jpeg", "the newest frame")
_snapshot("png", "image/png", "the newest frame, without loss")


@ADDRESSES.post(
    f"{BAY}/mark",
    "mark",
    "mark this moment: an event, and the pictures round it are kept",
    errors=_NO_BAY | _SILENT | {400: ""},
)
async def _mark(services: WebServices, caller: RequestCaller, bay: Bay, body: MarkBody) -> MarkView:
    try:
        await services.client.command(MarkMoment(bay.name, body.note), caller.writer)
    except LinkError as error:
        raise RefusalError(503, "gateway", str(error), headers=AGAIN) from None
    return MarkView(marked=True)


@ADDRESSES.get("/api/events", "events", "what happened in all bays, the oldest first", errors=_WRONG_QUERY)
async def _events(services: WebServices, after: After = 0, limit: Limit = KEPT_EVENTS) -> EventsView:
    return lists.events_view(services.client, views.gateway_of(services.client), None, after, limit)


@ADDRESSES.get("/api/alarms", "alarms", "every alarm that is not normal, the most important first", errors=_SILENT)
async def _alarms(services: WebServices) -> AlarmsView:
    await services.client.fresh(*services.client.bays)
    if not services.client.links_known:
        raise LinkError("the gateway does not answer: which alarms there are is not known")
    return lists.alarms_view(services.client)


async def _alarm(
    services: WebServices,
    alarm: Annotated[str, Path(min_length=1, description="id of the alarm, `bay1.camera_down` or `broker_lost`")],
) -> str:
    ids = {alarm_id(kind.id, bay) for kind in BAY_ALARMS for bay in services.client.bays}
    if alarm not in ids | {kind.id for kind in GATEWAY_ALARMS}:
        raise RefusalError(404, "alarm", f"there is no alarm {alarm[:100]!r}")
    return alarm


AlarmId = Annotated[str, Depends(_alarm)]


def _action(event: AlarmEvent, least: Level, summary: str) -> Callable[[Endpoint], Endpoint]:
    path = f"/api/alarms/{{alarm}}/{event.value}"
    return ADDRESSES.post(path, f"{event.value}_alarm", summary, least=least, errors=_ACTION_ERRORS)


def _plain_action(event: AlarmEvent, least: Level, summary: str) -> None:
    @_action(event, least, summary)
    async def act(services: WebServices, caller: RequestCaller, alarm: AlarmId, body: AcknowledgeBody) -> AlarmsView:
        return await _act(services, caller, event, alarm, body)


async def _act(
    services: Services,
    caller: RequestCaller,
    event: AlarmEvent,
    alarm: str,
    body: AcknowledgeBody,
    minutes: float | None = None,
) -> AlarmsView:
    who = caller.name or str(caller.writer)
    action = OperatorAction(alarm, event, who, body.note, minutes, body.occurrence)
    try:
        await services.client.command(action, caller.writer)
    except LinkError as error:
        raise RefusalError(503, "gateway", str(error), headers=AGAIN) from None
    return lists.alarms_view(services.client)


_plain_action(AlarmEvent.ACKNOWLEDGE, Level.VIEWER, "take notice of an alarm; never ends a stop")
_plain_action(AlarmEvent.RESET, Level.VIEWER, "end a latched alarm whose cause is gone; never ends a stop")


@_action(AlarmEvent.SHELVE, Level.TECHNICIAN, "put an alarm aside for a while")
async def _shelve(services: WebServices, caller: RequestCaller, alarm: AlarmId, body: ShelveBody) -> AlarmsView:
    return await _act(services, caller, AlarmEvent.SHELVE, alarm, body, body.minutes)


_plain_action(AlarmEvent.UNSHELVE, Level.TECHNICIAN, "take a shelved alarm back")
_plain_action(AlarmEvent.REMOVE, Level.TECHNICIAN, "take an alarm out of service, until somebody puts it back")
_plain_action(AlarmEvent.RESTORE, Level.TECHNICIAN, "put an alarm back into service")

_VERBOSE = {
    "name": "verbose",
    "in": "query",
    "required": False,
    "description": "every part, not only what is wrong; needs no value",
    "allowEmptyValue": True,
    "schema": {"type": "string", "maxLength": 0},
}


@ADDRESSES.get(
    "/healthz",
    "health",
    "does the gateway work, and if not, why",
    least=Level.OPEN,
    failing={503: "a restart may help; the reasons are listed"},
    query=(_VERBOSE,),
)
async def _healthz(services: WebServices, request: Request, response: Response) -> HealthView:
    await services.client.fresh(*services.client.bays, anew=True)
    view = health.health(services.client, verbose="verbose" in request.query_params)
    response.status_code = health.status_code(view)
    return view


@ADDRESSES.get("/metrics", "metrics", "for Prometheus; OpenMetrics for those who ask for it", media="text/plain")
async def _metrics(services: WebServices, request: Request) -> Response:
    await services.client.fresh(*services.client.bays)
    source = MetricsSource(services.client, services.statistics(), process_usage(os.getppid()))
    body, content_type = metrics.text(source, request.headers.get("accept", ""))
    return Response(body, headers={"Content-Type": content_type})
