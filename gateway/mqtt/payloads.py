"""What the messages say: one model per topic kind, and how a state or an event becomes one. Pure.

The models are the contract; docs/schemas holds them as JSON Schema. A field that is added keeps SCHEMA_VERSION, a field
that goes or changes its meaning raises it. No value is published that is not good: it is null, and a quality says why.
Times are Unix time; `offset_ns` is what turns the monotonic clock into it (wall minus monotonic, ns).
"""

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from gateway import fusion, ne107
from gateway.model import (
    GUIDANCE_MEANING,
    REASON_MEANING,
    Event,
    EventKind,
    Guidance,
    GuidanceCode,
    Quality,
    RangeReading,
    Reason,
    StateVector,
    Tracking,
    VisionReading,
)
from gateway.mqtt.topics import Topics
from gateway.ne107 import Ne107
from gateway.plc import Phase, PlcLink

SCHEMA_VERSION = 1
NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
LAST_MS = 253_402_300_799_999  # 9999-12-31T23:59:59.999Z, the last time ISO 8601 has four digits for
MAX_DETAIL = 500
# Fusion publishes at least once a second (its longest period); what is older comes from a dead control task.
STATE_DEADLINE_NS = 3 * NS_PER_S

# A change of stop is what the plant's records are kept for: dropped last.
PRECIOUS = frozenset({EventKind.STOP_RAISED, EventKind.STOP_CLEARED})
EVENT_MEANING: dict[EventKind, str] = {
    EventKind.START: "the gateway has begun to serve this bay; `stop` is on",
    EventKind.SHUTDOWN: "the gateway ends as asked; `stop` stays on",
    EventKind.STOP_RAISED: "`stop` went from off to on; `reason` says why",
    EventKind.STOP_CLEARED: "`stop` went from on to off",
    EventKind.TARGET_FOUND: "the marker came into sight",
    EventKind.TARGET_LOST: "the marker went out of sight",
    EventKind.SENSOR_FAULT: "`sensor` became unusable, or its fault changed; `quality` and `detail` say how",
    EventKind.SENSOR_RECOVERED: "`sensor` can be used again",
    EventKind.PLC_LOST: "the PLC's heartbeat has stood still for longer than its deadline",
    EventKind.PLC_RETURNED: "the PLC's heartbeat came for the first time, or again",
    EventKind.PLC_WRITE: "the PLC changed a register of the handshake block; `write` says who, and from what to what",
    EventKind.WRITE_REFUSED: "something was written, or tried to be, that had no effect; `detail` says why",
    EventKind.LATCH_RELEASED: "the latched stop was ended; `detail` says by what",
    EventKind.RECIPE_CHANGED: "another recipe is in force",
    EventKind.FUNCTION_CHECK_BEGUN: "a technician works on the bay",
    EventKind.FUNCTION_CHECK_ENDED: "the technician has finished",
}
SENSORS = ("vision", "range", "cross_check")

# Stated in the schema, not checked here: a miscounting sensor must not silence the gateway.
Cause = Literal["running", "shutdown", "connection lost"]
Count = Annotated[int, Field(json_schema_extra={"minimum": 0})]
FROZEN = ConfigDict(frozen=True)
_FRESH_FRAME = (Quality.GOOD, Quality.NO_TARGET, Quality.COASTED)  # a frame stands behind the reading


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
    schema_version: Literal[1] = Field(description="raised when a field goes or changes its meaning")
    site: str
    bay: str
    instance: str = Field(description="the gateway that speaks for this bay")
    seq: Count = Field(description="number of the state in this bay; begins again when the gateway starts")
    timestamp_ms: Count = Field(description="when the state was computed, Unix time, ms")
    timestamp: str = Field(description="the same, ISO 8601, UTC", json_schema_extra={"format": "date-time"})
    stop: bool = Field(description="the truck must stop; also on whenever the gateway can't know")
    permit: bool = Field(description="everything is healthy and fresh, and stop is off")
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
    frames_skipped: Count = Field(description="frames replaced by a newer one before a worker was free")
    frames_lost: Count = Field(description="frames that died with their worker")
    vision_restarts: Count = Field(description="vision workers replaced")
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
    """What the driver is told, and the numbers behind it."""

    model_config = FROZEN
    name: str = Field(json_schema_extra={"enum": [code.name for code in GuidanceCode]})
    code: int = Field(json_schema_extra={"enum": [int(code) for code in GuidanceCode]})
    text: str = Field(description="in words, for people; never to be parsed")
    amount_mm: float | None = Field(description="how much of what `name` says; null: not known")
    offset_u_px: float | None = Field(description="marker minus aim point, to the right; null: no marker or no aim")
    offset_v_px: float | None = Field(description="marker minus aim point, downwards; null: no marker or no aim")
    offset_mm: float | None = Field(description="offset_u_px at the marker's distance; null: size not known")
    closing_mm_s: float | None = Field(description="positive: the truck comes nearer; null: not known")
    to_go_mm: float | None = Field(description="until D = 1; negative: past it; null: not known")


