"""The metrics of a bay and of the gateway: one table, from which births, data and docs/sparkplug.md are made. Pure."""

from collections.abc import Callable
from dataclasses import dataclass

from gateway.core.detection import Circle
from gateway.core.readings import FRESH_FRAME, PictureHealth, Quality
from gateway.core.state import REASON_MEANING, StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.sinks.sparkplug.wire import DataType, Metric, QualityCode, Value

NODE_REBIRTH = "Node Control/Rebirth"
BD_SEQ = "bdSeq"


@dataclass(frozen=True, slots=True)
class Row:
    """`read` gives (value, quality); None: null. `digits`: a change smaller than their last one is none."""

    name: str
    datatype: DataType
    meaning: str
    read: Callable[[StateVector], tuple[Value, QualityCode]]
    unit: str = ""
    digits: int | None = None


@dataclass(frozen=True, slots=True)
class VisitRow:
    """Of the newest visit that is over; None: null."""

    name: str
    datatype: DataType
    meaning: str
    read: Callable[[VisitSummary], Value]
    unit: str = ""
    digits: int | None = None


def _always(read: Callable[[StateVector], Value]) -> Callable[[StateVector], tuple[Value, QualityCode]]:
    return lambda state: (read(state), QualityCode.GOOD)


def quality_code(quality: Quality) -> QualityCode:
    """STALE: was good, and is too old or lost; BAD: never was, or is known to be wrong."""
    if quality is Quality.GOOD:
        return QualityCode.GOOD
    return QualityCode.STALE if quality in (Quality.STALE, Quality.LINK_DOWN) else QualityCode.BAD


def _of_vision(read: Callable[[StateVector, Circle], Value]) -> Callable[[StateVector], tuple[Value, QualityCode]]:
    def value(state: StateVector) -> tuple[Value, QualityCode]:
        circle = state.vision.circle if state.vision.quality is Quality.GOOD else None
        found = None if circle is None else read(state, circle)
        code = quality_code(state.vision.quality)
        return found, code if found is not None or code is not QualityCode.GOOD else QualityCode.BAD

    return value


def _distance(state: StateVector) -> tuple[Value, QualityCode]:
    return state.range.distance_mm, quality_code(state.range.quality)


def _tracking(state: StateVector) -> tuple[Value, QualityCode]:
    """Null without a fresh frame: how an old position was found does not matter."""
    quality = state.vision.quality
    if quality in FRESH_FRAME:
        return state.vision.tracking.name, QualityCode.GOOD
    return None, quality_code(quality)


def _picture(read: Callable[[PictureHealth], Value]) -> Callable[[StateVector], tuple[Value, QualityCode]]:
    """Of the picture itself: null without a fresh frame, and where it is not known."""

    def value(state: StateVector) -> tuple[Value, QualityCode]:
        found = None if state.picture is None else read(state.picture)
        code = QualityCode.GOOD if state.picture is not None else quality_code(state.vision.quality)
        return found, QualityCode.BAD if found is None and code is QualityCode.GOOD else code

    return value


def _d(state: StateVector) -> tuple[Value, QualityCode]:
    return state.d, QualityCode.BAD if state.d is None else QualityCode.GOOD


_B, _D, _S, _I = DataType.BOOLEAN, DataType.DOUBLE, DataType.STRING, DataType.INT32

DEVICE: tuple[Row, ...] = (
    Row("Stop", _B, "the truck must stop; also on whenever D is unknown", _always(lambda s: s.stop)),
    Row("May Move", _B, "the truck may move: stop is off and nothing withholds it", _always(lambda s: s.may_move)),
    Row("In Place", _B, "the truck is in place: the only condition for loading", _always(lambda s: s.in_place)),
    Row("Held", _B, "in place by the ranger alone: the marker is covered", _always(lambda s: s.visit.held)),
    Row("Moved", _S, "since it was in place, the truck left it: NO, DISTANCE, MARKER",
        _always(lambda s: s.visit.moved.name)),
    Row("Visit/Phase", _S, "phase of the visit", _always(lambda s: s.visit.phase.name)),
    Row("Permit", _B, "old name of `May Move`, for one version", _always(lambda s: s.may_move)),
    Row("D", _B, "D(t), equation 14; null: unknowable", _d),
    Row("Reason/Code", _I, "why stop is on; 0 when it is off", _always(lambda s: int(s.reason))),
    Row("Reason/Name", _S, "the same by name", _always(lambda s: s.reason.name)),
    Row("Reason/Text", _S, "the same in words", _always(lambda s: REASON_MEANING[s.reason])),
    Row("Marker/U", _D, "marker centre, to the right", _of_vision(lambda s, c: c.u_px), "px", 1),
    Row("Marker/V", _D, "marker centre, downwards", _of_vision(lambda s, c: c.v_px), "px", 1),
    Row("Marker/Radius", _D, "marker radius R", _of_vision(lambda s, c: c.radius_px), "px", 1),
    Row("Marker/Confidence", _D, "0 to 1; null where the method gives none",
        _of_vision(lambda s, c: s.vision.confidence), digits=2),
    Row("Marker/Tracking", _S, "how the position was obtained; null: no fresh frame", _tracking),
    Row("Distance", _D, "distance Z from the ranger", _distance, "mm", 0),
    Row("Distance Vision", _D, "distance from the camera, where configured",
        _of_vision(lambda s, c: s.z_vision_mm), "mm", 0),
    Row("Camera/Quality", _S, "may the marker's values be used", _always(lambda s: s.vision.quality.name)),
    Row("Camera/Rate", _D, "results a second", _always(lambda s: s.vision.stats.rate_hz), "Hz", 0),
    Row("Picture/Brightness", _D, "mean grey level, share of white", _picture(lambda p: p.brightness), digits=2),
    Row("Picture/Contrast", _D, "share of the grey levels in use", _picture(lambda p: p.contrast), digits=2),
    Row("Picture/Sharpness", _D, "of the strongest edges, 0.6 in focus", _picture(lambda p: p.sharpness), digits=2),
    Row("Picture/Veil", _D, "share of dust or haze", _picture(lambda p: p.veil), digits=2),
    Row("Picture/Veil Proven", _D, "veil up to which the bay was shown to be reliable",
        _picture(lambda p: p.veil_proven),
        digits=2),
    Row("Picture/Shift", _D, "how far the fixed background has moved", _picture(lambda p: p.shift_px), "px", 0),
    Row("Picture/Status", _I, "what is wrong with it, one bit each (register picture_status)",
        _picture(lambda p: p.status)),
    Row("Ranger/Quality", _S, "may the distance be used", _always(lambda s: s.range.quality.name)),
    Row("Ranger/Rate", _D, "distances a second", _always(lambda s: s.range.stats.rate_hz), "Hz", 0),
)  # fmt: skip

