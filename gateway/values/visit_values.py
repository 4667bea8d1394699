"""What outputs show of a truck's visit. Measured values are those when it was last found in place. Pure."""

from collections.abc import Callable
from operator import attrgetter
from typing import Any

from gateway.core.state import Moved, VisitPhase
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.values.value import Value, by_name

_NEVER = "never"
_NOT_FOUND = "never in place"
_NOT_MEASURED = "not measured"


def _row(
    name: str, kind: type, meaning: str, null: str = "", read: Callable[[VisitSummary], Any] | None = None
) -> Value[VisitSummary]:
    return Value(name, kind, meaning, read or attrgetter(name), null)


ROWS: tuple[Value[VisitSummary], ...] = (
    _row("begun_ms", int, "when it began, Unix time, ms; with the bay, its identity",
         read=lambda v: max(0, v.begun_ms)),
    _row("length_s", float, "until the bay was clear, or the truck was last seen"),
    _row("end", VisitEnd, "how it ended: clear, next_truck or gateway_off (docs/records.md)"),
    _row("phases_s", dict, "time in each phase, by the names of VisitPhase",
         read=lambda v: {phase.name: v.phases_s[phase] for phase in VisitPhase}),
    _row("at_mark_s", float, "from its begin to the first D = 1", _NEVER),
    _row("to_position_s", float, "from its begin until it was first in place", _NEVER),
    _row("released_s", float, "from its begin to the last release by the PLC", "none"),
    _row("in_place_s", float, "time in place, in all"),
    _row("times_in_place", int, "how often it was in place"),
    _row("corrections", int, "reversals of the motion before it was in place, back and forth"),
    _row("stop_latency_ms", float, "from the newest measurement that showed D = 1 first to the decision", _NEVER),
    _row("halt_s", float, "from this stop until the truck stood; by the speed over the last second", _NEVER),
    _row("overrun_mm", float, "how far it rolled meanwhile", _NEVER),
    _row("radius_px", float, "R when it was last found in place", _NOT_FOUND),
    _row("distance_mm", float, "Z at that moment", _NOT_FOUND),
    _row("offset_px", float, "marker minus aim point, to the right", "no aim point"),
    _row("offset_mm", float, "the same in the plane of the marker", "size not known"),
    _row("frame_id", int, "the picture in which it was found in place", _NOT_FOUND),
    _row("frame_ms", int, "when that was taken, Unix time, ms", _NOT_FOUND),
    _row("visible", float, "share of the rim seen, 0 to 1, median of the first pictures in place", _NOT_MEASURED),
    _row("contrast", float, "fall of redness across the rim, log units, likewise", _NOT_MEASURED),
    _row("moved", Moved, "it left its place without release: NO, DISTANCE or MARKER"),
    _row("faults", tuple, "each reason for `stop` that was a fault, with times and seconds"),
    _row("fault_times", int, "how often stop was on for a fault",
         read=lambda v: sum(times for _, times, _ in v.faults)),
    _row("interrupted", bool, "the gateway was restarted meanwhile"),
    _row("interruptions", int, "how often"),
    _row("off_s", float, "for how long the truck was not watched because of it"),
)  # fmt: skip
VISIT_VALUES = by_name(ROWS, {})
