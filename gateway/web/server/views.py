"""The live views, made from the gateway client's data: operator's page, driver's display, frame. Pure."""

from gateway import __version__
from gateway.config import BayConfig, GatewayConfig, RecipeConfig
from gateway.core.interlock import Recipe
from gateway.core.pose import Sight, true_radius_mm
from gateway.core.readings import VisionReading
from gateway.core.state import Guidance, GuidanceCode, StateVector
from gateway.durations import NS_PER_MS
from gateway.sinks.mqtt import payloads
from gateway.sinks.mqtt.topics import Gateway, Topics
from gateway.web.server import lists
from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.models import (
    AimView,
    AlarmsLiveView,
    BayView,
    DeadlinesView,
    DriverView,
    FrameView,
    LiveView,
    ThresholdsView,
    said,
    view_of,
)

STALE_AFTER_MS = 500


def gateway_of(client: GatewayClient) -> Gateway:
    """As the messages name it."""
    config = client.about.config
    return Gateway(Topics("hmi", config.site, config.instance), client.bays, __version__, client.about.boot)


def bay_view(client: GatewayClient, config: BayConfig) -> BayView:
    report = client.report(config.name)
    number = 0 if report is None else report.now.state.plc.recipe
    recipe = _in_force(client.about.config, config, number)
    fusion, guidance = recipe.fusion, recipe.guidance
    names = {row.id: row.name for row in client.about.config.recipes}
    handshake = client.about.config.modbus.handshake if client.about.config.modbus.writes else None
    required = handshake is not None and handshake.heartbeat_required
    return BayView(
        bay=config.name,
        title=config.title,
        unit_id=config.unit_id,
        state=None
        if report is None
        else payloads.state_payload(
            report.now.state, gateway_of(client), report.wall_ns - report.now_ns, stale_after_ms=STALE_AFTER_MS
        ),
        vision_said=() if report is None else said(report.now.state.vision.detail),
        range_said=() if report is None else said(report.now.state.range.detail),
        age_ms=client.age_ms(None if report is None else report.now.state.t_ns),
        thresholds=view_of(ThresholdsView, fusion, recipe=number, recipe_name=names.get(number)),
        aim=AimView.model_validate(guidance),
        deadlines=DeadlinesView(
            vision_ms=1000 * fusion.vision_deadline_s,
            range_ms=1000 * fusion.range_deadline_s,
            plc_ms=1000 * handshake.heartbeat_deadline_s if handshake is not None and required else None,
        ),
        function_check="OFF" if report is None else report.now.state.function_check.name,
        method=None if report is None else report.now.vision.method,
        relay=config.ranger.has_relay,
        pose=Sight.of(config) is not None and true_radius_mm(guidance, fusion.cross_check) is not None,
        stage_ms={}
        if report is None
        else {stage: round(took_ns / NS_PER_MS, 3) for stage, took_ns in report.now.state.vision.stage_ns},
    )


def live_json(client: GatewayClient, bays: tuple[str, ...]) -> str:
    """For `Live`: all that the operator's page shows of these bays."""
    return LiveView(
        server_time_ms=client.server_time_ms,
        bays=tuple(bay_view(client, bay) for bay in client.about.config.bays if bay.name in bays),
        alarms=lists.alarm_summary(client),
        links=lists.links_view(client),
        events_newest=client.newest_event,
    ).model_dump_json()


def alarms_json(client: GatewayClient, _: tuple[str, ...]) -> str:
    """For `Live`: the alarm to see first, and how many there are, of all bays."""
    return AlarmsLiveView(alarms=lists.alarm_summary(client) if client.links_known else None).model_dump_json()


def driver_json(client: GatewayClient, bays: tuple[str, ...]) -> str:
    """For `Live`: the driver's display of the first of these bays. Nothing known: FAULT, and stop."""
    bay = bays[0]
    report = client.report(bay)
    state = StateVector(bay, guidance=Guidance(GuidanceCode.FAULT)) if report is None else report.now.state
    guidance = payloads.state_payload(state, gateway_of(client), 0, STALE_AFTER_MS).guidance
    recipe = _recipe(client.about.config, state.plc.recipe)
    return DriverView(
        bay=bay,
        title=next(config.title for config in client.about.config.bays if config.name == bay),
        code=guidance.name,
        text=guidance.text,
        stop=state.stop,
        amount_mm=guidance.amount_mm,
        closing_mm_s=guidance.closing_mm_s,
        to_go_mm=guidance.to_go_mm,
        age_ms=client.age_ms(None if report is None else state.t_ns),
        language=None if recipe is None else recipe.language,
    ).model_dump_json()


def frame_json(reading: VisionReading) -> str:
    """Compact, for a header: ASCII, no line breaks."""
    return FrameView.model_validate(reading).model_dump_json()


def _recipe(gateway: GatewayConfig, number: int) -> RecipeConfig | None:
    return next((recipe for recipe in gateway.recipes if recipe.id == number), None)


def _in_force(gateway: GatewayConfig, bay: BayConfig, number: int) -> Recipe:
    """What the bay decides by now; a recipe that is not known here changes nothing."""
    recipe = _recipe(gateway, number)
    return Recipe(bay.fusion, bay.guidance) if recipe is None else Recipe.of(bay, recipe)
