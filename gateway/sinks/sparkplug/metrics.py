"""The metrics of a bay and of the gateway: one table, from which births, data and docs/sparkplug.md are made. Pure."""

from collections.abc import Callable
from dataclasses import dataclass, field

from gateway.core import ne107
from gateway.core.detection import Circle
from gateway.core.ne107 import Ne107
from gateway.core.readings import FRESH_FRAME, PictureHealth, Quality
from gateway.core.state import REASON_MEANING, StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.sinks.contract import BayAlarms
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


def _known(read: Callable[[StateVector], Value]) -> Callable[[StateVector], tuple[Value, QualityCode]]:
    """Not known: null and bad."""

    def value(state: StateVector) -> tuple[Value, QualityCode]:
        found = read(state)
        return found, QualityCode.BAD if found is None else QualityCode.GOOD

    return value


def _signals(state: StateVector) -> str:
    found = ne107.active(state)
    return ", ".join(signal.name for signal in Ne107 if signal in found)


_B, _D, _S, _I = DataType.BOOLEAN, DataType.DOUBLE, DataType.STRING, DataType.INT32

DEVICE: tuple[Row, ...] = (
    Row("Stop", _B, "the truck must stop; also on whenever D is unknown", _always(lambda s: s.stop)),
    Row("May Move", _B, "the truck may move: stop is off and nothing withholds it", _always(lambda s: s.may_move)),
    Row("In Place", _B, "the truck is in place: the only condition for loading", _always(lambda s: s.in_place)),
    Row("Held", _B, "in place by the ranger alone: the marker is covered", _always(lambda s: s.visit.held)),
    Row("Rolling", _B, "a truck that was in place moves now, without release", _always(lambda s: s.visit.rolling)),
    Row("Moved", _S, "since it was in place, the truck left it: NO, DISTANCE, MARKER",
        _always(lambda s: s.visit.moved.name)),
    Row("Visit/Phase", _S, "phase of the visit", _always(lambda s: s.visit.phase.name)),
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
    Row("Guidance/Code", _I, "the instruction for the driver (register guidance_code)",
        _always(lambda s: int(s.guidance.code))),
    Row("Guidance/Name", _S, "the same by name", _always(lambda s: s.guidance.code.name)),
    Row("Guidance/Amount", _D, "of what it names; null: not known", _known(lambda s: s.guidance.amount_mm), "mm", 0),
    Row("Guidance/To Go", _D, "until D = 1; null: not known", _known(lambda s: s.guidance.to_go_mm), "mm", 0),
    Row("Guidance/Closing Speed", _D, "positive: the truck approaches; null: not known",
        _known(lambda s: s.guidance.closing_mm_s), "mm/s", 0),
    Row("NE107/Code", _I, "NAMUR NE 107: the signal that counts most; 0 good", _always(lambda s: int(ne107.status(s)))),
    Row("NE107/Name", _S, "the same by name", _always(lambda s: ne107.status(s).name)),
    Row("NE107/Active", _S, "every signal that holds, by name", _always(_signals)),
    Row("PLC/Link", _S, "of its heartbeat: UNUSED, WAITING, ALIVE, LOST", _always(lambda s: s.plc.link.name)),
    Row("PLC/Stop Latched", _B, "stop by D stays until a reset", _always(lambda s: s.memory.latched)),
    Row("PLC/Recipe", _I, "id of the recipe in force; 0: the configuration", _always(lambda s: s.plc.recipe)),
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


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a bay shows beside its state: the alarms, and the outbox of the history."""

    alarms: BayAlarms = field(default_factory=BayAlarms)
    waiting: int = 0  # changes that were not sent in this session
    dropped: int = 0
    file_ok: bool | None = None  # None: in memory only


@dataclass(frozen=True, slots=True)
class SurroundingsRow:
    """None: null."""

    name: str
    datatype: DataType
    meaning: str
    read: Callable[[Surroundings], Value]
    unit: str = ""


def _of(alarms: BayAlarms, value: Value) -> Value:
    return value if alarms.evaluated else None


SURROUNDINGS: tuple[SurroundingsRow, ...] = (
    SurroundingsRow("Outbox/Waiting", _I, "changes kept that were not sent in this session", lambda s: s.waiting),
    SurroundingsRow("Outbox/Dropped", _I, "changes given up since the start", lambda s: s.dropped),
    SurroundingsRow("Outbox/File OK", _B, "its file can be written; null: in memory only", lambda s: s.file_ok),
    SurroundingsRow("Alarms/Unacknowledged", _I, "alarms of bay and gateway that wait for an operator. All of `Alarms` "
        "are null while nothing evaluates them", lambda s: _of(s.alarms, s.alarms.unacknowledged)),
    SurroundingsRow("Alarms/Active", _I, "alarms whose cause holds", lambda s: _of(s.alarms, s.alarms.active)),
    SurroundingsRow("Alarms/Highest Priority", _S, "of the active ones: low, medium, high; none",
        lambda s: _of(s.alarms, s.alarms.highest_priority or "none")),
)  # fmt: skip
ALARM = "Alarms/State/"  # and the alarm's kind: one metric for each, a String
GATEWAY_ALARM = "Alarms/Gateway State/"

ROWS: tuple[Row | VisitRow | SurroundingsRow, ...] = (*DEVICE, *VISIT, *SURROUNDINGS)

HISTORY = ("Stop", "May Move", "In Place", "Moved", "Reason/Code", "Reason/Name")
"""What is kept of a change of stop."""
KEPT = frozenset({*HISTORY, *(row.name for row in VISIT)})

Reading = tuple[Value, QualityCode]


def readings(
    state: StateVector, visit: VisitSummary | None = None, around: Surroundings | None = None
) -> dict[str, Reading]:
    """Every device metric as it would be sent now. `visit`: the newest that is over."""
    found = {row.name: _sent(*row.read(state), row.digits) for row in DEVICE} | visit_readings(visit)
    return found | _around_readings(Surroundings() if around is None else around)


def _around_readings(around: Surroundings) -> dict[str, Reading]:
    """The outbox, the sums of the alarms, and the state of each of them by its name in ISA-18.2."""
    values: dict[str, Value] = {row.name: row.read(around) for row in SURROUNDINGS}
    for prefix, alarms in ((ALARM, around.alarms.bay), (GATEWAY_ALARM, around.alarms.gateway)):
        values |= {prefix + alarm.kind: _of(around.alarms, alarm.state) for alarm in alarms}
    return {name: (value, QualityCode.STALE if value is None else QualityCode.GOOD) for name, value in values.items()}


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
    """`now` as metrics, in the table's order, then the single alarms. Births carry units."""
    rows = [(row.name, row.datatype, row.unit) for row in ROWS if row.name in now]
    rows += [(name, _S, "") for name in sorted(now) if name.startswith((ALARM, GATEWAY_ALARM))]
    return tuple(
        Metric(name, timestamp_ms, datatype, value, quality=quality, unit=unit if birth else "")
        for name, datatype, unit in rows
        for value, quality in (now[name],)
    )


def markdown() -> str:
    """The device metrics as a table."""
    rows = [f"| `{r.name}` | {r.datatype.name.capitalize()} | {r.unit or '–'} | {r.meaning} |" for r in ROWS]
    rows += [
        f"| `{ALARM}<kind>` | String | – | state (ISA-18.2) of each alarm of the bay; names: [alarms](alarms.md) |",
        f"| `{GATEWAY_ALARM}<kind>` | String | – | of each alarm of the gateway itself |",
    ]
    return "\n".join(["| metric | datatype | unit | meaning |", "|---|---|---|---|", *rows]) + "\n"
