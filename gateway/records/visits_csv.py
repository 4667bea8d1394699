"""The visits of a bay as CSV, one row each. Pure, but for the machine's time zone."""

import csv
import io
from collections.abc import Iterable

from gateway.core.state import VisitPhase
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_MS
from gateway.records.moment import shown
from gateway.sinks.mqtt.visit_payload import visit_payload

_PLAIN = (
    "length_s", "at_mark_s", "to_position_s", "released_s", "in_place_s", "times_in_place", "corrections",
    "stop_latency_ms", "halt_s", "overrun_mm", "radius_px", "distance_mm", "offset_px", "offset_mm", "frame_id",
    "frame_ms", "interruptions", "off_s", "visible", "contrast",
)  # fmt: skip
HEADER = (
    "bay", "begun", "ended", "begun_ms", "end", "moved", *_PLAIN, "faults",
    *(f"phase_{phase.name.lower()}_s" for phase in VisitPhase),
)  # fmt: skip


def text(visits: Iterable[tuple[str, VisitSummary]]) -> str:
    """Each with its bay. RFC 4180, comma, with a header; `begun` and `ended` are local times with their zone, an empty
    cell is unknown.

    `faults`: `reason times seconds`, several with a semicolon between.
    """
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(HEADER)
    for bay, visit in visits:
        told = visit_payload(visit)
        faults = "; ".join(f"{fault.reason.lower()} {fault.times} {fault.seconds:g}" for fault in told.faults)
        begun, ended = shown(visit.begun_ms * NS_PER_MS), shown(visit.last_seen_ms * NS_PER_MS)
        plain = [getattr(told, name) for name in _PLAIN]
        first = (bay, begun, ended, told.begun_ms, told.end.value, told.moved.lower())
        writer.writerow((*first, *plain, faults, *told.phases_s.values()))
    return out.getvalue()
