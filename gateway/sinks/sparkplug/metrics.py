"""The metrics of a bay and of the gateway: one table, from which births, data and docs/sparkplug.md are made. Pure."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any

from gateway.core.readings import Quality
from gateway.core.state import StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.sinks.contract import ALARM_PRIORITIES, BayAlarms
from gateway.sinks.sparkplug.wire import DataType, Metric, QualityCode, Value
from gateway.values.bay_values import BAY_VALUES
from gateway.values.gateway_values import GATEWAY_VALUES, GatewayFacts
from gateway.values.value import Value as Shown
from gateway.values.visit_values import VISIT_VALUES

NODE_REBIRTH = "Node Control/Rebirth"
BD_SEQ = "bdSeq"
BAYS_ALIVE = "Bays/Alive"  # of the node: how many devices have a birth
_DATATYPES = {bool: DataType.BOOLEAN, int: DataType.INT32, float: DataType.DOUBLE}
_DIGITS = {"px": 1, "mm": 0, "mm/s": 0, "Hz": 0, "s": 1, "ms": 1, "": 2}  # a change smaller than their last one is none
_OWN_DIGITS = {"Picture/Shift": 0, **{f"Pose/{axis}{of}": 1 for axis in "XYZ" for of in ("", " SD")}}

DEVICE = {
    "Stop": "stop",
    "May Move": "may_move",
    "In Place": "in_place",
    "Held": "held",
    "Rolling": "rolling",
    "Moved": "moved",
    "Visit/Phase": "phase",
    "D": "d",
    "Reason/Code": "reason.code",
    "Reason/Name": "reason.name",
    "Reason/Text": "reason.text",
    "Marker/U": "u_px",
    "Marker/V": "v_px",
    "Marker/Radius": "radius_px",
    "Marker/Confidence": "confidence",
    "Marker/Tracking": "tracking",
    "Distance": "distance_mm",
    "Distance Vision": "z_vision_mm",
    "Camera/Quality": "vision.quality",
    "Camera/Rate": "rates.vision_hz",
    "Picture/Brightness": "picture.brightness",
    "Picture/Contrast": "picture.contrast",
    "Picture/Sharpness": "picture.sharpness",
    "Picture/Veil": "picture.veil",
    "Picture/Veil Proven": "picture.veil_proven",
    "Picture/Shift": "picture.shift_px",
    "Picture/Status": "picture.status",
    "Ranger/Quality": "range.quality",
    "Ranger/Rate": "rates.range_hz",
    "Guidance/Code": "guidance.code",
    "Guidance/Name": "guidance.name",
    "Guidance/Amount": "guidance.amount_mm",
    "Guidance/To Go": "guidance.to_go_mm",
    "Guidance/Closing Speed": "guidance.closing_mm_s",
    "Drive/Enable": "drive.enable",
    "Drive/State": "drive.state",
    "Drive/Speed Setpoint": "drive.speed_setpoint_mm_s",
    "Drive/Stopping Distance": "drive.stopping_mm",
    "Pose/X": "pose.x_mm",
    "Pose/Y": "pose.y_mm",
    "Pose/Z": "pose.z_mm",
    "Pose/X SD": "pose.x_sd_mm",
    "Pose/Y SD": "pose.y_sd_mm",
    "Pose/Z SD": "pose.z_sd_mm",
    "NE107/Code": "ne107.code",
    "NE107/Name": "ne107.name",
    "NE107/Active": "ne107.active",
    "PLC/Link": "plc.link",
    "PLC/Stop Latched": "plc.stop_latched",
    "PLC/Recipe": "plc.recipe",
    "Function Check": "function_check",
}
NODE = {  # of the gateway itself
    "Configuration/In Force": "configuration.in_force",
    "Configuration/Reviewed": "configuration.reviewed",
    "Configuration/As Reviewed": "configuration.as_reviewed",
    "Update/Stage": "update.stage",
    "Update/Outcome": "update.outcome",
    "Certificates/Days": "certificate_days",
    "Properties/Pages": "pages",
}
VISIT = {  # of the newest visit that is over
    "Visit/Last/Begun": "begun_ms",
    "Visit/Last/Length": "length_s",
    "Visit/Last/End": "end.code",
    "Visit/Last/To Position": "to_position_s",
    "Visit/Last/In Place": "in_place_s",
    "Visit/Last/Times In Place": "times_in_place",
    "Visit/Last/Corrections": "corrections",
    "Visit/Last/Stop Latency": "stop_latency_ms",
    "Visit/Last/Halt": "halt_s",
    "Visit/Last/Overrun": "overrun_mm",
    "Visit/Last/Radius": "radius_px",
    "Visit/Last/Distance": "distance_mm",
    "Visit/Last/Offset": "offset_mm",
    "Visit/Last/Visible": "visible",
    "Visit/Last/Contrast": "contrast",
    "Visit/Last/Moved": "moved",
    "Visit/Last/Faults": "fault_times",
    "Visit/Last/Interrupted": "interrupted",
}


def quality_code(quality: Quality) -> QualityCode:
    """STALE: was good, and is too old or lost; BAD: never was, or is known to be wrong."""
    if quality is Quality.GOOD:
        return QualityCode.GOOD
    return QualityCode.STALE if quality in (Quality.STALE, Quality.LINK_DOWN) else QualityCode.BAD


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a bay shows beside its state: the alarms, and the outbox of the history."""

    alarms: BayAlarms = field(default_factory=BayAlarms)
    waiting: int = 0  # changes that were not sent in this session
    dropped: int = 0
    file_ok: bool | None = None  # None: in memory only


