"""The method `Trigger` of a bay."""

from typing import Any

from asyncua import Server, ua

from gateway.config import GatewayConfig
from gateway.core.plc import Acquired, TriggerPhase, Writer
from gateway.durations import NS_PER_S
from gateway.opcua.conditions import done
from gateway.opcua.hardened import CALLER
from gateway.opcua.space import INDEX, node_id
from gateway.web.ipc.messages import TriggerMeasurement
from gateway.web.server.gateway_client import GatewayClient

GRACE_S = 3.0  # beyond the measurement's own time
OUTPUTS = (
    ("AcquisitionId", ua.VariantType.UInt16, "number of the measurement"),
    ("Outcome", ua.VariantType.String, "IN_PLACE, NOT_IN_PLACE, NO_TARGET or SENSOR_FAULT"),
    ("RadiusPx", ua.VariantType.Double, "R; NaN: none"),
    ("DistanceMm", ua.VariantType.Double, "Z; NaN: none"),
)


async def add_trigger(server: Server, config: GatewayConfig, client: GatewayClient) -> None:
    """A method of each bay, where the configuration permits writes here and to the handshake block."""
    if config.opcua is None or not (config.opcua.writes and config.modbus.writes):
        return
    limit_s = config.modbus.handshake.trigger_timeout_s + GRACE_S
    outputs = [
        ua.Argument(Name=name, DataType=ua.NodeId(kind.value), ValueRank=-1, Description=ua.LocalizedText(words))
        for name, kind, words in OUTPUTS
    ]
    for bay in config.bays:

        async def called(parent: ua.NodeId, *given: Any, bay: str = bay.name) -> Any:
            return await _measured(client, bay, limit_s)

        await server.get_node(node_id(bay.name)).add_method(
            node_id(bay.name, "Trigger"), ua.QualifiedName("Trigger", INDEX), called, [], outputs
        )


async def _measured(client: GatewayClient, bay: str, limit_s: float) -> list[ua.Variant] | ua.StatusCode:
    caller = CALLER.get()
    if not caller.writes:
        return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
    who = Writer(caller.address, caller.subject, caller.role)
    status = await done(client.command(TriggerMeasurement(bay), who))
    if not status.is_good():
        return status
    until_ns, number = client.clock.now_ns() + round(limit_s * NS_PER_S), client.answers
    with client.watching(bay):
        while client.clock.now_ns() < until_ns:
            report = await client.newer(bay, number, limit_s)
            if report is None:
                break
            number, plc = report.number, report.now.state.plc
            if plc.result is not None:
                return _outputs(plc.result)
            if plc.phase is not TriggerPhase.ACQUIRING:
                break
    return ua.StatusCode(ua.StatusCodes.BadTimeout)


def _outputs(found: Acquired) -> list[ua.Variant]:
    numbers = (found.number, found.outcome.name, *map(_number, (found.radius_px, found.distance_mm)))
    return [ua.Variant(value, kind) for value, (_, kind, _) in zip(numbers, OUTPUTS, strict=True)]


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
