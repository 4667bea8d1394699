"""Part of a recording to be written in another format: states, events and pictures from one moment to another. IO."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gateway.core.marker_wear import MarkerWear
from gateway.core.plc import PlcConnection, PlcWrite
from gateway.core.readings import RangeReading, VisionReading
from gateway.core.state import FunctionCheck, StateVector, Tick
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.records import moment, names, picture_search, recording
from gateway.records.moment import unix_ns
from gateway.records.record import Decision, EventRecord, FrameRecord, VisitRecord, outputs
from gateway.records.recorded_rules import RecordedRules
from gateway.records.recording import Item, MissingItem
from gateway.records.replay import Difference, NoTick, Replay, Step
from gateway.records.segment import RecordedPicture
from gateway.values.bay_values import BAY_VALUES
from gateway.values.value import Value as Shown
from gateway.values.value import plain

Value = str | int | float | bool | None
Row = dict[str, Value]
ENTERED = (
    (VisionReading, "frame"), (RangeReading, "distance"), (PlcWrite, "write"), (PlcConnection, "connection"),
    (FunctionCheck, "function_check"), (MarkerWear, "marker"), (Tick, "tick"), (NoTick, "nothing"),
)  # fmt: skip

COLUMNS = {  # of a state: value of the table
    "stop": "stop", "may_move": "may_move", "in_place": "in_place", "moved": "moved", "reason": "reason", "d": "d",
    "phase": "phase", "guidance": "guidance", "vision": "vision.quality", "frame_id": "frame_id",
    "frame_age_ms": "vision.age_ms", "tracking": "tracking", "radius_px": "radius_px", "u_px": "u_px", "v_px": "v_px",
    "range": "range.quality", "range_age_ms": "range.age_ms", "distance_mm": "distance_mm",
    "closing_mm_s": "guidance.closing_mm_s", "plc": "plc.link", "plc_heartbeat": "plc.heartbeat",
    "plc_control": "plc.control", "recipe": "plc.recipe", "latched": "plc.stop_latched",
    "function_check": "function_check", "drive_enable": "drive.enable", "drive_state": "drive.state",
    "drive_speed_setpoint_mm_s": "drive.speed_setpoint_mm_s", "drive_stopping_mm": "drive.stopping_mm",
    "pose_x_mm": "pose.x_mm", "pose_y_mm": "pose.y_mm", "pose_z_mm": "pose.z_mm", "pose_x_sd_mm": "pose.x_sd_mm",
    "pose_y_sd_mm": "pose.y_sd_mm", "pose_z_sd_mm": "pose.z_sd_mm",
}  # fmt: skip


@dataclass(slots=True)
class Excerpt:
    """`begin_ns`, `end_ns`: Unix. `hz`: states a second at most, beside every change of the outputs; None: all.

    `missing`, `differing` and `visits`, those that ended in that time, are complete when `moments` has ended. It may be
    called more than once.
    """

    folder: Path
    paths: list[Path]
    begin_ns: int
    end_ns: int
    hz: float | None = None
    missing: list[str] = field(default_factory=list)
    differing: int = 0
    visits: list[VisitSummary] = field(default_factory=list)

    @staticmethod
    def of(folder: Path, begin: str | None, end: str | None, hz: float | None = None) -> "Excerpt":
        """Times as people write them (moment.py); None: the recording's own. Raises ConfigError."""
        paths = recording.segments_of([folder])
        begin_ns, end_ns = asked_span(paths, begin, end)
        return Excerpt(folder, paths, begin_ns, end_ns, hz)

    def moments(self) -> Iterator[Step | tuple[int, EventRecord]]:
        """The steps, at most `hz` a second and those that change the outputs, and the events (with Unix ns)."""
        self.missing, self.differing, self.visits = [], 0, []
        rules = RecordedRules()
        replay = Replay(rules)
        newest_ns: int | None = None
        last: tuple[object, ...] = ()
        events: list[tuple[int, EventRecord]] = []
        for found in replay.run(rules.readable(self._items(events))):
            while events:
                at_ns, event = events.pop(0)
                if self.begin_ns <= at_ns <= self.end_ns:
                    yield at_ns, event
            if isinstance(found, Difference):
                self.differing += self.begin_ns <= unix_ns(found.place.head, found.t_ns) <= self.end_ns
                continue
            at_ns = unix_ns(found.place.head, found.state.t_ns)
            if not self.begin_ns <= at_ns <= self.end_ns:
                continue
            now = outputs(Decision.of(found.state))
            due = self.hz is None or newest_ns is None or at_ns - newest_ns >= NS_PER_S / self.hz
            if due or now != last:
                newest_ns = at_ns if due else newest_ns
                last = now
                yield found
        yield from ((t, e) for t, e in events if self.begin_ns <= t <= self.end_ns)
        self.missing = replay.missing

    def pictures(self) -> Iterator[RecordedPicture]:
        """Those kept of that time, in their order."""
        return picture_search.pictures_near(self.folder, self.begin_ns, self.end_ns)

    def readings(self) -> dict[tuple[int, int], VisionReading]:
        """What vision reported of each frame, by its number and capture time (monotonic ns)."""
        found = {}
        for item in self._items([]):
            if not isinstance(item, MissingItem) and isinstance(record := item[1], FrameRecord):
                found[record.reading.frame_id, record.reading.t_ns] = record.reading
        return found

    def _items(self, events: list[tuple[int, EventRecord]]) -> Iterator[Item | MissingItem]:
        for item in recording.records(needed(self.paths, self.begin_ns, self.end_ns)):
            if not isinstance(item, MissingItem):
                place, record = item
                at_ns = unix_ns(place.head, record.t_ns)
                if isinstance(record, EventRecord):
                    events.append((at_ns, record))
                elif isinstance(record, VisitRecord):
                    if record.visit.end is not VisitEnd.OPEN and self.begin_ns <= at_ns <= self.end_ns:
                        self.visits.append(record.visit)
                elif at_ns > self.end_ns + 60 * NS_PER_S:
                    break
            yield item