VISIT: tuple[VisitRow, ...] = (
    VisitRow("Visit/Last/Begun", DataType.DATETIME, "when it began; with the bay, its identity. All of `Visit/Last` "
        "are null until a visit has ended since the start, and where it does not have that value",
        lambda v: max(0, v.begun_ms)),
    VisitRow("Visit/Last/Length", _D, "until the bay was clear, or the truck was last seen",
        lambda v: v.length_s, "s", 1),
    VisitRow("Visit/Last/End", _S, "how it ended: clear, next_truck, gateway_off", lambda v: v.end.value),
    VisitRow("Visit/Last/To Position", _D, "from its begin until it was first in place",
        lambda v: v.to_position_s, "s", 1),
    VisitRow("Visit/Last/In Place", _D, "how long it was in place, in all", lambda v: v.in_place_s, "s", 1),
    VisitRow("Visit/Last/Times In Place", _I, "how often it was in place", lambda v: v.times_in_place),
    VisitRow("Visit/Last/Corrections", _I, "reversals of the motion before it was in place", lambda v: v.corrections),
    VisitRow("Visit/Last/Stop Latency", _D, "from the newest measurement that showed D = 1 to the decision",
        lambda v: v.stop_latency_ms, "ms", 1),
    VisitRow("Visit/Last/Halt", _D, "from this stop until the truck stood", lambda v: v.halt_s, "s", 1),
    VisitRow("Visit/Last/Overrun", _D, "how far it rolled meanwhile", lambda v: v.overrun_mm, "mm", 0),
    VisitRow("Visit/Last/Radius", _D, "R when it was last found in place", lambda v: v.radius_px, "px", 1),
    VisitRow("Visit/Last/Distance", _D, "Z at that moment", lambda v: v.distance_mm, "mm", 0),
    VisitRow("Visit/Last/Offset", _D, "marker minus aim point at that moment", lambda v: v.offset_mm, "mm", 0),
    VisitRow("Visit/Last/Moved", _S, "it left its place without release: NO, DISTANCE, MARKER",
        lambda v: v.moved.name),
    VisitRow("Visit/Last/Faults", _I, "how often stop was on for a fault",
        lambda v: sum(times for _, times, _ in v.faults)),
    VisitRow("Visit/Last/Interrupted", _B, "the gateway was restarted meanwhile", lambda v: v.interrupted),
)  # fmt: skip

ROWS: tuple[Row | VisitRow, ...] = (*DEVICE, *VISIT)

HISTORY = ("Stop", "May Move", "In Place", "Moved", "Permit", "Reason/Code", "Reason/Name")
"""What is kept of a change of stop."""
KEPT = frozenset({*HISTORY, *(row.name for row in VISIT)})

Reading = tuple[Value, QualityCode]


def readings(state: StateVector, visit: VisitSummary | None = None) -> dict[str, Reading]:
    """Every device metric as it would be sent now. `visit`: the newest that is over."""
    return {row.name: _sent(*row.read(state), row.digits) for row in DEVICE} | visit_readings(visit)


def visit_readings(visit: VisitSummary | None) -> dict[str, Reading]:
    """Those of the newest visit alone."""
    found = {row.name: (None if visit is None else row.read(visit), row.digits) for row in VISIT}
    return {
        name: _sent(value, QualityCode.BAD if value is None else QualityCode.GOOD, digits)
        for name, (value, digits) in found.items()
    }


def _sent(value: Value, quality: QualityCode, digits: int | None) -> Reading:
    if digits is not None and isinstance(value, float):
        value = round(value, digits)
    if isinstance(value, float) and not -1e300 < value < 1e300:  # NaN too: no number that a host could show
        return None, QualityCode.BAD
    return value, quality


def metrics(now: dict[str, Reading], timestamp_ms: int, *, birth: bool = False) -> tuple[Metric, ...]:
    """`now` as metrics, in the table's order. Births carry units."""
    return tuple(
        Metric(row.name, timestamp_ms, row.datatype, value, quality=quality, unit=row.unit if birth else "")
        for row in ROWS
        if row.name in now
        for value, quality in (now[row.name],)
    )


def markdown() -> str:
    """The device metrics as a table."""
    rows = (f"| `{r.name}` | {r.datatype.name.capitalize()} | {r.unit or '–'} | {r.meaning} |" for r in ROWS)
    return "\n".join(["| metric | datatype | unit | meaning |", "|---|---|---|---|", *rows]) + "\n"
