"""The content of the messages: one model per kind of topic. Pure.

The models are the contract; docs/schemas holds them as JSON Schema. A field that is added keeps SCHEMA_VERSION, a field
that is removed or changes its meaning raises it. A value that is not good is null, with the reason in a quality.
"""

from enum import StrEnum
from typing import Literal

from pydantic import Field

from gateway.core.events import EventKind
from gateway.core.readings import AgeProof, PictureFault, Quality
from gateway.core.visit_summary import VisitEnd
from gateway.sinks.mqtt.values import Count, Payload
from gateway.sinks.mqtt.visit_payload import VisitPayload
from gateway.values.gateway_values import GATEWAY_VALUES
from gateway.values.models import ShownModel
from gateway.values.visit_values import VISIT_VALUES

SCHEMA_VERSION = 1
SENSORS = ("vision", "range", "cross_check")

Cause = Literal["running", "shutdown", "connection lost"]


class QualityPayload(Payload):
    """Why a sensor's value may or may not be used."""

    name: str = Field(json_schema_extra={"enum": [quality.name for quality in Quality]})
    code: int = Field(json_schema_extra={"enum": [int(quality) for quality in Quality]})


class ReasonPayload(ShownModel):
    """Why `stop` is on."""

    level = "reason."
    name: str
    code: int
    text: str


class SensorPayload(Payload):
    """One sensor: may its value be used, and how old is it?"""

    quality: QualityPayload
    age_ms: float | None = Field(description="of the newest observation at `timestamp_ms`; null: nothing received yet")
    detail: str = Field(description="what went wrong, in words, for people; never to be parsed")


class CameraPayload(SensorPayload):
    """The camera; also, what proves that age."""

    age_proof: str | None = Field(
        None,
        description="`unproven`: nothing does (camera.unproven_age); null: no frame, or a stale one",
        json_schema_extra={"enum": [*AgeProof, None]},
    )


class Measured(ShownModel):
    """The decision and what it rests on; the same fields in a state and in an event."""

    schema_version: Literal[1] = Field(description="raised when a field is removed or changes its meaning")
    site: str
    bay: str
    instance: str = Field(description="the gateway that reports for this bay")
    seq: Count
    timestamp_ms: Count = Field(description="when the state was computed, Unix time, ms")
    timestamp: str = Field(description="the same, ISO 8601, UTC", json_schema_extra={"format": "date-time"})
    stop: bool
    may_move: bool
    in_place: bool
    held: bool
    moved: Literal["NO", "DISTANCE", "MARKER"]
    rolling: bool
    phase: str
    reason: ReasonPayload
    d: bool | None
    u: float | None
    v: float | None
    radius_px: float | None
    distance_mm: float | None
    z_vision_mm: float | None
    vision: CameraPayload
    range: SensorPayload


class RatesPayload(ShownModel):
    """Over about the last second."""

    level = "rates."
    vision_hz: float | None
    range_hz: float | None
    vision_latency_ms: float | None


class CountersPayload(ShownModel):
    """Since the start of the gateway."""

    level = "counters."
    frames: Count
    frames_skipped: Count
    frames_lost: Count
    vision_restarts: Count
    camera_reopens: Count
    range_lines: Count
    range_damaged: Count
    range_gaps: Count
    range_rejected: Count
    ranger_reopens: Count


class PredictedPayload(ShownModel):
    """Where the marker should be while it coasts. To be shown to people; nothing may be decided on it."""

    level = "predicted."
    u: float
    v: float
    radius_px: float


class Ne107Payload(ShownModel):
    """NAMUR NE 107: the bay's own health."""

    level = "ne107."
    name: str
    code: int
    active: tuple[str, ...]


class GuidancePayload(ShownModel):
    """The instruction for the driver and its numbers."""

    level = "guidance."
    name: str
    code: int
    text: str
    amount_mm: float | None
    offset_u_px: float | None
    offset_v_px: float | None
    offset_mm: float | None
    closing_mm_s: float | None
    to_go_mm: float | None


class PlcPayload(ShownModel):
    """The handshake with the PLC."""

    level = "plc."
    link: str
    age_ms: float | None
    stop_latched: bool
    recipe: Count
    acquisition_id: Count
    results_valid: bool
    writes: Count
    write_conflicts: Count


class ScalePayload(ShownModel):
    """R times Z of the marker, a constant of marker and lens, as learned from one visit to the next."""

    level = "scale."
    px_mm: float
    spread: float
    visits: Count
    newest_ms: Count = Field(description="Unix time of the newest of them, ms")
    jump: float | None


class MarkerPayload(ShownModel):
    """How worn the trucks' markers are, by the visits of the last weeks."""

    level = "marker."
    visible: float
    visible_a_day: float | None
    contrast: float
    contrast_a_day: float | None
    days_left: float | None
    worn: bool


class PicturePayload(ShownModel):
    """Figures of the camera's picture itself. Shares are 0 to 1."""

    level = "picture."
    brightness: float
    clipped: float
    contrast: float
    sharpness: float | None
    veil: float | None
    veil_proven: float | None = None
    shift_px: float | None
    faults: tuple[str, ...] = Field(
        json_schema_extra={"items": {"type": "string", "enum": [fault.name for fault in PictureFault]}}
    )


class ExposurePayload(ShownModel):
    """What the camera is set to, where the gateway controls it (`camera.exposure = "marker"`)."""

    level = "exposure."
    state: str
    time_ms: float | None
    gain_db: float | None


class RangersPayload(ShownModel):
    """What each of a bay's rangers measures by itself (docs/sensors.md)."""

    level = "rangers."
    status: Count
    quality_1: str
    distance_1_mm: float | None
    quality_2: str
    distance_2_mm: float | None
    quality_3: str | None
    distance_3_mm: float | None