def asked_span(paths: list[Path], begin: str | None, end: str | None) -> tuple[int, int]:
    """From when to when (Unix ns), of times as people write them; None: the recording's own. Raises ConfigError."""
    first_ns, last_ns = _span(paths)
    begin_ns, end_ns = first_ns, last_ns
    if begin is not None:
        begin_ns = moment.resolved(moment.parsed(begin), first_ns, last_ns)
    if end is not None:
        asked = moment.parsed(end)
        end_ns = moment.resolved(asked, first_ns, last_ns)
        end_ns += round(asked.length_s * NS_PER_S) if asked.length_s < 60 else 0  # to 03:30: its first moment
    if end_ns < begin_ns:
        raise ConfigError(f"--to {moment.shown(end_ns)} is before --from {moment.shown(begin_ns)}")
    return begin_ns, end_ns


def needed(paths: list[Path], begin_ns: int, end_ns: int) -> list[Path]:
    """Without the segments that end before that time or begin behind it, by their names."""
    begins = [name.unix_s for path in paths if (name := names.parsed(path.name)) is not None]
    first = max((n for n, unix_s in enumerate(begins) if (unix_s + 60) * NS_PER_S < begin_ns), default=0)
    last = max((n for n, unix_s in enumerate(begins) if (unix_s - 60) * NS_PER_S <= end_ns), default=first)
    return paths[first : last + 1]


def state_row(step: Step) -> Row:
    """One state, flat: units are in the names, empty is not known."""
    state, at_ns = step.state, unix_ns(step.place.head, step.state.t_ns)
    entered = next((name for kind, name in ENTERED if isinstance(step.observation, kind)), "start")
    return {
        "time": moment.shown(at_ns),
        "unix_s": round(at_ns / NS_PER_S, 6),
        "seq": state.seq,
        "heartbeat": state.heartbeat,
        "entered": entered,
        **{name: _cell(BAY_VALUES[value], state) for name, value in COLUMNS.items()},
    }


def _cell(row: Shown[StateVector], state: StateVector) -> Value:
    found = plain(row, state, 1 if row.unit == "ms" else 3)
    return int(found) if isinstance(found, bool) else found


def event_row(at_ns: int, event: EventRecord) -> Row:
    return {
        "time": moment.shown(at_ns),
        "unix_s": round(at_ns / NS_PER_S, 6),
        "kind": event.kind,
        "sensor": event.sensor,
        "quality": event.quality.name.lower(),
        "detail": event.detail,
    }


def _span(paths: list[Path]) -> tuple[int, int]:
    def times(path: Path) -> list[int]:
        dated = (item for item in recording.records([path]) if not isinstance(item, MissingItem))
        return [unix_ns(place.head, record.t_ns) for place, record in dated]

    first = next((found[0] for path in paths if (found := times(path))), None)
    last = next((found[-1] for path in reversed(paths) if (found := times(path))), None)
    if first is None or last is None:
        raise ConfigError(f"{paths[0].parent}: no record in it can be read")
    return first, last
