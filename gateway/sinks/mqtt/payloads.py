"""Converts states and events to the messages of gateway.sinks.mqtt.messages. Pure.

Times are Unix time; `offset_ns` is what turns the monotonic clock into it (wall minus monotonic, ns).
"""

from pydantic import BaseModel

from gateway.core import fusion, ne107
from gateway.core.events import Event, EventKind
from gateway.core.ne107 import Ne107
from gateway.core.plc import PlcLink, TriggerPhase
from gateway.core.readings import FRESH_FRAME, Quality, RangeReading, VisionReading
from gateway.core.state import GUIDANCE_MEANING, REASON_MEANING, Guidance, Reason, StateVector
from gateway.sinks.contract import StoreStatus
from gateway.sinks.mqtt.messages import (
    SCHEMA_VERSION,
    SENSORS,
    Cause,
    CountersPayload,
    DeliveryPayload,
    EventPayload,
    ExposurePayload,
    GuidancePayload,
    Life,
    Measured,
    Ne107Payload,
    PicturePayload,
    PlcPayload,
    PredictedPayload,
    QualityPayload,
    RatesPayload,
    ReasonPayload,
    ScalePayload,
    SensorPayload,
    StatePayload,
    StatusPayload,
    StorePayload,
    WritePayload,
)
from gateway.sinks.mqtt.topics import Gateway
from gateway.sinks.mqtt.values import LAST_MS, iso, number
from gateway.sinks.mqtt.visit_payload import visit_payload

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
MAX_DETAIL = 500
# A change of stop is what the plant's records are kept for: dropped last.
DROPPED_LAST = frozenset({EventKind.STOP_RAISED, EventKind.STOP_CLEARED})


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
        x_n=number(seen.x_n, 6) if seen else None,
        y_n=number(seen.y_n, 6) if seen else None,
        tracking=state.vision.tracking.name if state.vision.quality in FRESH_FRAME else None,
        confidence=number(seen.confidence, 4) if seen else None,
        visible=number(seen.visible, 4) if seen else None,
        frames_summed=seen.frames if seen else None,
        semi_minor_px=number(seen.ellipse.semi_minor_px, 3) if seen and seen.ellipse else None,
        tilt_deg=number(seen.ellipse.tilt_deg, 2) if seen and seen.ellipse else None,
        predicted=_predicted(state.vision),
        in_place_ms=_since_ms(state, state.visit.in_place_since_ns if state.in_place else None),
        held_ms=_since_ms(state, state.visit.covered_since_ns if state.visit.held else None),
        scale=_scale(state, offset_ns),
        picture=_picture(state),
        exposure=_exposure(state),
        ne107=_ne107(state),
        guidance=_guidance(state.guidance),
        plc=_plc(state),
        rates=RatesPayload(
            vision_hz=number(vision.rate_hz, 2),
            range_hz=number(rng.rate_hz, 2),
            vision_latency_ms=number(vision.latency_ms, 2),
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
        visit=None if event.summary is None else visit_payload(event.summary),
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
        timestamp_ms=None if wall_ns is None else unix_ms(wall_ns),
        timestamp=None if wall_ns is None else iso(unix_ms(wall_ns)),
        delivery=delivery,
    )


def store_payload(store: StoreStatus | None) -> StorePayload | None:
    if store is None:
        return None
    return StorePayload(
        ok=not store.fault,
        detail=text(store.fault),
        faults=store.faults,
        recovered=store.recovered,
        unwritten=store.unwritten,
    )


def encode(payload: BaseModel) -> bytes:
    """The bytes on the wire: compact JSON, UTF-8."""
    return payload.model_dump_json().encode()


def _measured(state: StateVector, t_ns: int, gateway: Gateway, offset_ns: int) -> Measured:
    circle = state.vision.circle if state.vision.quality is Quality.GOOD else None
    timestamp_ms = unix_ms(t_ns + offset_ns)
    return Measured(
        schema_version=SCHEMA_VERSION,
        site=gateway.topics.site,
        bay=state.bay,
        instance=gateway.topics.instance,
        seq=state.seq,
        timestamp_ms=timestamp_ms,
        timestamp=iso(timestamp_ms),
        stop=state.stop,
        may_move=state.may_move,
        in_place=state.in_place,
        held=state.visit.held,
        moved=state.visit.moved.name,
        rolling=state.visit.rolling,
        phase=state.visit.phase.name,
        reason=ReasonPayload(name=state.reason.name, code=state.reason, text=REASON_MEANING[state.reason]),
        d=state.d,
        u=number(circle.u_px, 3) if circle else None,
        v=number(circle.v_px, 3) if circle else None,
        radius_px=number(circle.radius_px, 3) if circle else None,
        distance_mm=number(state.range.distance_mm, 2) if state.range.quality is Quality.GOOD else None,
        z_vision_mm=number(state.z_vision_mm, 2) if circle else None,
        vision=_sensor(state.vision, t_ns if state.running else None),
        range=_sensor(state.range, t_ns if state.running else None),
    )