class PlcPayload(BaseModel):
    """The handshake with the PLC."""

    model_config = FROZEN
    link: str = Field(json_schema_extra={"enum": [link.name for link in PlcLink]})
    age_ms: float | None = Field(description="since its heartbeat last changed; null: never came")
    stop_latched: bool
    recipe: Count = Field(description="id of the recipe in force; 0: the configuration as it is")
    acquisition_id: Count = Field(description="number of the newest trigger taken; 0: none")
    results_valid: bool = Field(description="the result of acquisition_id is held for the PLC")
    writes: Count = Field(description="writes taken since the start of the gateway")


class StatePayload(Measured):
    """`<root>/<site>/<bay>/state`, retained. Valid only while the status topic says online and it keeps coming."""

    status_topic: str = Field(description="whether this bay's gateway lives is said there")
    stale_after_ms: Count = Field(description="no newer state for so long: treat the bay as dead, stop on")
    heartbeat: Count = Field(description="+1 with every tick of fusion")
    frame_id: Count = Field(description="of the newest observation of the camera")
    x_n: float | None = Field(description="normalised coordinate, equation 11; null without intrinsics")
    y_n: float | None = Field(description="normalised coordinate, equation 11; null without intrinsics")
    tracking: str | None = Field(
        description="how the position was come by; null: no fresh frame",
        json_schema_extra={"enum": [*(tracking.name for tracking in Tracking), None]},
    )
    confidence: float | None = Field(description="0 to 1; null unless vision is GOOD and the method gives one")
    visible: float | None = Field(description="share of the rim seen, 0 to 1; null unless vision is GOOD and known")
    semi_minor_px: float | None = Field(
        description="of the rim's ellipse; null unless vision is GOOD and it was fitted"
    )
    tilt_deg: float | None = Field(description="of the disc against the line of sight; null like semi_minor_px")
    predicted: PredictedPayload | None = Field(description="null unless vision is COASTED; never to be decided on")
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
        description="unique for ever: <random number of this start>-<count of events since>",
        json_schema_extra={"pattern": "^[0-9a-f]{16}-[1-9][0-9]*$"},
    )
    kind: EventKind
    sensor: str | None = Field(
        description="for the sensor events, else null", json_schema_extra={"enum": [*SENSORS, None]}
    )
    quality: QualityPayload | None = Field(description="of that sensor; null for cross_check and without a sensor")
    write: WritePayload | None = Field(description="for plc_write and write_refused, else null")
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
    schema_version: Literal[1] = Field(description="raised when a field goes or changes its meaning")
    site: str
    instance: str
    status: Life
    cause: Cause
    version: str = Field(description="of the gateway's software")
    boot: str = Field(description="random number of this start: the first part of its event ids")
    bays: tuple[str, ...] = Field(description="the bays this gateway speaks for")
    timestamp_ms: Count | None = Field(description="Unix time, ms; null in the will, which the broker sends later")
    timestamp: str | None = Field(
        description="the same, ISO 8601, UTC", json_schema_extra={"anyOf": [{"format": "date-time"}, {"type": "null"}]}
    )
    delivery: DeliveryPayload | None = Field(description="null in the will")


@dataclass(frozen=True, slots=True)
class Gateway:
    """Who speaks: the same in every message of one start."""

    topics: Topics
    bays: tuple[str, ...]
    version: str
    boot: str


