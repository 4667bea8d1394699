"""What programs may ask for, and the deeds on alarms: one table, from which routes and OpenAPI document come. IO.

Every answer is made from what the gateway client knows; only actions on alarms go to the main
process. `after`, `limit` and bodies are checked here, and what is wrong with them is told by name.
"""

import asyncio
import json
import os
from collections.abc import Awaitable, Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Literal

import cv2
from pydantic import BaseModel, ValidationError
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from gateway.alarms.records import OperatorAction
from gateway.alarms.states import AlarmEvent
from gateway.alarms.table import BAY_ALARMS, GATEWAY_ALARMS, alarm_id
from gateway.clock import NS_PER_MS
from gateway.config import BayConfig
from gateway.errors import LinkError
from gateway.web.auth.caller import caller_of
from gateway.web.server import health, lists, views
from gateway.web.server.gateway_client import KEPT_EVENTS, GatewayClient, RefusedError
from gateway.web.server.metrics import text as metrics
from gateway.web.server.metrics.family import MetricsSource, PageStatistics
from gateway.web.server.models import (
    AcknowledgeBody,
    AlarmsView,
    BayView,
    EventsView,
    HealthView,
    RegistersView,
    ShelveBody,
)
from gateway.web.server.problems import problem
from gateway.web.server.process_usage import process_usage

Answer = Callable[["Programs", Request], Awaitable[Response]]
MAX_NUMBER = 2**53  # as JSON's readers count


@dataclass(slots=True)
class Programs:
    """What the answers are made from."""

    client: GatewayClient
    pages: Callable[[], PageStatistics]
    document: dict[str, object]  # OpenAPI's
    thread: Executor
    encoding: asyncio.Lock = field(default_factory=asyncio.Lock)

    def bay(self, request: Request) -> BayConfig | None:
        name = request.path_params["bay"]
        return next((bay for bay in self.client.about.config.bays if bay.name == name), None)


@dataclass(frozen=True, slots=True)
class Query:
    """A whole number in the address, after the question mark; or a mere word, where there is no range."""

    name: str
    meaning: str
    least: int | None = None
    most: int | None = None
    default: int | None = None


@dataclass(frozen=True, slots=True)
class Call:
    """One row. `says`: media type -> model, or None where there is none. `errors`: status -> when."""

    method: Literal["GET", "POST"]
    path: str
    name: str
    summary: str
    answer: Answer
    says: tuple[tuple[str, type[BaseModel] | None], ...]
    query: tuple[Query, ...] = ()
    body: type[BaseModel] | None = None
    errors: tuple[tuple[int, str], ...] = ()
    many: bool = False  # the model is that of each element of a list


def routes(
    client: GatewayClient,
    pages: Callable[[], PageStatistics],
    document: dict[str, object],
    *,
    thread: Executor | None = None,
) -> list[BaseRoute]:
    """To be put among the application's. `thread`: where snapshots are encoded; by default one of their own."""
    thread = thread or ThreadPoolExecutor(1, thread_name_prefix="snapshots")
    programs = Programs(client, pages, document, thread)

    def endpoint(answer: Answer) -> Callable[[Request], Awaitable[Response]]:
        async def call(request: Request) -> Response:
            return await answer(programs, request)

        return call

    return [Route(call.path, endpoint(call.answer), methods=[call.method], name=call.name) for call in CALLS]


class WrongError(Exception):
    """What the caller has to write otherwise."""


def _json(view: BaseModel, status: int = 200) -> Response:
    return Response(view.model_dump_json(), status, media_type="application/json")


def _no_bay(request: Request) -> Response:
    return problem(404, "bay", f"there is no bay {request.path_params['bay'][:100]!r}")


def _not_known(bay: BayConfig) -> Response:
    return problem(503, "not_known", f"nothing is known of {bay.name} yet")


def _number(request: Request, query: Query) -> int:
    """Raises WrongError."""
    said = request.query_params.get(query.name)
    if said is None:
        return query.default or 0
    least, most = query.least or 0, query.most or MAX_NUMBER
    if not (said.isascii() and said.isdigit() and len(said) < 20 and least <= int(said) <= most):
        raise WrongError(f"{query.name} = {said[:40]!r}: a whole number from {least} to {most}")
    return int(said)


