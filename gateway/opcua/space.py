"""The nodes: an object for each bay, with a variable for each value of the table. docs/opcua.md describes them."""

from collections.abc import Iterable
from enum import Enum, IntEnum
from typing import Any

from asyncua import Server, ua

from gateway.config import BayConfig, GatewayConfig
from gateway.core.state import StateVector
from gateway.modbus.registers.bay_identity import identities
from gateway.opcua import data
from gateway.opcua.history import LastHour
from gateway.values.bay_values import ROWS
from gateway.values.value import Value

NAMESPACE = "urn:plc-loading-gateway:values"
INDEX = 2  # of the namespace, in every server
HISTORY = (
    "stop", "may_move", "in_place", "moved", "phase", "reason", "d", "radius_px", "distance_mm", "vision.quality",
    "range.quality", "ne107", "guidance",
)  # fmt: skip
READ = ua.AccessLevel.CurrentRead.mask
HISTORY_READ = ua.AccessLevel.HistoryRead.mask


def node_id(*names: str) -> ua.NodeId:
    return ua.NodeId(".".join(names), INDEX)


class BayNodes:
    """What has been made in a server. `show` is called with each new state of a bay."""

    def __init__(self, server: Server, config: GatewayConfig, history: LastHour) -> None:
        self._server, self._config, self._history = server, config, history
        self._rows = {bay.name: [(row, node_id(bay.name, row.name)) for row in ROWS] for bay in config.bays}

    async def make(self) -> None:
        bays = ua.NodeId("Bays", INDEX)
        self.add_object(ua.NodeId(ua.ObjectIds.ObjectsFolder), bays, "Bays", ua.ObjectIds.FolderType, organizes=True)
        for bay in self._config.bays:
            self._make_bay(bays, bay)

    def _make_bay(self, bays: ua.NodeId, bay: BayConfig) -> None:
        own = node_id(bay.name)
        self.add_object(bays, own, bay.name, ua.ObjectIds.BaseObjectType, text=bay.title or bay.name)
        identity = identities(self._config)[bay.name]
        facts = {
            "Site": self._config.site,
            "Instance": self._config.instance,
            "UnitId": identity.unit_id,
            "Number": identity.number,
        }
        for name, fact in facts.items():
            kind = ua.VariantType.String if isinstance(fact, str) else ua.VariantType.UInt32
            self._add_property(own, node_id(bay.name, name), name, ua.Variant(fact, kind))
        for row, node in self._rows[bay.name]:
            self.add_value(own, node, row)
            if row.name in HISTORY:
                self._history.keep(node)

    async def show(self, state: StateVector, offset_ns: int) -> None:
        """`offset_ns`: Unix time minus the clock of the state."""
        for row, node in self._rows[state.bay]:
            value = data.data_value(row, state, offset_ns)
            await self._server.iserver.write_attribute_value(node, value)
            self._history.note(node, value)

    def add_object(
        self, parent: ua.NodeId, node: ua.NodeId, name: str, kind: int, *, text: str = "", organizes: bool = False
    ) -> None:
        reference = ua.ObjectIds.Organizes if organizes else ua.ObjectIds.HasComponent
        attributes = ua.ObjectAttributes(DisplayName=ua.LocalizedText(text or name), EventNotifier=0)
        self._add(parent, node, name, ua.NodeClass.Object, attributes, reference, kind)

    def add_value(self, parent: ua.NodeId, node: ua.NodeId, row: Value[Any]) -> None:
        """Without a value yet."""
        kept = HISTORY_READ if row.name in HISTORY else 0
        attributes = _variable(
            row.name, data.variant_type(row), ua.Variant(None), rank=1 if row.kind is tuple else -1, more=kept
        )
        attributes.Description = ua.LocalizedText(row.words)
        kind = ua.ObjectIds.AnalogUnitType if row.unit else ua.ObjectIds.BaseDataVariableType
        choices = issubclass(row.kind, IntEnum)
        if choices:
            kind = ua.ObjectIds.MultiStateValueDiscreteType
        self._add(parent, node, row.name, ua.NodeClass.Variable, attributes, ua.ObjectIds.HasComponent, kind)
        waiting = ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadWaitingForInitialData))
        self._server.iserver.aspace[node].attributes[ua.AttributeIds.Value].value = waiting
        if row.unit:
            unit = ua.Variant(data.engineering_unit(row.unit), ua.VariantType.ExtensionObject)
            place = ua.NodeId(f"{node.Identifier}.EngineeringUnits", INDEX)
            self._add_property(node, place, "EngineeringUnits", unit, ua.ObjectIds.EUInformation, namespace=0)
        if choices:
            listed = ua.Variant(_choices(row.kind), ua.VariantType.ExtensionObject)
            place = ua.NodeId(f"{node.Identifier}.EnumValues", INDEX)
            self._add_property(node, place, "EnumValues", listed, ua.ObjectIds.EnumValueType, rank=1, namespace=0)

    def _add_property(
        self,
        parent: ua.NodeId,
        node: ua.NodeId,
        name: str,
        value: ua.Variant,
        kind: int | None = None,
        rank: int = -1,
        namespace: int = INDEX,
    ) -> None:
        attributes = _variable(name, kind or value.VariantType, value, rank)
        property_type = ua.ObjectIds.PropertyType
        self._add(
            parent, node, name, ua.NodeClass.Variable, attributes, ua.ObjectIds.HasProperty, property_type, namespace
        )

    def _add(
        self,
        parent: ua.NodeId,
        node: ua.NodeId,
        name: str,
        node_class: ua.NodeClass,
        attributes: Any,
        reference: int,
        kind: int,
        namespace: int = INDEX,
    ) -> None:
        item = ua.AddNodesItem(
            ParentNodeId=parent,
            ReferenceTypeId=ua.NodeId(reference),
            RequestedNewNodeId=node,
            BrowseName=ua.QualifiedName(name, namespace),
            NodeClass=node_class,
            NodeAttributes=attributes,
            TypeDefinition=ua.NodeId(kind),
        )
        (result,) = self._server.iserver.node_mgt_service.add_nodes([item])
        result.StatusCode.check()


def _variable(
    name: str, kind: int | ua.VariantType, value: ua.Variant, rank: int = -1, more: int = 0
) -> ua.VariableAttributes:
    number = kind.value if isinstance(kind, ua.VariantType) else kind
    return ua.VariableAttributes(
        DisplayName=ua.LocalizedText(name),
        Value=value,
        DataType=ua.NodeId(number),
        ValueRank=rank,
        ArrayDimensions=[ua.UInt32(0)] if rank > 0 else [],
        AccessLevel=READ | more,
        UserAccessLevel=READ | more,
        MinimumSamplingInterval=100.0,
        Historizing=bool(more),
    )


def _choices(kind: type[Enum]) -> list[ua.EnumValueType]:
    members: Iterable[Enum] = kind
    return [ua.EnumValueType(int(one.value), ua.LocalizedText(one.name)) for one in members]
