"""Events, and what happened between two states. Pure: (old, new) -> events, in a fixed order."""

from dataclasses import dataclass
from enum import StrEnum

from gateway.core import details
from gateway.core.detection import Circle
from gateway.core.plc import (
    Handshake,
    PlcLink,
    PlcWrite,
    RecipeVerdict,
    RegisterChange,
    ResetVerdict,
    Writer,
    WriteVerdict,
)
from gateway.core.readings import RANGE_FINE, VISION_FINE, Quality
from gateway.core.shown import lapsed, resumed, valid
from gateway.core.state import Moved, StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_S
from gateway.replacing import replace

MAX_DETAIL_CHARS = 1000  # of an event that people have caused


class EventKind(StrEnum):
    """What happened. The names are on the wire."""

    START = "start"
    SHUTDOWN = "shutdown"
    OUTPUTS_WITHDRAWN = "outputs_withdrawn"
    OUTPUTS_RETURNED = "outputs_returned"
    STOP_RAISED = "stop_raised"
    STOP_CLEARED = "stop_cleared"
    TARGET_FOUND = "target_found"
    TARGET_LOST = "target_lost"
    IN_PLACE = "in_place"
    IN_PLACE_ENDED = "in_place_ended"
    MOVED = "moved"
    ROLLING = "rolling"
    RELEASED = "released"
    VISIT_ENDED = "visit_ended"
    VISIT = "visit"
    SENSOR_FAULT = "sensor_fault"
    SENSOR_RECOVERED = "sensor_recovered"
    PLC_LOST = "plc_lost"
    PLC_RETURNED = "plc_returned"
    PLC_WRITE = "plc_write"
    WRITE_REFUSED = "write_refused"
    OWNER_CHANGED = "owner_changed"
    LATCH_RELEASED = "latch_released"
    RECIPE_CHANGED = "recipe_changed"
    FUNCTION_CHECK_BEGUN = "function_check_begun"
    FUNCTION_CHECK_ENDED = "function_check_ended"
    SETTINGS_CHANGED = "settings_changed"
    OPERATOR_MARK = "operator_mark"
    OPERATION_RELEASED = "operation_released"
    OPERATION_RELEASE_VOID = "operation_release_void"


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened in one bay. Identity (a unique id) is given where it is published."""

    kind: EventKind
    bay: str
    t_ns: int
    state: StateVector
    sensor: str = ""  # "vision", "range" or "cross_check", for the sensor events
    quality: Quality = Quality.GOOD  # of that sensor
    detail: str = ""
    writer: Writer | None = None  # who wrote, for the events about writes
    change: RegisterChange | None = None  # what a write has changed
    summary: VisitSummary | None = None  # of the visit that is over


def diff(old: StateVector, new: StateVector) -> list[Event]:
    """Causes before consequences: people, sensors, the PLC, then the target, then stop.

    A sensor that changes from one fault to another is reported again; WAITING (nothing received yet) is not a fault.
    Where `old` has been shown withdrawn meanwhile, that comes first, with its own time.
    """
    going_on = resumed(old, new.t_ns)
    if going_on is old:
        return _changes(old, new)
    found: list[Event] = []
    last = lapsed(old, new.t_ns)
    if last is not None:  # else it was made meanwhile, and this has been reported
        silent = details.CONTROL_SILENT()
        found.append(Event(EventKind.OUTPUTS_WITHDRAWN, new.bay, last.t_ns, last, detail=silent))
        found += [replace(event, state=last) for event in _changes(old, replace(going_on, t_ns=last.t_ns))]
    if valid(new, new.t_ns):
        silent_s = (new.t_ns - old.valid_until_ns) / NS_PER_S
        again = details.CONTROL_AGAIN(f"{silent_s:.2f}")
        found.append(Event(EventKind.OUTPUTS_RETURNED, new.bay, new.t_ns, new, detail=again))
    return found + _changes(going_on, new)


def _changes(old: StateVector, new: StateVector) -> list[Event]:
    return [
        *_edge(old, new, was=bool(old.function_check), now=bool(new.function_check), kinds=_FUNCTION_CHECK),
        *_sensor("vision", old, new),
        *_sensor("range", old, new),
        *_cross_check(old, new),
        *_plc(old, new),
        *_edge(old, new, was=old.memory.target_seen, now=new.memory.target_seen, kinds=_TARGET),
        *_visit(old, new),
        *_edge(old, new, was=old.stop, now=new.stop, kinds=_STOP),
    ]


def of_write(old: StateVector, new: StateVector, write: PlcWrite) -> list[Event]:
    """What `write`, which made `new` of `old`, has changed; or that it was refused."""
    writer, verdict = write.writer, new.plc.write_verdict
    if verdict in (WriteVerdict.CONFLICT, WriteVerdict.OTHER_CONNECTION):
        detail = details.OTHER_OWNER(writer, new.plc.owner)
        if verdict is WriteVerdict.OTHER_CONNECTION:
            detail = details.TWO_PROGRAMS(writer, write.connection, new.plc.owner_connection)
        return [Event(EventKind.WRITE_REFUSED, new.bay, new.t_ns, new, detail=detail, writer=writer)]
    return [
        Event(EventKind.PLC_WRITE, new.bay, new.t_ns, new, detail=f"{writer}: {change}", writer=writer, change=change)
        for change in changes(old.plc, new.plc)
    ]


def changes(before: Handshake, after: Handshake) -> list[RegisterChange]:
    """What a write has changed of the registers that mean something by themselves; the heartbeat is only counted."""
    pairs = (("plc_control", before.control, after.control), ("recipe_select", before.recipe_asked, after.recipe_asked))
    return [RegisterChange(register, old, new) for register, old, new in pairs if new != old]


_TARGET = (EventKind.TARGET_FOUND, EventKind.TARGET_LOST)
_STOP = (EventKind.STOP_RAISED, EventKind.STOP_CLEARED)
_FUNCTION_CHECK = (EventKind.FUNCTION_CHECK_BEGUN, EventKind.FUNCTION_CHECK_ENDED)


def _edge(
    old: StateVector, new: StateVector, *, was: bool, now: bool, kinds: tuple[EventKind, EventKind]
) -> list[Event]:
    if was == now:
        return []
    return [Event(kinds[0] if now else kinds[1], new.bay, new.t_ns, new)]


def _sensor(name: str, old: StateVector, new: StateVector) -> list[Event]:
    vision = name == "vision"
    fine = VISION_FINE if vision else RANGE_FINE
    before = old.vision.quality if vision else old.range.quality
    after = new.vision.quality if vision else new.range.quality
    detail = new.vision.detail if vision else new.range.detail
    if after not in fine and after is not before:
        return [Event(EventKind.SENSOR_FAULT, new.bay, new.t_ns, new, name, after, detail)]
    if after in fine and before not in fine:
        return [Event(EventKind.SENSOR_RECOVERED, new.bay, new.t_ns, new, name, after)]
    return []


def _cross_check(old: StateVector, new: StateVector) -> list[Event]:
    if old.memory.disagree == new.memory.disagree:
        return []
    kind = EventKind.SENSOR_FAULT if new.memory.disagree else EventKind.SENSOR_RECOVERED
    detail = ""
    if new.memory.disagree and new.z_vision_mm is not None and new.range.distance_mm is not None:
        detail = details.CAMERA_SEES(f"{new.z_vision_mm:.0f}", f"{new.range.distance_mm:.0f}")
    elif new.memory.disagree and new.vision.circle is not None and new.range.distance_mm is not None:
        detail = details.OTHER_SCALE(_where(new.range.distance_mm, new.vision.circle))
    return [Event(kind, new.bay, new.t_ns, new, "cross_check", Quality.GOOD, detail)]


def _visit(old: StateVector, new: StateVector) -> list[Event]:
    """In place, moved, released, gone; `detail` of a move has the values before and after."""
    was, now = old.visit, new.visit
    found: list[tuple[EventKind, str]] = []
    if now.in_place and not was.in_place and now.place is not None:
        found.append((EventKind.IN_PLACE, _where(now.place.distance_mm, now.place.circle)))
    if now.rolling and not was.rolling and was.reference is not None and now.reference is not None:
        distance_mm, circle = was.reference.distance_mm, was.reference.circle
        after = _where(new.range.distance_mm, new.vision.circle)
        found.append((EventKind.ROLLING, details.ROLLING(now.reference.sensor, _where(distance_mm, circle), after)))
    if now.moved is not was.moved and now.moved is not Moved.NO and now.place is not None:
        before = _where(now.place.distance_mm, now.place.circle)
        after = _where(new.range.distance_mm, new.vision.circle)
        found.append((EventKind.MOVED, details.moved_from_to(now.moved, before, after)))
    if was.in_place and not now.in_place:
        found.append((EventKind.IN_PLACE_ENDED, now.ended or details.NOT_VOUCHED()))
    if now.released and not was.released:
        found.append((EventKind.RELEASED, details.BY_PLC()))
    if was.monitored and not now.monitored and now.clear_since_ns is not None:
        found.append((EventKind.VISIT_ENDED, details.CLEAR()))
    return [Event(kind, new.bay, new.t_ns, new, detail=detail) for kind, detail in found]


def _where(distance_mm: float | None, circle: Circle | None) -> str:
    at = () if circle is None else (f"{circle.radius_px:.1f}", f"{circle.u_px:.0f}", f"{circle.v_px:.0f}")
    if distance_mm is None:
        return details.WHERE_NO_Z(*at) if at else details.WHERE_UNKNOWN()
    return (details.WHERE if at else details.WHERE_UNSEEN)(f"{distance_mm:.0f}", *at)


def _plc(old: StateVector, new: StateVector) -> list[Event]:
    """Changes of the PLC's heartbeat, recipe and reset; its writes are reported where they are accepted."""
    was, now = old.plc, new.plc
    found: list[tuple[EventKind, str]] = []
    if was.owner is not None and now.owner is not None and now.owner.identity != was.owner.identity:
        found.append((EventKind.OWNER_CHANGED, f"{was.owner} -> {now.owner}"))
    if now.link is not was.link:
        if now.link is PlcLink.LOST:
            found.append((EventKind.PLC_LOST, details.HEARTBEAT_STOPPED(now.heartbeat)))
        elif now.link is PlcLink.ALIVE:
            found.append((EventKind.PLC_RETURNED, details.HEARTBEAT_IS(now.heartbeat)))
    if now.recipe != was.recipe:
        found.append((EventKind.RECIPE_CHANGED, details.RECIPE_FROM_TO(was.recipe, now.recipe)))
    elif now.recipe_verdict is not was.recipe_verdict and now.recipe_verdict is not RecipeVerdict.ACTIVE:
        found.append((EventKind.WRITE_REFUSED, details.RECIPE_REFUSED[now.recipe_verdict](now.recipe_asked)))
    if old.memory.latched and not new.memory.latched:
        asked = now.reset_verdict is ResetVerdict.DONE and now.writes != was.writes
        found.append((EventKind.LATCH_RELEASED, details.RESET_BY_PLC() if asked else details.TRUCK_LEFT()))
    return [Event(kind, new.bay, new.t_ns, new, detail=detail) for kind, detail in found]