async def _state(programs: Programs, _: Request) -> Response:
    client = programs.client
    await client.fresh(*client.bays)
    told = [views.bay_view(client, bay).model_dump_json() for bay in client.about.config.bays]
    return Response(f"[{','.join(told)}]", media_type="application/json")


async def _bay_state(programs: Programs, request: Request) -> Response:
    if (bay := programs.bay(request)) is None:
        return _no_bay(request)
    await programs.client.fresh(bay.name)
    return _json(views.bay_view(programs.client, bay))


async def _registers(programs: Programs, request: Request) -> Response:
    if (bay := programs.bay(request)) is None:
        return _no_bay(request)
    await programs.client.fresh(bay.name)
    view = lists.registers_view(programs.client, bay)
    return _not_known(bay) if view is None else _json(view)


async def _events(programs: Programs, request: Request) -> Response:
    return _told_events(programs, request, None)


async def _bay_events(programs: Programs, request: Request) -> Response:
    if (bay := programs.bay(request)) is None:
        return _no_bay(request)
    return _told_events(programs, request, bay.name)


def _told_events(programs: Programs, request: Request, bay: str | None) -> Response:
    try:
        after, limit = _number(request, AFTER), _number(request, LIMIT)
    except WrongError as wrong:
        return problem(400, "query", str(wrong))
    client = programs.client
    return _json(lists.events_view(client, views.gateway_of(client), bay, after, limit))


def _snapshot(ending: Literal["jpg", "png"]) -> Answer:
    async def answer(programs: Programs, request: Request) -> Response:
        """The newest frame whole, without anything painted on it."""
        if (bay := programs.bay(request)) is None:
            return _no_bay(request)
        async with programs.encoding:  # one at a time: whoever asks for many waits for their own
            frame = programs.client.snapshot(bay.name)
            if frame is None:
                return problem(503, "no_frame", f"the camera of {bay.name} has shown nothing yet")
            loop = asyncio.get_running_loop()
            done, data = await loop.run_in_executor(programs.thread, cv2.imencode, f".{ending}", frame.image)
        if not done:
            return problem(500, "fault", f"this frame can't be made a {ending.upper()}")
        age_ms = (programs.client.clock.now_ns() - frame.t_capture_ns) / NS_PER_MS
        headers = {"X-Frame-Id": str(frame.seq), "X-Frame-Age-Ms": f"{age_ms:.1f}"}
        return Response(data.tobytes(), media_type="image/jpeg" if ending == "jpg" else "image/png", headers=headers)

    return answer


async def _alarms(programs: Programs, _: Request) -> Response:
    return _json(lists.alarms_view(programs.client))


def _deed(cue: AlarmEvent, model: type[AcknowledgeBody]) -> Answer:
    async def answer(programs: Programs, request: Request) -> Response:
        name = request.path_params["alarm"]
        if name not in _alarm_ids(programs.client):
            return problem(404, "alarm", f"there is no alarm {name[:100]!r}")
        try:
            body = model.model_validate_json(await request.body() or b"{}")
        except ValidationError as error:
            return problem(400, "body", _told(error))
        caller = caller_of(request.scope)
        minutes = body.minutes if isinstance(body, ShelveBody) else None
        who = caller.name or str(caller.writer)
        try:
            await programs.client.order(
                OperatorAction(name, cue, who, body.note, minutes, body.occurrence), caller.writer
            )
        except RefusedError as refused:
            return problem(409, "refused", str(refused))
        except LinkError as error:
            return problem(503, "gateway", str(error))
        return _json(lists.alarms_view(programs.client))

    return answer


def _alarm_ids(client: GatewayClient) -> frozenset[str]:
    bays = {alarm_id(kind.id, bay) for kind in BAY_ALARMS for bay in client.bays}
    return frozenset(bays | {kind.id for kind in GATEWAY_ALARMS})


def _told(error: ValidationError) -> str:
    """Every fault with its place; what was written is not repeated."""
    faults = error.errors(include_url=False, include_context=False, include_input=False)
    return "; ".join(f"{'.'.join(map(str, fault['loc'])) or 'body'}: {fault['msg']}" for fault in faults)[:1000]


async def _healthz(programs: Programs, request: Request) -> Response:
    await programs.client.fresh(*programs.client.bays)
    view = health.health(programs.client, verbose="verbose" in request.query_params)
    return _json(view, health.status_code(view))


