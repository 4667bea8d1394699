"""The content of the messages: one model per kind of topic. Pure.

The models are the contract; docs/schemas holds them as JSON Schema. A field that is added keeps SCHEMA_VERSION, a field
that is removed or changes its meaning raises it. A value that is not good is null, with the reason in a quality.
"""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from gateway.core.detection import Tracking
from gateway.core.events import EventKind
from gateway.core.ne107 import Ne107
from gateway.core.plc import PlcLink
from gateway.core.readings import ExposureState, PictureFault, Quality
from gateway.core.state import GuidanceCode, Reason
from gateway.sinks.mqtt.visit_payload import VisitPayload

SCHEMA_VERSION = 1
EVENT_MEANING: dict[EventKind, str] = {
    EventKind.START: "the gateway has begun to serve this bay; `stop` is on",
    EventKind.SHUTDOWN: "the gateway ends as requested; `stop` stays on",
    EventKind.OUTPUTS_WITHDRAWN: "the control task did not run: since then every output has shown `stop`, no values",
    EventKind.OUTPUTS_RETURNED: "the control task runs again; `detail` has for how long it did not",
    EventKind.STOP_RAISED: "`stop` changed from off to on; `reason` has the reason",
    EventKind.STOP_CLEARED: "`stop` went from on to off",
    EventKind.TARGET_FOUND: "the marker came into sight",
    EventKind.TARGET_LOST: "the marker went out of sight",
    EventKind.IN_PLACE: "the truck is now in place; `detail` has the position",
    EventKind.IN_PLACE_ENDED: "the truck is not in place any more, or it can't be confirmed; `detail` has the reason",
    EventKind.MOVED: "a truck that was in place has moved without release; `detail` has the values before and after",
    EventKind.ROLLING: "a truck that is in place begins to move without release; `detail`: sensor, before, now",
    EventKind.RELEASED: "the PLC has released the truck: loading is over",
    EventKind.VISIT_ENDED: "the truck that was in place has left the bay",
    EventKind.VISIT: "the visit of a truck is over; `visit` has its times, position and faults",
    EventKind.SENSOR_FAULT: "`sensor` became unusable, or its fault changed; `quality` and `detail` describe it",
    EventKind.SENSOR_RECOVERED: "`sensor` can be used again",
    EventKind.PLC_LOST: "the PLC's heartbeat has not changed for longer than its deadline",
    EventKind.PLC_RETURNED: "the PLC's heartbeat arrived for the first time, or again",
    EventKind.PLC_WRITE: "the PLC changed a register of the handshake block; `write` has the writer and both values",
    EventKind.WRITE_REFUSED: "a write had no effect; `detail` has the reason",
    EventKind.OWNER_CHANGED: "another PLC writes the handshake block from now on; `detail` names it",
    EventKind.LATCH_RELEASED: "the latched stop was ended; `detail` has the cause",
    EventKind.RECIPE_CHANGED: "another recipe is in force",
    EventKind.FUNCTION_CHECK_BEGUN: "a technician works on the bay",
    EventKind.FUNCTION_CHECK_ENDED: "the technician has finished",
    EventKind.SETTINGS_CHANGED: "other settings are in force; `detail` has the user and the changes",
    EventKind.OPERATOR_MARK: "a person wants this moment to be looked at later; `detail` has who, and the note",
}
SENSORS = ("vision", "range", "cross_check")

# Stated in the schema, not checked here: a miscounting sensor must not silence the gateway.
Cause = Literal["running", "shutdown", "connection lost"]
Count = Annotated[int, Field(json_schema_extra={"minimum": 0})]
FROZEN = ConfigDict(frozen=True)


class QualityPayload(BaseModel):
    """Why a sensor's value may or may not be used."""

    model_config = FROZEN
    name: str = Field(json_schema_extra={"enum": [quality.name for quality in Quality]})
    code: int = Field(json_schema_extra={"enum": [int(quality) for quality in Quality]})


class ReasonPayload(BaseModel):
    """Why `stop` is on."""

    model_config = FROZEN
    name: str = Field(json_schema_extra={"enum": [reason.name for reason in Reason]})
    code: int = Field(json_schema_extra={"enum": [int(reason) for reason in Reason]})
    text: str = Field(description="in words, for people; never to be parsed")


