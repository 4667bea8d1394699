"""A truck's visit as messages and the API hold it. Pure."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from gateway.core.state import Reason, VisitPhase
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.sinks.mqtt.values import LAST_MS, iso, number

Count = Annotated[int, Field(json_schema_extra={"minimum": 0})]
FROZEN = ConfigDict(frozen=True)


class FaultPayload(BaseModel):
    """A reason for `stop` that is a fault, in one visit."""

    model_config = FROZEN
    reason: str = Field(json_schema_extra={"enum": [reason.name for reason in Reason]})
    times: Count
    seconds: float = Field(description="in all")


class VisitPayload(BaseModel):
    """One truck's visit, from arrival to leaving. Measured values are those when it was last found in place."""

    model_config = FROZEN
    begun_ms: Count = Field(description="Unix time, ms; with the bay, the identity of the visit")
    begun: str = Field(description="the same, ISO 8601, UTC", json_schema_extra={"format": "date-time"})
    length_s: float = Field(description="until the bay was clear, or the truck was last seen")
    end: VisitEnd
    phases_s: dict[str, float] = Field(description="time in each phase, by the names of VisitPhase")
    at_mark_s: float | None = Field(description="from its begin to the first D = 1; null: never")
    to_position_s: float | None = Field(description="from its begin until it was first in place; null: never")
    released_s: float | None = Field(description="from its begin to the last release by the PLC; null: none")
    in_place_s: float = Field(description="in all")
    times_in_place: Count
    corrections: Count = Field(description="reversals of the motion before it was in place, back and forth")
    stop_latency_ms: float | None = Field(
        description="from the newest measurement that showed D = 1 first to the decision"
    )
    halt_s: float | None = Field(description="from this stop until the truck stood; by the speed over the last second")
    overrun_mm: float | None = Field(description="how far it rolled meanwhile")
    radius_px: float | None
    distance_mm: float | None
    offset_px: float | None = Field(description="marker minus aim point, to the right; null: no aim point")
    offset_mm: float | None = Field(description="the same in the plane of the marker; null: size not known")
    frame_id: Count | None = Field(description="the picture in which it was found in place")
    frame_ms: Count | None = Field(description="when that was taken, Unix time, ms")
    moved: Literal["NO", "DISTANCE", "MARKER"] = Field(description="it left its place without release: how")
    faults: tuple[FaultPayload, ...]
    interrupted: bool = Field(description="the gateway was restarted meanwhile")
    interruptions: Count = Field(description="how often")
    off_s: float = Field(description="for how long the truck was not watched because of it")


def visit_payload(visit: VisitSummary) -> VisitPayload:
    begun_ms = min(max(0, visit.begun_ms), LAST_MS)
    return VisitPayload(
        begun_ms=begun_ms,
        begun=iso(begun_ms),
        length_s=round(visit.length_s, 2),
        end=visit.end,
        phases_s={phase.name: round(visit.phases_s[phase], 2) for phase in VisitPhase},
        at_mark_s=number(visit.at_mark_s, 2),
        to_position_s=number(visit.to_position_s, 2),
        released_s=number(visit.released_s, 2),
        in_place_s=round(visit.in_place_s, 2),
        times_in_place=visit.times_in_place,
        corrections=visit.corrections,
        stop_latency_ms=number(visit.stop_latency_ms, 1),
        halt_s=number(visit.halt_s, 2),
        overrun_mm=number(visit.overrun_mm, 1),
        radius_px=number(visit.radius_px, 2),
        distance_mm=number(visit.distance_mm, 1),
        offset_px=number(visit.offset_px, 2),
        offset_mm=number(visit.offset_mm, 1),
        frame_id=visit.frame_id,
        frame_ms=visit.frame_ms,
        moved=visit.moved.name,
        faults=tuple(
            FaultPayload(reason=reason.name, times=times, seconds=round(seconds, 2))
            for reason, times, seconds in visit.faults
        ),
        interrupted=visit.interrupted,
        interruptions=visit.interruptions,
        off_s=round(visit.off_s, 2),
    )