def current(state: StateVector, now_ns: int) -> StateVector:
    """The state as it may be shown now: if nothing computes it any more, stop is on and no value stands."""
    if state.seq == 0 and state.t_ns == 0:  # not computed yet: it is what it says, as of now
        return replace(state, t_ns=now_ns)
    if now_ns - state.t_ns > STATE_DEADLINE_NS:
        return fusion.forced_stop(state, Reason.GATEWAY_FAULT, now_ns)
    return state


def final(state: StateVector, now_ns: int) -> StateVector:
    """The state that stays behind when the gateway ends: stop on, no value."""
    return state if state.reason is Reason.SHUTDOWN else fusion.forced_stop(state, Reason.SHUTDOWN, now_ns)


def state_payload(state: StateVector, gateway: Gateway, offset_ns: int, stale_after_ms: int) -> StatePayload:
    vision, rng = state.vision.stats, state.range.stats
    seen = state.vision if state.vision.quality is Quality.GOOD else None
    return StatePayload(
        **_measured(state, state.t_ns, gateway, offset_ns).__dict__,
        status_topic=gateway.topics.status,
        stale_after_ms=stale_after_ms,
        heartbeat=state.heartbeat,
        frame_id=state.vision.frame_id,
        x_n=_number(seen.x_n, 6) if seen else None,
        y_n=_number(seen.y_n, 6) if seen else None,
        tracking=state.vision.tracking.name if state.vision.quality in _FRESH_FRAME else None,
        confidence=_number(seen.confidence, 4) if seen else None,
        visible=_number(seen.visible, 4) if seen else None,
        semi_minor_px=_number(seen.ellipse.semi_minor_px, 3) if seen and seen.ellipse else None,
        tilt_deg=_number(seen.ellipse.tilt_deg, 2) if seen and seen.ellipse else None,
        predicted=_predicted(state.vision),
        ne107=_ne107(state),
        guidance=_guidance(state.guidance),
        plc=_plc(state),
        rates=RatesPayload(
            vision_hz=_number(vision.rate_hz, 2),
            range_hz=_number(rng.rate_hz, 2),
            vision_latency_ms=_number(vision.latency_ms, 2),
        ),
        counters=CountersPayload(
            frames=vision.frames,
            frames_skipped=vision.skipped,
            frames_lost=vision.lost,
            vision_restarts=vision.restarts,
            camera_reopens=vision.reopens,
            range_lines=rng.lines,
            range_damaged=rng.damaged,
            range_gaps=rng.gaps,
            range_rejected=rng.rejected,
            ranger_reopens=rng.reopens,
        ),
    )


def event_payload(event: Event, number: int, gateway: Gateway, offset_ns: int) -> EventPayload:
    """`number` counts the events of this start from 1."""
    sensor = event.sensor if event.sensor in SENSORS else None
    return EventPayload(
        **_measured(event.state, event.t_ns, gateway, offset_ns).__dict__,
        id=f"{gateway.boot}-{number}",
        kind=event.kind,
        sensor=sensor,
        quality=_quality(event.quality) if sensor in ("vision", "range") else None,
        write=_write(event),
        detail=text(event.detail),
    )


def status_payload(
    gateway: Gateway,
    cause: Cause,
    wall_ns: int | None = None,
    delivery: DeliveryPayload | None = None,
) -> StatusPayload:
    return StatusPayload(
        schema_version=SCHEMA_VERSION,
        site=gateway.topics.site,
        instance=gateway.topics.instance,
        status=Life.ONLINE if cause == "running" else Life.OFFLINE,
        cause=cause,
        version=gateway.version,
        boot=gateway.boot,
        bays=gateway.bays,
        timestamp_ms=None if wall_ns is None else _unix_ms(wall_ns),
        timestamp=None if wall_ns is None else _iso(_unix_ms(wall_ns)),
        delivery=delivery,
    )


def encode(payload: BaseModel) -> bytes:
    """The bytes on the wire: compact JSON, UTF-8."""
    return payload.model_dump_json().encode()