class SensorPayload(BaseModel):
    """One sensor: may its value be used, and how old is it?"""

    model_config = FROZEN
    quality: QualityPayload
    age_ms: float | None = Field(description="of the newest observation at `timestamp_ms`; null: nothing received yet")
    detail: str = Field(description="what went wrong, in words, for people; never to be parsed")


class Measured(BaseModel):
    """The decision and what it rests on; the same fields in a state and in an event."""

    model_config = FROZEN
    schema_version: Literal[1] = Field(description="raised when a field is removed or changes its meaning")
    site: str
    bay: str
    instance: str = Field(description="the gateway that reports for this bay")
    seq: Count = Field(description="number of the state in this bay; begins again when the gateway starts")
    timestamp_ms: Count = Field(description="when the state was computed, Unix time, ms")
    timestamp: str = Field(description="the same, ISO 8601, UTC", json_schema_extra={"format": "date-time"})
    stop: bool = Field(description="the truck must stop; also on whenever D is unknown")
    may_move: bool = Field(
        description="the truck may move: stop is off, nothing withholds it; no condition for loading"
    )
    in_place: bool = Field(description="the truck is in place: the only condition for loading")
    held: bool = Field(description="in_place is held by the ranger alone: the marker is covered")
    moved: Literal["NO", "DISTANCE", "MARKER"] = Field(
        description="since it was in place, the truck left it without release: how"
    )
    rolling: bool = Field(description="a truck that was in place moves now, without release: stop loading")
    phase: str = Field(description="phase of the visit: a name of VisitPhase (docs/registers.md); for people")
    reason: ReasonPayload
    d: bool | None = Field(description="D(t), equation 14; null: unknowable")
    u: float | None = Field(description="centre of the marker, px from the left; null unless vision is GOOD")
    v: float | None = Field(description="centre of the marker, px from the top; null unless vision is GOOD")
    radius_px: float | None = Field(description="R, px; null unless vision is GOOD")
    distance_mm: float | None = Field(description="Z, mm; null unless range is GOOD")
    z_vision_mm: float | None = Field(description="distance seen by the camera, mm; null unless known and vision GOOD")
    vision: SensorPayload
    range: SensorPayload


class RatesPayload(BaseModel):
    """Over about the last second."""

    model_config = FROZEN
    vision_hz: float | None = Field(description="vision results a second")
    range_hz: float | None = Field(description="distances a second")
    vision_latency_ms: float | None = Field(description="capture to result, newest frame")


class CountersPayload(BaseModel):
    """Since the start of the gateway."""

    model_config = FROZEN
    frames: Count = Field(description="vision results")
    frames_skipped: Count = Field(description="frames not processed: replaced by a newer one before, or damaged")
    frames_lost: Count = Field(description="frames that ended with their process")
    vision_restarts: Count = Field(description="vision processes replaced")
    camera_reopens: Count
    range_lines: Count = Field(description="good measurement lines")
    range_damaged: Count = Field(description="lines dropped: checksum, length, syntax")
    range_gaps: Count = Field(description="measurements missing by sequence number")
    range_rejected: Count = Field(description="readings the glitch gate held back")
    ranger_reopens: Count


class PredictedPayload(BaseModel):
    """Where the marker should be while it coasts. To be shown to people; nothing may be decided on it."""

    model_config = FROZEN
    u: float = Field(description="px from the left")
    v: float = Field(description="px from the top")
    radius_px: float


class Ne107Payload(BaseModel):
    """NAMUR NE 107: the bay's own health."""

    model_config = FROZEN
    name: str = Field(json_schema_extra={"enum": [signal.name for signal in Ne107]})
    code: int = Field(json_schema_extra={"enum": [int(signal) for signal in Ne107]})
    active: tuple[str, ...] = Field(description="every signal that holds, by name; `name` is the one that counts most")


