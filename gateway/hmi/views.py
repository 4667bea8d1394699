"""What the pages are told, as JSON: models and their builders. Pure but for asking the desk for what it has."""

from pydantic import BaseModel, ConfigDict, Field

from gateway import __version__
from gateway.clock import NS_PER_MS
from gateway.config import BayConfig
from gateway.hmi.desk import Desk, Seen
from gateway.model import Circle, VisionReading
from gateway.mqtt import payloads
from gateway.mqtt.messages import StatePayload
from gateway.mqtt.topics import Topics

FROZEN = ConfigDict(frozen=True)
STALE_AFTER_MS = 500


class BayView(BaseModel):
    """One bay, now."""

    model_config = FROZEN
    bay: str
    state: StatePayload | None = Field(description="null: nothing known yet")
    age_ms: float | None = Field(description="of the state, when this was sent")
    radius_threshold_px: float
    distance_threshold_mm: float
    aim_u_px: float | None
    aim_v_px: float | None
    aim_tolerance_px: float


class LiveView(BaseModel):
    """`/api/live`."""

    model_config = FROZEN
    server_time_ms: int
    bays: tuple[BayView, ...]


class DriverView(BaseModel):
    """`/api/driver`: what the driver's display needs, and nothing else."""

    model_config = FROZEN
    bay: str
    code: str
    text: str
    stop: bool
    amount_mm: float | None
    closing_mm_s: float | None
    to_go_mm: float | None
    age_ms: float | None


def _gateway(desk: Desk) -> payloads.Gateway:
    config = desk.about.config
    return payloads.Gateway(Topics("hmi", config.site, config.instance), desk.bays, __version__, desk.about.boot)


def _age_ms(desk: Desk, seen: Seen) -> float:
    return round((desk.clock.now_ns() - seen.now.state.t_ns) / NS_PER_MS, 1)


def bay_view(desk: Desk, config: BayConfig) -> BayView:
    seen = desk.seen(config.name)
    state = age_ms = None
    if seen is not None:
        offset_ns = seen.wall_ns - seen.now_ns
        state = payloads.state_payload(seen.now.state, _gateway(desk), offset_ns, STALE_AFTER_MS)
        age_ms = _age_ms(desk, seen)
    return BayView(
        bay=config.name,
        state=state,
        age_ms=age_ms,
        radius_threshold_px=config.fusion.radius_threshold_px,
        distance_threshold_mm=config.fusion.distance_threshold_mm,
        aim_u_px=config.guidance.aim_u_px,
        aim_v_px=config.guidance.aim_v_px,
        aim_tolerance_px=config.guidance.tolerance_px,
    )


def live_json(desk: Desk, bays: tuple[str, ...]) -> str:
    """For `Live`: all that the operator's page shows of these bays."""
    shown = tuple(bay_view(desk, bay) for bay in desk.about.config.bays if bay.name in bays)
    return LiveView(server_time_ms=desk.clock.wall_ns() // NS_PER_MS, bays=shown).model_dump_json()


def driver_json(desk: Desk, bays: tuple[str, ...]) -> str:
    """For `Live`: the driver's display of the first of these bays. Nothing known: FAULT, and stop."""
    seen = desk.seen(bays[0])
    if seen is None:
        nothing = DriverView(
            bay=bays[0], code="FAULT", text="", stop=True, amount_mm=None, closing_mm_s=None, to_go_mm=None, age_ms=None
        )
        return nothing.model_dump_json()
    told = payloads.state_payload(seen.now.state, _gateway(desk), seen.wall_ns - seen.now_ns, STALE_AFTER_MS).guidance
    return DriverView(
        bay=bays[0],
        code=told.name,
        text=told.text,
        stop=seen.now.state.stop,
        amount_mm=told.amount_mm,
        closing_mm_s=told.closing_mm_s,
        to_go_mm=told.to_go_mm,
        age_ms=_age_ms(desk, seen),
    ).model_dump_json()


class CircleView(BaseModel):
    """A circle in the picture, px."""

    model_config = FROZEN
    u: float
    v: float
    radius_px: float


class EllipseView(BaseModel):
    """The rim of a tilted disc; `angle_rad` from +u towards +v to the major axis."""

    model_config = FROZEN
    u: float
    v: float
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float


class FrameView(BaseModel):
    """What was seen in one picture, in its own pixels."""

    model_config = FROZEN
    frame_id: int
    quality: str
    tracking: str
    circle: CircleView | None
    ellipse: EllipseView | None
    predicted: CircleView | None = Field(description="not measured: where it should be")
    confidence: float | None


def frame_json(reading: VisionReading) -> str:
    """Compact, for a header: ASCII, no line breaks."""

    def circle(found: Circle | None) -> CircleView | None:
        return None if found is None else CircleView(u=found.u_px, v=found.v_px, radius_px=found.radius_px)

    rim = reading.ellipse
    return FrameView(
        frame_id=reading.frame_id,
        quality=reading.quality.name,
        tracking=reading.tracking.name,
        circle=circle(reading.circle),
        ellipse=None
        if rim is None
        else EllipseView(
            u=rim.u_px,
            v=rim.v_px,
            semi_major_px=rim.semi_major_px,
            semi_minor_px=rim.semi_minor_px,
            angle_rad=rim.angle_rad,
        ),
        predicted=circle(reading.predicted),
        confidence=reading.confidence,
    ).model_dump_json()