async def _metrics(programs: Programs, request: Request) -> Response:
    await programs.client.fresh(*programs.client.bays)
    known = MetricsSource(programs.client, programs.pages(), process_usage(os.getppid()))
    body, content_type = metrics.text(known, request.headers.get("accept", ""))
    return Response(body, headers={"Content-Type": content_type})


async def _openapi(programs: Programs, _: Request) -> Response:
    return Response(json.dumps(programs.document), media_type="application/json")


JSON, PLAIN = "application/json", "text/plain"
AFTER = Query("after", "only events with a greater number", 0, MAX_NUMBER, 0)
LIMIT = Query("limit", "at most so many, the oldest of them", 1, KEPT_EVENTS, KEPT_EVENTS)
VERBOSE = Query("verbose", "every part, not only what is wrong; needs no value")
NO_BAY = (404, "no such bay")
NOT_KNOWN = (503, "nothing is known of it yet")
WRONG_QUERY = (400, "a number out of its range")
DEED_ERRORS = (
    (400, "the body is not what is described here"),
    (404, "no such alarm"),
    (409, "not possible in the alarm's state, or it has occurred again since"),
    (503, "the main process does not answer"),
)


def _deed_call(cue: AlarmEvent, summary: str, model: type[AcknowledgeBody] = AcknowledgeBody) -> Call:
    path = f"/api/alarms/{{alarm}}/{cue.value}"
    says = ((JSON, AlarmsView),)
    return Call("POST", path, f"{cue.value}_alarm", summary, _deed(cue, model), says, body=model, errors=DEED_ERRORS)


CALLS: tuple[Call, ...] = (
    Call("GET", "/api/state", "state", "every bay as it is now", _state, ((JSON, BayView),), many=True),
    Call("GET", "/api/bays/{bay}/state", "bay_state", "one bay as it is now", _bay_state, ((JSON, BayView),),
         errors=(NO_BAY,)),
    Call("GET", "/api/bays/{bay}/events", "bay_events", "what happened in one bay, the oldest first", _bay_events,
         ((JSON, EventsView),), (AFTER, LIMIT), errors=(WRONG_QUERY, NO_BAY)),
    Call("GET", "/api/bays/{bay}/registers", "registers", "the registers as the PLC would read them now, decoded",
         _registers, ((JSON, RegistersView),), errors=(NO_BAY, NOT_KNOWN)),
    Call("GET", "/api/bays/{bay}/snapshot.jpg", "snapshot_jpg", "the newest frame", _snapshot("jpg"),
         (("image/jpeg", None),), errors=(NO_BAY, NOT_KNOWN)),
    Call("GET", "/api/bays/{bay}/snapshot.png", "snapshot_png", "the newest frame, without loss", _snapshot("png"),
         (("image/png", None),), errors=(NO_BAY, NOT_KNOWN)),
    Call("GET", "/api/events", "events", "what happened in all bays, the oldest first", _events,
         ((JSON, EventsView),), (AFTER, LIMIT), errors=(WRONG_QUERY,)),
    Call("GET", "/api/alarms", "alarms", "every alarm that is not normal, the most important first", _alarms,
         ((JSON, AlarmsView),)),
    _deed_call(AlarmEvent.ACKNOWLEDGE, "take notice of an alarm; never ends a stop"),
    _deed_call(AlarmEvent.RESET, "end a latched alarm whose cause is gone; never ends a stop"),
    _deed_call(AlarmEvent.SHELVE, "put an alarm aside for a while", ShelveBody),
    _deed_call(AlarmEvent.UNSHELVE, "take a shelved alarm back"),
    _deed_call(AlarmEvent.REMOVE, "take an alarm out of service, until somebody puts it back"),
    _deed_call(AlarmEvent.RESTORE, "put an alarm back into service"),
    Call("GET", "/healthz", "health", "does the gateway work, and if not, why", _healthz, ((JSON, HealthView),),
         (VERBOSE,)),
    Call("GET", "/metrics", "metrics", "for Prometheus; OpenMetrics for those who ask for it", _metrics,
         ((PLAIN, None),)),
    Call("GET", "/api/openapi.json", "openapi", "this description", _openapi, ((JSON, None),)),
)  # fmt: skip