class GuidancePayload(BaseModel):
    """The instruction for the driver and its numbers."""

    model_config = FROZEN
    name: str = Field(json_schema_extra={"enum": [code.name for code in GuidanceCode]})
    code: int = Field(json_schema_extra={"enum": [int(code) for code in GuidanceCode]})
    text: str = Field(description="in words, for people; never to be parsed")
    amount_mm: float | None = Field(description="amount for the instruction `name`; null: not known")
    offset_u_px: float | None = Field(description="marker minus aim point, to the right; null: no marker or no aim")
    offset_v_px: float | None = Field(description="marker minus aim point, downwards; null: no marker or no aim")
    offset_mm: float | None = Field(description="offset_u_px at the marker's distance; null: size not known")
    closing_mm_s: float | None = Field(description="positive: the truck approaches; null: not known")
    to_go_mm: float | None = Field(description="until D = 1; negative: past it; null: not known")


class PlcPayload(BaseModel):
    """The handshake with the PLC."""

    model_config = FROZEN
    link: str = Field(json_schema_extra={"enum": [link.name for link in PlcLink]})
    age_ms: float | None = Field(description="since its heartbeat last changed; null: never received")
    stop_latched: bool
    recipe: Count = Field(description="id of the recipe in force; 0: the configuration as it is")
    acquisition_id: Count = Field(description="number of the newest accepted trigger; 0: none")
    results_valid: bool = Field(description="the result of acquisition_id is held for the PLC")
    writes: Count = Field(description="writes accepted since the start of the gateway")
    write_conflicts: Count = Field(description="writes refused since then because another PLC owns the block")


class ScalePayload(BaseModel):
    """R times Z of the marker, a constant of marker and lens, as learned from one visit to the next."""

    model_config = FROZEN
    px_mm: float = Field(description="median of R x Z over the visits, px mm")
    spread: float = Field(description="largest minus smallest, as a share of px_mm")
    visits: Count = Field(description="trucks in place that it was learned from, the newest 60 at most")
    newest_ms: Count = Field(description="Unix time of the newest of them, ms")
    jump: float | None = Field(
        description="how much the newest differs from those before, as a share; null: by no more than a tenth"
    )


class PicturePayload(BaseModel):
    """Figures of the camera's picture itself. Shares are 0 to 1."""

    model_config = FROZEN
    brightness: float = Field(description="mean grey level, share of white")
    clipped: float = Field(description="share of the pixels that are burnt out")
    contrast: float = Field(description="from the 5th to the 95th percentile of the grey levels")
    sharpness: float | None = Field(description="of the strongest edges, 0.6 in focus; null: too few edges")
    veil: float | None = Field(description="share of dust or haze; null: too dark to measure")
    veil_proven: float | None = Field(
        None, description="up to this veil the bay was shown to be reliable; null: not shown"
    )
    shift_px: float | None = Field(description="how far the fixed background has moved; null: hidden, or not learned")
    faults: tuple[str, ...] = Field(
        description="what is wrong for some time now; empty: nothing",
        json_schema_extra={"items": {"type": "string", "enum": [fault.name for fault in PictureFault]}},
    )


class ExposurePayload(BaseModel):
    """What the camera is set to, where the gateway controls it (`camera.exposure = "marker"`)."""

    model_config = FROZEN
    state: str = Field(json_schema_extra={"enum": [state.name for state in ExposureState]})
    time_ms: float | None = Field(description="exposure time; null: the camera can't be set")
    gain_db: float | None = Field(description="null: not controlled")


