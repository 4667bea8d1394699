"""A truck's visit as messages and the API hold it. Pure."""

from typing import Literal

from pydantic import Field

from gateway.core.state import Reason, VisitPhase
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.sinks.mqtt.values import LAST_MS, Count, Payload, iso
from gateway.values.models import Filler, ShownModel
from gateway.values.visit_values import VISIT_VALUES


class FaultPayload(Payload):
    """A reason for `stop` that is a fault, in one visit."""

    reason: str = Field(json_schema_extra={"enum": [reason.name for reason in Reason]})
    times: Count
    seconds: float = Field(description="in all")


class VisitPayload(ShownModel):
    """One truck's visit, from arrival to leaving. Measured values are those when it was last found in place."""

    rows = VISIT_VALUES
    begun_ms: Count
    begun: str = Field(description="the same, ISO 8601, UTC", json_schema_extra={"format": "date-time"})
    length_s: float
    end: VisitEnd
    phases_s: dict[str, float]
    at_mark_s: float | None
    to_position_s: float | None
    released_s: float | None
    in_place_s: float
    times_in_place: Count
    corrections: Count
    stop_latency_ms: float | None
    halt_s: float | None
    overrun_mm: float | None
    radius_px: float | None
    distance_mm: float | None
    offset_px: float | None
    offset_mm: float | None
    frame_id: Count | None
    frame_ms: Count | None
    visible: float | None = None
    contrast: float | None = None
    moved: Literal["NO", "DISTANCE", "MARKER"]
    faults: tuple[FaultPayload, ...]
    interrupted: bool
    interruptions: Count
    off_s: float


def visit_payload(visit: VisitSummary) -> VisitPayload:
    begun_ms = min(max(0, visit.begun_ms), LAST_MS)
    return VISIT.fill(VisitPayload, visit, 0, begun_ms=begun_ms, begun=iso(begun_ms))


def _phases_s(visit: VisitSummary, _: int) -> dict[str, float]:
    return {phase.name: round(visit.phases_s[phase], 2) for phase in VisitPhase}


def _faults(visit: VisitSummary, _: int) -> tuple[FaultPayload, ...]:
    return tuple(
        FaultPayload(reason=reason.name, times=times, seconds=round(seconds, 2))
        for reason, times, seconds in visit.faults
    )


VISIT = Filler(
    VISIT_VALUES,
    {"s": 2, "ms": 1, "px": 2, "mm": 1, "": 3},
    {"end": lambda visit, _: visit.end, "phases_s": _phases_s, "faults": _faults},
)