class BeaconPayload(ShownModel):
    """What the beacon in the pictures proves (`camera.beacon`)."""

    level = "beacon."
    status: str
    latency_ms: float | None


class RelayPayload(ShownModel):
    """The outputs of the ranger's board (`ranger.hcsr04.relay`), as register relay_status has them."""

    level = "relay."
    commanded: str
    in_place: bool
    may_move: bool
    fault: bool


class DrivePayload(ShownModel):
    """For a drive that moves the vehicle."""

    level = "drive."
    enable: bool
    state: str
    speed_setpoint_mm_s: float
    stopping_mm: float | None


class PosePayload(ShownModel):
    """The marker's centre against its taught place, with standard deviations."""

    level = "pose."
    x_mm: float
    y_mm: float
    z_mm: float
    x_sd_mm: float
    y_sd_mm: float
    z_sd_mm: float


class StatePayload(Measured):
    """`<root>/<site>/<bay>/state`, retained. Valid only while the status topic is online and it keeps arriving."""

    status_topic: str = Field(description="topic with the status of this bay's gateway")
    stale_after_ms: Count = Field(description="no newer state for this time: treat the bay as dead, stop on")
    heartbeat: Count
    frame_id: Count
    x_n: float | None
    y_n: float | None
    tracking: str | None
    confidence: float | None
    visible: float | None
    frames_summed: Count | None
    semi_minor_px: float | None
    tilt_deg: float | None
    predicted: PredictedPayload | None = Field(description="null unless vision is COASTED; never to be decided on")
    in_place_ms: float | None
    held_ms: float | None
    scale: ScalePayload | None = Field(description="null: not learned yet, for the recipe in force")
    marker: MarkerPayload | None = Field(None, description="null: fewer than 10 visits")
    picture: PicturePayload | None = Field(description="health of the picture itself; null without a fresh frame")
    exposure: ExposurePayload | None = Field(
        description="exposure time and gain; null: left to the camera, or no fresh frame"
    )
    rangers: RangersPayload | None = Field(description="of a bay with several; null: one, or none can be judged")
    beacon: BeaconPayload | None = Field(None, description="null: none is configured")
    relay: RelayPayload | None = Field(None, description="null: none is configured, or the board does not report it")
    drive: DrivePayload | None = Field(None, description="null: none is configured")
    pose: PosePayload | None = Field(None, description="null: not configured, or a sensor is not GOOD")
    ne107: Ne107Payload
    guidance: GuidancePayload
    plc: PlcPayload
    rates: RatesPayload
    counters: CountersPayload


class WritePayload(Payload):
    """Who wrote to the handshake block, and what it changed."""

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


class StorePayload(Payload):
    """The file that keeps undelivered events through a restart."""

    ok: bool = Field(description="false: it can't be written now; events wait in memory and are delivered all the same")
    detail: str = Field(description="what is wrong, in words, for people; never to be parsed")
    faults: Count = Field(description="times it began to fail")
    recovered: Count = Field(description="events found in it that an earlier start had not delivered")
    unwritten: Count = Field(description="events that only memory holds at the moment")


class ConfigurationPayload(ShownModel):
    """Digests of the gateway's configuration: `gateway check --digest`."""

    rows = GATEWAY_VALUES
    level = "configuration."
    in_force: str
    reviewed: str | None
    as_reviewed: bool | None


class UpdatePayload(ShownModel):
    """The newest `gateway update`."""

    rows = GATEWAY_VALUES
    level = "update."
    stage: str
    outcome: str | None


class GatewayPayload(ShownModel):
    """What the gateway says of itself."""

    rows = GATEWAY_VALUES
    configuration: ConfigurationPayload
    update: UpdatePayload | None = Field(description="null: there was none")
    certificate_days: dict[str, int] = Field(
        description="until the first certificate of `modbus`, `hmi` and `mqtt` ends; without TLS left out"
    )
    pages: str | None


class ActiveAlarmsPayload(Payload):
    """How many alarms of bay and gateway are active, by priority."""

    high: Count
    medium: Count
    low: Count


class LastVisitPayload(ShownModel):
    """The newest visit that is over."""

    rows = VISIT_VALUES
    begun_ms: Count
    end: VisitEnd
    length_s: float
    moved: Literal["NO", "DISTANCE", "MARKER"]
    fault_times: Count


class BayHealthPayload(ShownModel):
    """A bay's health when the status was sent. Its outputs are in its state."""

    bay: str
    title: str = Field(description="`title` of the bay; empty: none")
    function_check: str
    ne107: Ne107Payload
    reason: ReasonPayload
    veil: float | None = Field(description="share of the contrast that dust takes, 0 to 1; null: no fresh frame")
    marker: MarkerPayload | None = Field(description="null: fewer than 10 visits")
    alarms: ActiveAlarmsPayload | None = Field(description="null: nothing evaluates them")
    last_visit: LastVisitPayload | None = Field(description="null: none since the start")


class DeliveryPayload(Payload):
    """The gateway's MQTT link, since the start of the gateway."""

    published: Count = Field(description="messages the broker has acknowledged")
    failed: Count = Field(description="messages it has not; events among them were sent again")
    reconnects: Count = Field(description="connections after the first")
    dropped: Count = Field(description="events given up because the outbox was full")
    queued: Count = Field(description="events waiting for their acknowledgement")
    store: StorePayload | None = Field(None, description="the outbox's file; null: events are kept in memory only")


class StatusPayload(Payload):
    """`<root>/<site>/<instance>/status`, retained; the last will of the gateway."""

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
    gateway: GatewayPayload | None = Field(None, description="null in the will")
    health: tuple[BayHealthPayload, ...] = Field((), description="of each bay; empty in the will")