def _alarms(name: str, kind: type, meaning: str, read: Callable[[BayAlarms], Value]) -> Shown[Surroundings]:
    return Shown(
        name, kind, meaning, lambda s: read(s.alarms) if s.alarms.evaluated else None, "nothing evaluates them"
    )


def _of_priority(priority: str, alarms: BayAlarms) -> int:
    return alarms.by_priority[priority]


SURROUNDINGS: tuple[Shown[Surroundings], ...] = (
    Shown("Outbox/Waiting", int, "changes kept that were not sent in this session", lambda s: s.waiting),
    Shown("Outbox/Dropped", int, "changes given up since the start", lambda s: s.dropped),
    Shown("Outbox/File OK", bool, "its file can be written", lambda s: s.file_ok, "in memory only"),
    _alarms("Alarms/Unacknowledged", int, "alarms of bay and gateway that wait for an operator",
            lambda a: a.unacknowledged),
    _alarms("Alarms/Active", int, "alarms whose cause holds", lambda a: a.active),
    *(_alarms(f"Alarms/Active {priority.capitalize()}", int, f"of these with priority {priority}",
              partial(_of_priority, priority)) for priority in ALARM_PRIORITIES),
    _alarms("Alarms/Highest Priority", str, "of the active ones: low, medium, high; none",
            lambda a: a.highest_priority or "none"),
)  # fmt: skip
ALARM = "Alarms/State/"  # and the alarm's kind: one metric for each, a String
GATEWAY_ALARM = "Alarms/Gateway State/"

ROWS: dict[str, Shown[Any]] = {
    **{name: BAY_VALUES[value] for name, value in DEVICE.items()},
    **{name: VISIT_VALUES[value] for name, value in VISIT.items()},
    **{row.name: row for row in SURROUNDINGS},
    **{name: GATEWAY_VALUES[value] for name, value in NODE.items()},
}

HISTORY = ("Stop", "May Move", "In Place", "Moved", "Reason/Code", "Reason/Name")
"""What is kept of a change of stop."""
KEPT = frozenset({*HISTORY, *VISIT})

Reading = tuple[Value, QualityCode]


def readings(
    state: StateVector, visit: VisitSummary | None = None, around: Surroundings | None = None
) -> dict[str, Reading]:
    """Every device metric as it would be sent now. `visit`: the newest that is over."""
    found = {name: _reading(name, state, quality_code(ROWS[name].quality(state))) for name in DEVICE}
    return found | visit_readings(visit) | _around_readings(Surroundings() if around is None else around)


def _around_readings(around: Surroundings) -> dict[str, Reading]:
    """The outbox, the sums of the alarms, and the state of each of them by its name in ISA-18.2."""
    values: dict[str, Value] = {row.name: row.of(around) for row in SURROUNDINGS}
    for prefix, alarms in ((ALARM, around.alarms.bay), (GATEWAY_ALARM, around.alarms.gateway)):
        values |= {prefix + alarm.kind: alarm.state if around.alarms.evaluated else None for alarm in alarms}
    return {name: (value, QualityCode.STALE if value is None else QualityCode.GOOD) for name, value in values.items()}


def visit_readings(visit: VisitSummary | None) -> dict[str, Reading]:
    """Those of the newest visit alone."""
    if visit is None:
        return dict.fromkeys(VISIT, (None, QualityCode.BAD))
    return {name: _reading(name, visit, QualityCode.GOOD) for name in VISIT}


def node_readings(facts: GatewayFacts) -> dict[str, Reading]:
    """Those of the gateway itself."""
    return {name: _reading(name, facts, QualityCode.GOOD) for name in NODE}


def _reading(name: str, source: object, quality: QualityCode) -> Reading:
    """Of what is not known, though what it rests on is good: BAD."""
    row = ROWS[name]
    found = row.of(source)
    if isinstance(found, Enum):
        found = found.name
    elif isinstance(found, tuple):
        found = ", ".join(found)
    elif isinstance(found, float):
        found = round(found, _OWN_DIGITS.get(name, _DIGITS[row.unit])) if abs(found) < 1e300 else None
    return found, QualityCode.BAD if found is None and quality is QualityCode.GOOD else quality


def _datatype(name: str) -> DataType:
    return DataType.DATETIME if name == "Visit/Last/Begun" else _DATATYPES.get(ROWS[name].kind, DataType.STRING)


def metrics(now: dict[str, Reading], timestamp_ms: int, *, birth: bool = False) -> tuple[Metric, ...]:
    """`now` as metrics, in the table's order, then the single alarms. Births carry units."""
    rows = [(name, _datatype(name), _unit(name)) for name in ROWS if name in now]
    rows += [(name, DataType.STRING, "") for name in sorted(now) if name.startswith((ALARM, GATEWAY_ALARM))]
    return tuple(
        Metric(name, timestamp_ms, datatype, value, quality=quality, unit=unit if birth else "")
        for name, datatype, unit in rows
        for value, quality in (now[name],)
    )


def _unit(name: str) -> str:
    return "" if _datatype(name) is DataType.DATETIME else ROWS[name].unit