def _measured(state: StateVector, t_ns: int, gateway: Gateway, offset_ns: int) -> Measured:
    circle = state.vision.circle if state.vision.quality is Quality.GOOD else None
    timestamp_ms = _unix_ms(t_ns + offset_ns)
    return Measured(
        schema_version=SCHEMA_VERSION,
        site=gateway.topics.site,
        bay=state.bay,
        instance=gateway.topics.instance,
        seq=state.seq,
        timestamp_ms=timestamp_ms,
        timestamp=_iso(timestamp_ms),
        stop=state.stop,
        permit=state.permit,
        reason=ReasonPayload(name=state.reason.name, code=state.reason, text=REASON_MEANING[state.reason]),
        d=state.d,
        u=_number(circle.u_px, 3) if circle else None,
        v=_number(circle.v_px, 3) if circle else None,
        radius_px=_number(circle.radius_px, 3) if circle else None,
        distance_mm=_number(state.range.distance_mm, 2) if state.range.quality is Quality.GOOD else None,
        z_vision_mm=_number(state.z_vision_mm, 2) if circle else None,
        vision=_sensor(state.vision, t_ns),
        range=_sensor(state.range, t_ns),
    )


def _predicted(reading: VisionReading) -> PredictedPayload | None:
    circle = reading.predicted if reading.quality is Quality.COASTED else None
    if circle is None:
        return None
    u, v, radius = (_number(number, 3) for number in (circle.u_px, circle.v_px, circle.radius_px))
    if u is None or v is None or radius is None:
        return None
    return PredictedPayload(u=u, v=v, radius_px=radius)


def _sensor(reading: VisionReading | RangeReading, t_ns: int) -> SensorPayload:
    waiting = reading.quality is Quality.WAITING
    return SensorPayload(
        quality=_quality(reading.quality),
        age_ms=None if waiting else round(max(0, t_ns - reading.t_ns) / NS_PER_MS, 1),
        detail=text(reading.detail),
    )


def _ne107(state: StateVector) -> Ne107Payload:
    signal = ne107.status(state)
    names = tuple(found.name for found in Ne107 if found in ne107.active(state))
    return Ne107Payload(name=signal.name, code=signal, active=names)


def _guidance(told: Guidance) -> GuidancePayload:
    return GuidancePayload(
        name=told.code.name,
        code=told.code,
        text=GUIDANCE_MEANING[told.code],
        amount_mm=_number(told.amount_mm, 1),
        offset_u_px=_number(told.offset_u_px, 2),
        offset_v_px=_number(told.offset_v_px, 2),
        offset_mm=_number(told.offset_mm, 1),
        closing_mm_s=_number(told.closing_mm_s, 1),
        to_go_mm=_number(told.to_go_mm, 1),
    )


def _plc(state: StateVector) -> PlcPayload:
    plc = state.plc
    came = plc.link not in (PlcLink.UNUSED, PlcLink.WAITING)
    return PlcPayload(
        link=plc.link.name,
        age_ms=round(max(0, state.t_ns - plc.beat_ns) / NS_PER_MS, 1) if came else None,
        stop_latched=state.memory.latched,
        recipe=plc.recipe,
        acquisition_id=plc.acquisition,
        results_valid=plc.phase is Phase.VALID,
        writes=plc.writes,
    )


def _write(event: Event) -> WritePayload | None:
    if event.writer is None:
        return None
    change = event.change
    return WritePayload(
        address=text(event.writer.address),
        subject=text(event.writer.subject),
        role=text(event.writer.role),
        name=change.register if change else None,
        old=change.old if change else None,
        new=change.new if change else None,
    )


def _quality(quality: Quality) -> QualityPayload:
    return QualityPayload(name=quality.name, code=quality)


def _number(value: float | None, digits: int) -> float | None:
    """JSON knows no NaN and no infinity."""
    return None if value is None or not math.isfinite(value) else round(value, digits)


def text(text: str) -> str:
    """At most MAX_DETAIL characters, all of which UTF-8 can carry (a file name from the system may hold others)."""
    return text[:MAX_DETAIL].encode("utf-8", "replace").decode()


def _unix_ms(unix_ns: int) -> int:
    return min(max(0, unix_ns // NS_PER_MS), LAST_MS)


def _iso(unix_ms: int) -> str:
    time = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=unix_ms)
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")