def _predicted(reading: VisionReading) -> PredictedPayload | None:
    circle = reading.predicted if reading.quality is Quality.COASTED else None
    if circle is None:
        return None
    u, v, radius = (number(value, 3) for value in (circle.u_px, circle.v_px, circle.radius_px))
    if u is None or v is None or radius is None:
        return None
    return PredictedPayload(u=u, v=v, radius_px=radius)


def _picture(state: StateVector) -> PicturePayload | None:
    health = state.picture
    if health is None:
        return None
    return PicturePayload(
        brightness=round(health.brightness, 4),
        clipped=round(health.clipped, 4),
        contrast=round(health.contrast, 4),
        sharpness=number(health.sharpness, 4),
        veil=number(health.veil, 4),
        veil_proven=number(health.veil_proven, 4),
        shift_px=number(health.shift_px, 2),
        faults=tuple(fault.name for fault in health.faults),
    )


def _exposure(state: StateVector) -> ExposurePayload | None:
    exposure = state.exposure
    if exposure is None:
        return None
    return ExposurePayload(
        state=exposure.state.name,
        time_ms=number(exposure.time_ms, 3),
        gain_db=number(exposure.gain_db, 2),
    )


def _sensor(reading: VisionReading | RangeReading, t_ns: int | None) -> SensorPayload:
    """`t_ns` None: no age is shown."""
    waiting = reading.quality is Quality.WAITING
    return SensorPayload(
        quality=_quality(reading.quality),
        age_ms=None if t_ns is None or waiting else round(max(0, t_ns - reading.t_ns) / NS_PER_MS, 1),
        detail=text(reading.detail),
    )


def _since_ms(state: StateVector, since_ns: int | None) -> float | None:
    return None if since_ns is None else round(max(0, state.t_ns - since_ns) / NS_PER_MS, 1)


def _scale(state: StateVector, offset_ns: int) -> ScalePayload | None:
    scale = state.memory.scale
    if scale is None:
        return None
    px_mm, spread = number(scale.px_mm, 1), number(scale.spread, 4)
    if px_mm is None or spread is None:
        return None
    newest_ms = min(max(0, scale.newest.date_s(offset_ns) * 1000), LAST_MS)
    return ScalePayload(
        px_mm=px_mm, spread=spread, visits=scale.visits, newest_ms=newest_ms, jump=number(scale.jump, 4)
    )


def _ne107(state: StateVector) -> Ne107Payload:
    signal = ne107.status(state)
    names = tuple(found.name for found in Ne107 if found in ne107.active(state))
    return Ne107Payload(name=signal.name, code=signal, active=names)


def _guidance(guidance: Guidance) -> GuidancePayload:
    return GuidancePayload(
        name=guidance.code.name,
        code=guidance.code,
        text=GUIDANCE_MEANING[guidance.code],
        amount_mm=number(guidance.amount_mm, 1),
        offset_u_px=number(guidance.offset_u_px, 2),
        offset_v_px=number(guidance.offset_v_px, 2),
        offset_mm=number(guidance.offset_mm, 1),
        closing_mm_s=number(guidance.closing_mm_s, 1),
        to_go_mm=number(guidance.to_go_mm, 1),
    )


def _plc(state: StateVector) -> PlcPayload:
    plc = state.plc
    received = state.running and plc.link not in (PlcLink.UNUSED, PlcLink.WAITING)
    return PlcPayload(
        link=plc.link.name,
        age_ms=round(max(0, state.t_ns - plc.beat_ns) / NS_PER_MS, 1) if received else None,
        stop_latched=state.memory.latched,
        recipe=plc.recipe,
        acquisition_id=plc.acquisition,
        results_valid=plc.phase is TriggerPhase.VALID,
        writes=plc.writes,
        write_conflicts=plc.conflicts,
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


def text(text: str) -> str:
    """At most MAX_DETAIL characters, all of which UTF-8 can carry (a file name from the system may hold others)."""
    return text[:MAX_DETAIL].encode("utf-8", "replace").decode()


def unix_ms(unix_ns: int) -> int:
    return min(max(0, unix_ns // NS_PER_MS), LAST_MS)
