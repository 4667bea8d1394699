"""What the gateway says of itself, as nodes of the object Gateway: from the table that MQTT and Sparkplug publish."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from asyncua import Server, ua

from gateway.alarms.definition import Priority
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.opcua import data
from gateway.opcua.space import BayNodes, node_id
from gateway.values.gateway_values import ROWS
from gateway.values.value import Value
from gateway.web.ipc.messages import SystemStatus
from gateway.web.server.gateway_client import GatewayClient


def _rows() -> Iterator[Value[SystemStatus]]:
    for row in ROWS:
        yield Value(row.name, row.kind, row.meaning, partial(_fact, row), row.null)
    for priority in Priority:
        meaning = f"active alarms of {priority.name.lower()} priority, of gateway and bays"
        yield Value(f"alarms.{priority.name.lower()}", int, meaning, partial(_active, priority))


def _fact(row: Value[Any], status: SystemStatus) -> Any:
    return row.of(status.facts)


def _active(priority: Priority, status: SystemStatus) -> int:
    alarms = (alarm for alarm in status.alarms.alarms if alarm.active)
    return sum(ALARM_DEFINITIONS[alarm.kind].priority is priority for alarm in alarms)


class GatewayNodes:
    def __init__(self, server: Server, space: BayNodes, gateway: ua.NodeId) -> None:
        self._server, self._space, self._gateway = server, space, gateway
        self._rows = [(row, node_id("Gateway", row.name)) for row in _rows()]
        self._shown: tuple[int | None, bool] | None = None

    def make(self) -> None:
        for row, node in self._rows:
            self._space.add_value(self._gateway, node, row)

    async def show(self, client: GatewayClient, offset_ns: int) -> None:
        """`offset_ns`: Unix time minus the gateway's clock. Only what has been reported anew."""
        newest = client.links_ns, client.links_known
        if client.links_ns is None or newest == self._shown:
            return
        self._shown = newest
        unknown = ua.StatusCodes.BadNoDataAvailable if client.links_known else ua.StatusCodes.BadNoCommunication
        for row, node in self._rows:
            found = row.of(client.links) if client.links_known else None
            code = unknown if found is None else ua.StatusCodes.Good
            shown = data.dated(row, found, code, client.links_ns + offset_ns)
            await self._server.iserver.write_attribute_value(node, shown)
