"""The addresses of the teach-in, /api/bays/{bay}/teach-in."""

from dataclasses import asdict
from typing import Any

from pydantic import Field

from gateway.core.teach_in import Suggestion, spreads_of, toml_lines
from gateway.durations import NS_PER_S
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses
from gateway.web.server.models import view_of
from gateway.web.server.services import Bay, RequestCaller, WebServices
from gateway.web.setup.models import SettingChangeBody
from gateway.web.tuning.request_models import Body
from gateway.web.tuning.response_models import (
    PointsView,
    SpreadsView,
    TaughtValueView,
    TeachInResultView,
    TeachInView,
)
from gateway.web.tuning.teach_in import TeachInSession, TeachInSessions

ADDRESSES = ApiAddresses(
    "/api/bays/{bay}/teach-in",
    least=Level.TECHNICIAN,
    errors={404: "no such bay", 503: "the gateway has not reported the bay, or is busy"},
)
POINTS = 300  # of the plot, about
SECONDS = 60.0


class TeachInBody(Body):
    """Begin a teach-in."""

    seconds: float = Field(SECONDS, ge=20, le=300, description="it measures for this time")


@ADDRESSES.get("", "teach_in", "the bay's teach-in and its result")
async def _teach_in(services: WebServices, bay: Bay) -> TeachInView:
    return _view(services.teach_ins, bay.name)


@ADDRESSES.post(
    "",
    "begin_teach_in",
    "measure a truck that stands right, for thresholds and aim",
    errors={409: "it can't begin now, and why"},
    audited=False,
)
async def _start(services: WebServices, bay: Bay, caller: RequestCaller, body: TeachInBody) -> TeachInView:
    await services.teach_ins.start(bay, body.seconds, caller.name or caller.address)
    return _view(services.teach_ins, bay.name)


@ADDRESSES.delete("", "cancel_teach_in", "cancel or forget the bay's teach-in")  # audited: it may be another user's
async def _cancel(services: WebServices, bay: Bay) -> TeachInView:
    services.teach_ins.cancel(bay.name)
    return _view(services.teach_ins, bay.name)


def _view(teach_ins: TeachInSessions, bay: str) -> TeachInView:
    session = teach_ins.of(bay)
    if session is None:
        return TeachInView(phase="none")
    last_ns = session.samples[-1].t_ns if session.samples else session.began_ns
    spreads = session.suggestion.spreads if session.suggestion is not None else spreads_of(session.samples)
    return view_of(
        TeachInView,
        session,
        elapsed_s=round(min(session.seconds, (last_ns - session.began_ns) / NS_PER_S), 1),
        spreads=SpreadsView.model_validate(_rounded(asdict(spreads))),
        points=_points(session),
        result=None if session.suggestion is None else _result(session, session.suggestion),
    )


def _rounded(found: Any) -> Any:
    if isinstance(found, dict):
        return {key: _rounded(value) for key, value in found.items()}
    return round(found, 3) if isinstance(found, float) else found


def _points(session: TeachInSession) -> PointsView:
    step = max(1, round(len(session.samples) / POINTS))
    shown = session.samples[::step]
    return PointsView(
        t_s=[round((one.t_ns - session.began_ns) / NS_PER_S, 1) for one in shown],
        radius_px=[None if one.circle is None else round(one.circle.radius_px, 1) for one in shown],
        distance_mm=[None if one.distance_mm is None else round(one.distance_mm, 1) for one in shown],
    )


def _result(session: TeachInSession, suggestion: Suggestion) -> TeachInResultView:
    bay = ["bays", session.bay.name]
    table = ["recipes", str(session.recipe)] if session.recipe else bay
    values = [view_of(TaughtValueView, one, key=".".join(one.path)) for one in suggestion.values]
    changes = [
        SettingChangeBody(path=[*table, *one.path], value=one.value)
        for one in suggestion.values
        if one.value != one.old
    ]
    if (colour := session.colour) is not None:
        values.append(view_of(TaughtValueView, colour, key="vision.marker_colour"))
        changes.append(SettingChangeBody(path=[*bay, "vision", "marker_colour"], value=colour.value))
    return view_of(
        TeachInResultView,
        suggestion,
        recipe=session.recipe,
        before_mm=_rounded(suggestion.before_mm),
        values=values,
        changes=changes,
        toml=toml_lines(session.bay.name, suggestion, session.recipe) if suggestion.values else "",
    )
