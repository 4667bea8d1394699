"""All alarms. Pure."""

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.definition import (
    AlarmDefinition,
    BayInputs,
    GatewayInputs,
)
from gateway.alarms.gateway_alarms import GATEWAY_ALARMS

ALARM_DEFINITIONS: dict[str, AlarmDefinition[BayInputs] | AlarmDefinition[GatewayInputs]] = {
    kind.id: kind for kind in BAY_ALARMS
} | {kind.id: kind for kind in GATEWAY_ALARMS}


def alarm_id(kind: str, bay: str | None = None) -> str:
    """`bay1.camera_down`, or `broker_lost` of the gateway itself. A bay's name holds no dot."""
    return kind if bay is None else f"{bay}.{kind}"
