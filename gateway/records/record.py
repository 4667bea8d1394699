"""What a recording consists of: everything that entered a bay's control step, in order, and what it decided. Pure.

Records are MessagePack maps with the names of their fields, so that a later version reads those of an earlier one: a
field it does not know is skipped, one that is missing has its default. All times are the gateway's monotonic ns; a
RegisterImage has the Unix time of the same moment.
"""

from collections.abc import Callable
from enum import StrEnum
from operator import attrgetter

import msgspec

from gateway.core.fusion import Observation
from gateway.core.marker_wear import MarkerWear
from gateway.core.plc import PlcConnection, PlcWrite
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.shown import shown
from gateway.core.state import FunctionCheck, GuidanceCode, Moved, Reason, StateVector, Tick, VisitPhase
from gateway.core.visit_summary import VisitSummary
from gateway.errors import ProtocolError
from gateway.modbus.registers.bay_identity import BayIdentity
from gateway.modbus.registers.register import WordOrder
from gateway.modbus.registers.register_map import encode


class NotedKind(StrEnum):
    """Kinds of the EventRecords that are not events of the control step. The names are on the wire."""

    ALARM = "alarm"  # a change of an alarm
    ALARM_ACTION = "alarm_action"  # the same once more, where a person did it
    PICTURES_NOT_KEPT = "pictures_not_kept"  # of which incident, and why


class Record(msgspec.Struct, frozen=True, tag_field="is", omit_defaults=True, kw_only=True):
    """The base of all. `t_ns`: of the control step."""

    t_ns: int


class TickRecord(Record, frozen=True, tag="tick"):
    """The mere passing of time. With `marker` that is what entered: an earlier version reads a tick of it."""

    marker: MarkerWear | None = None


class FrameRecord(Record, frozen=True, tag="frame"):
    reading: VisionReading


class DistanceRecord(Record, frozen=True, tag="distance"):
    reading: RangeReading


class WriteRecord(Record, frozen=True, tag="write"):
    write: PlcWrite


class ConnectionRecord(Record, frozen=True, tag="connection"):
    change: PlcConnection


class FunctionCheckRecord(Record, frozen=True, tag="function_check"):
    mode: FunctionCheck


class Decision(Record, frozen=True, tag="decision"):
    """The outputs after the record before it; recorded where one of them has changed. One that no record made is that
    of a control task that did not run (gateway/core/shown.py)."""

    stop: bool
    may_move: bool
    in_place: bool
    moved: Moved
    reason: Reason
    d: bool | None
    phase: VisitPhase
    guidance: GuidanceCode
    function_check: FunctionCheck
    latched: bool
    recipe: int

    @staticmethod
    def of(state: StateVector) -> "Decision":
        return Decision(
            t_ns=state.t_ns,
            stop=state.stop,
            may_move=state.may_move,
            in_place=state.in_place,
            moved=state.visit.moved,
            reason=state.reason,
            d=state.d,
            phase=state.visit.phase,
            guidance=state.guidance.code,
            function_check=state.function_check,
            latched=state.memory.latched,
            recipe=state.plc.recipe,
        )


OUTPUTS = tuple(name for name in Decision.__struct_fields__ if name != "t_ns")


outputs: Callable[[Decision], tuple[object, ...]] = attrgetter(*OUTPUTS)
"""Its fields but the time, in the order of OUTPUTS."""


class RegisterImage(Record, frozen=True, tag="registers"):
    """The holding registers of the newest state, about once a second. `words`: big-endian, from address 0."""

    unix_ns: int
    words: bytes

    @staticmethod
    def of(state: StateVector, unix_ns: int, word_order: WordOrder, bay: BayIdentity) -> "RegisterImage":
        words = encode(shown(state, state.t_ns), unix_ns, word_order, bay)
        return RegisterImage(
            t_ns=state.t_ns, unix_ns=unix_ns, words=b"".join(word.to_bytes(2, "big") for word in words)
        )


class Checkpoint(Record, frozen=True, tag="checkpoint"):
    """The complete state: a replay may begin here. Unless `follows`, it did not come of the record before it: the
    gateway has started or ended, or records are missing."""

    state: StateVector
    follows: bool = False


class EventRecord(Record, frozen=True, tag="event"):
    """gateway.core.events.Event, without the state."""

    kind: str
    sensor: str = ""
    quality: Quality = Quality.GOOD
    detail: str = ""


class VisitRecord(Record, frozen=True, tag="visit"):
    """A truck's visit: as it ended, and every ten seconds as far as it is known, for a gateway that starts again."""

    visit: VisitSummary


class Gap(Record, frozen=True, tag="gap"):
    """`lost` records before `t_ns` could not be written."""

    lost: int
    why: str


AnyRecord = (
    TickRecord
    | FrameRecord
    | DistanceRecord
    | WriteRecord
    | ConnectionRecord
    | FunctionCheckRecord
    | Decision
    | RegisterImage
    | Checkpoint
    | EventRecord
    | VisitRecord
    | Gap
)

_ENCODER = msgspec.msgpack.Encoder()
_DECODER: msgspec.msgpack.Decoder[list[AnyRecord]] = msgspec.msgpack.Decoder(list[AnyRecord])


def packed(record: Record) -> bytes:
    return _ENCODER.encode(record)


def unpacked(records: bytes) -> list[AnyRecord]:
    """An array of packed records. Raises ProtocolError."""
    try:
        return _DECODER.decode(records)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ProtocolError(f"not records of this version or an earlier one: {error}") from None


def array_of(records: list[bytes]) -> bytes:
    """Packed records as one array."""
    return _ENCODER.encode([msgspec.Raw(record) for record in records])


_FIELD: dict[type[Record], str] = {
    FrameRecord: "reading",
    DistanceRecord: "reading",
    WriteRecord: "write",
    ConnectionRecord: "change",
    FunctionCheckRecord: "mode",
    TickRecord: "marker",
}
_RECORD: dict[type[Observation], type[Record]] = {
    VisionReading: FrameRecord,
    RangeReading: DistanceRecord,
    PlcWrite: WriteRecord,
    PlcConnection: ConnectionRecord,
    FunctionCheck: FunctionCheckRecord,
    MarkerWear: TickRecord,
}


def of_observation(observation: Observation, t_ns: int) -> Record:
    """The record of what entered a control step."""
    kind = _RECORD.get(type(observation))
    return TickRecord(t_ns=t_ns) if kind is None else kind(t_ns=t_ns, **{_FIELD[kind]: observation})


def observed(record: AnyRecord) -> Observation | None:
    """What entered the control step; None: a record of another kind."""
    if isinstance(record, TickRecord):
        return record.marker or Tick()
    name = _FIELD.get(type(record))
    return None if name is None else getattr(record, name)
