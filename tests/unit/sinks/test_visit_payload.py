"""The message of a visit: every number in its field, rounded, and JSON throughout."""

import json

from gateway.core.events import Event, EventKind
from gateway.core.state import Moved, Reason, StateVector, VisitPhase
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.sinks.mqtt.payloads import event_payload
from gateway.sinks.mqtt.topics import Gateway, Topics
from gateway.sinks.mqtt.visit_payload import visit_payload

VISIT = VisitSummary(
    begun_ms=1_795_000_000_123, length_s=140.4649, end=VisitEnd.CLEAR,
    phases_s=tuple(float(phase) for phase in VisitPhase), at_mark_s=10.321, to_position_s=12.16, released_s=130.0,
    in_place_s=125.899, times_in_place=1, corrections=2, stop_latency_ms=89.998, halt_s=0.84, overrun_mm=20.04,
    radius_px=192.956, distance_mm=279.97, offset_px=-3.5, offset_mm=-5.11, frame_id=244, frame_ms=1_795_000_012_133,
    visible=0.8756, contrast=1.2346, moved=Moved.MARKER, faults=((Reason.PLC_LOST, 2, 3.456),), interruptions=1,
    off_s=5.2,
)  # fmt: skip


def test_every_number_is_in_its_field() -> None:
    assert visit_payload(VISIT).model_dump(mode="json") == {
        "begun_ms": 1_795_000_000_123,
        "begun": "2026-11-18T11:06:40.123Z",
        "length_s": 140.46,
        "end": "clear",
        "phases_s": {phase.name: float(phase) for phase in VisitPhase},
        "at_mark_s": 10.32,
        "to_position_s": 12.16,
        "released_s": 130.0,
        "in_place_s": 125.9,
        "times_in_place": 1,
        "corrections": 2,
        "stop_latency_ms": 90.0,
        "halt_s": 0.84,
        "overrun_mm": 20.0,
        "radius_px": 192.96,
        "distance_mm": 280.0,
        "offset_px": -3.5,
        "offset_mm": -5.1,
        "frame_id": 244,
        "frame_ms": 1_795_000_012_133,
        "visible": 0.876,
        "contrast": 1.235,
        "moved": "MARKER",
        "faults": [{"reason": "PLC_LOST", "times": 2, "seconds": 3.46}],
        "interrupted": True,
        "interruptions": 1,
        "off_s": 5.2,
    }


def test_the_event_of_a_visit_has_it_and_no_other_has() -> None:
    gateway = Gateway(Topics("loading", "site1", "gateway"), ("bay1",), "0.1.0", "9f86d081884c7d65")
    state = StateVector("bay1")
    event = Event(EventKind.VISIT, "bay1", 0, state, detail=VISIT.text, summary=VISIT)
    told = json.loads(event_payload(event, 1, gateway, 0).model_dump_json())
    assert (told["kind"], told["visit"]["begun_ms"]) == ("visit", VISIT.begun_ms)
    assert told["detail"] == (
        "140 s, in place after 12 s for 126 s, R 193.0 px, Z 280 mm, corrections 2, moved: marker, released, "
        "interrupted by a restart"
    )
    other = Event(EventKind.VISIT_ENDED, "bay1", 0, state)
    assert json.loads(event_payload(other, 2, gateway, 0).model_dump_json())["visit"] is None
    assert VisitSummary(0, 12.0).text == "12 s, never in place, corrections 0, not released"