class StatePayload(Measured):
    """`<root>/<site>/<bay>/state`, retained. Valid only while the status topic is online and it keeps arriving."""

    status_topic: str = Field(description="topic with the status of this bay's gateway")
    stale_after_ms: Count = Field(description="no newer state for so long: treat the bay as dead, stop on")
    heartbeat: Count = Field(description="+1 with every tick of fusion")
    frame_id: Count = Field(description="of the newest observation of the camera")
    x_n: float | None = Field(description="normalised coordinate, equation 11; null without intrinsics")
    y_n: float | None = Field(description="normalised coordinate, equation 11; null without intrinsics")
    tracking: str | None = Field(
        description="how the position was obtained; null: no fresh frame",
        json_schema_extra={"enum": [*(tracking.name for tracking in Tracking), None]},
    )
    confidence: float | None = Field(description="0 to 1; null unless vision is GOOD and the method gives one")
    visible: float | None = Field(description="share of the rim seen, 0 to 1; null unless vision is GOOD and known")
    frames_summed: Count | None = Field(
        description="frames whose sum shows the marker; 1: a single one shows it; null unless vision is GOOD"
    )
    semi_minor_px: float | None = Field(
        description="of the rim's ellipse; null unless vision is GOOD and it was fitted"
    )
    tilt_deg: float | None = Field(description="of the disc against the line of sight; null like semi_minor_px")
    predicted: PredictedPayload | None = Field(description="null unless vision is COASTED; never to be decided on")
    in_place_ms: float | None = Field(description="since it is in place, without a break; null: it is not")
    held_ms: float | None = Field(description="since the marker was covered, in place; null: it is not held")
    scale: ScalePayload | None = Field(description="null: not learned yet, for the recipe in force")
    picture: PicturePayload | None = Field(description="health of the picture itself; null without a fresh frame")
    exposure: ExposurePayload | None = Field(
        description="exposure time and gain; null: left to the camera, or no fresh frame"
    )
    ne107: Ne107Payload
    guidance: GuidancePayload
    plc: PlcPayload
    rates: RatesPayload
    counters: CountersPayload


class WritePayload(BaseModel):
    """Who wrote to the handshake block, and what it changed."""

    model_config = FROZEN
    address: str = Field(description="IP address of the writer")
    subject: str = Field(description="of its certificate; empty without TLS")
    role: str = Field(description="in its certificate; empty without TLS")
    name: str | None = Field(description="of the register; null: the write was refused")
    old: Count | None
    new: Count | None


class EventPayload(Measured):
    """`<root>/<site>/<bay>/event`, never retained. A redelivery is the same bytes under the same id."""

    id: str = Field(
        description="unique: <random number of this start>-<count of events since>",
        json_schema_extra={"pattern": "^[0-9a-f]{16}-[1-9][0-9]*$"},
    )
    kind: EventKind
    sensor: str | None = Field(
        description="for the sensor events, else null", json_schema_extra={"enum": [*SENSORS, None]}
    )
    quality: QualityPayload | None = Field(description="of that sensor; null for cross_check and without a sensor")
    write: WritePayload | None = Field(description="for plc_write and write_refused, else null")
    visit: VisitPayload | None = Field(None, description="for visit, else null")
    detail: str = Field(description="in words, for people; never to be parsed")


class Life(StrEnum):
    """The two things a gateway can be."""

    ONLINE = "online"
    OFFLINE = "offline"


class StorePayload(BaseModel):
    """The file that keeps undelivered events through a restart."""

    model_config = FROZEN
    ok: bool = Field(description="false: it can't be written now; events wait in memory and are delivered all the same")
    detail: str = Field(description="what is wrong, in words, for people; never to be parsed")
    faults: Count = Field(description="times it began to fail")
    recovered: Count = Field(description="events found in it that an earlier start had not delivered")
    unwritten: Count = Field(description="events that only memory holds at the moment")


class DeliveryPayload(BaseModel):
    """The gateway's MQTT link, since the start of the gateway."""

    model_config = FROZEN
    published: Count = Field(description="messages the broker has acknowledged")
    failed: Count = Field(description="messages it has not; events among them were sent again")
    reconnects: Count = Field(description="connections after the first")
    dropped: Count = Field(description="events given up because the outbox was full")
    queued: Count = Field(description="events waiting for their acknowledgement")
    store: StorePayload | None = Field(None, description="the outbox's file; null: events are kept in memory only")


class StatusPayload(BaseModel):
    """`<root>/<site>/<instance>/status`, retained; the last will of the gateway."""

    model_config = FROZEN
    schema_version: Literal[1] = Field(description="raised when a field is removed or changes its meaning")
    site: str
    instance: str
    status: Life
    cause: Cause
    version: str = Field(description="of the gateway's software")
    boot: str = Field(description="random number of this start: the first part of its event ids")
    bays: tuple[str, ...] = Field(description="the bays this gateway reports for")
    timestamp_ms: Count | None = Field(description="Unix time, ms; null in the will, which the broker sends later")
    timestamp: str | None = Field(
        description="the same, ISO 8601, UTC", json_schema_extra={"anyOf": [{"format": "date-time"}, {"type": "null"}]}
    )
    delivery: DeliveryPayload | None = Field(description="null in the will")
