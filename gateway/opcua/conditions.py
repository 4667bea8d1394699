"""Alarms as conditions and visits as events, for whoever subscribes to the Server object's events."""

import secrets
from collections.abc import Mapping
from typing import Any

from asyncua import Server, ua
from asyncua.common import events
from asyncua.common.event_objects import AlarmCondition

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.gateway_alarms import GATEWAY_ALARMS
from gateway.alarms.records import MAX_NOTE, Alarm, OperatorAction
from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.alarms.table import ALARM_DEFINITIONS, alarm_id
from gateway.config import GatewayConfig
from gateway.core.plc import Writer
from gateway.core.visit_summary import VisitSummary
from gateway.errors import LinkError
from gateway.opcua.data import at
from gateway.opcua.hardened import CALLER
from gateway.opcua.history import LastHour
from gateway.opcua.sent_event import SentEvent
from gateway.opcua.space import INDEX, BayNodes, node_id
from gateway.values.value import plain
from gateway.values.visit_values import ROWS as VISIT_ROWS
from gateway.web.server.gateway_client import GatewayClient, RefusedError

SEVERITY = {"LOW": 200, "MEDIUM": 500, "HIGH": 800}  # of OPC UA's 1 to 1000
VISIT_SEVERITY = 100
ACKNOWLEDGED = frozenset({AlarmState.NORMAL, AlarmState.ACKNOWLEDGED, AlarmState.LATCHED_ACKNOWLEDGED})
_KINDS = {bool: ua.VariantType.Boolean, int: ua.VariantType.Int64, float: ua.VariantType.Double}
VISIT_FIELDS = {
    row.name: _KINDS.get(row.kind, ua.VariantType.String) for row in VISIT_ROWS if row.kind not in (dict, tuple)
}


class Conditions:
    """`gateway`: its object, the source of the gateway's own alarms."""

    def __init__(
        self, server: Server, space: BayNodes, client: GatewayClient, gateway: ua.NodeId, history: LastHour
    ) -> None:
        self._history = history
        self._server, self._space, self._client, self._gateway = server, space, client, gateway
        self._known: dict[str, tuple[Alarm, bool]] = {}  # by id, with whether it is of now
        self._newest: dict[ua.NodeId, tuple[bytes, Alarm]] = {}  # EventId of each condition
        self._visit: Any = None

    async def make(self, config: GatewayConfig) -> None:
        folder = ua.NodeId("Alarms", INDEX)
        self._space.add_object(self._gateway, folder, "Alarms", ua.ObjectIds.FolderType, organizes=True)
        ids = [alarm_id(kind.id, bay.name) for bay in config.bays for kind in BAY_ALARMS]
        for one in [*ids, *(kind.id for kind in GATEWAY_ALARMS)]:
            self._space.add_object(folder, node_id("Alarms", one), one, ua.ObjectIds.AlarmConditionType)
        self._server.iserver.isession.add_method_callback(
            ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge), self.acknowledge
        )
        kind = await self._server.create_custom_event_type(
            INDEX, "VisitEventType", ua.ObjectIds.BaseEventType, [("Bay", ua.VariantType.String), *VISIT_FIELDS.items()]
        )
        self._visit = kind
        server = self._server.get_node(ua.ObjectIds.Server)
        await server.set_event_notifier([ua.EventNotifier.SubscribeToEvents, ua.EventNotifier.HistoryRead])

    async def show(self, alarms: Mapping[str, Alarm], current: bool, now_ns: int, offset_ns: int) -> None:
        """Report what has changed. `alarms`: those that are not normal, by id. `current`: of now, else of before the
        gateway fell silent. `offset_ns`: Unix time minus the gateway's clock."""
        for one, (known, was_current) in list(self._known.items()):
            if one not in alarms:
                del self._known[one]
                await self._report(Alarm(known.id, known.kind, known.bay, since_ns=now_ns), current, offset_ns)
            elif (alarms[one], current) != (known, was_current):
                await self._report(alarms[one], current, offset_ns)
        for one, alarm in alarms.items():
            if one not in self._known:
                await self._report(alarm, current, offset_ns)
            self._known[one] = alarm, current

    async def _report(self, alarm: Alarm, current: bool, offset_ns: int) -> None:
        if (row := ALARM_DEFINITIONS.get(alarm.kind)) is None:
            return
        source = self._gateway if alarm.bay is None else node_id(alarm.bay)
        event = AlarmCondition(source, f"{row.title}: {alarm.detail}" if alarm.detail else row.title)
        event.Severity = SEVERITY[row.priority.name]
        condition = node_id("Alarms", alarm.id)
        event.add_property("NodeId", condition, ua.VariantType.NodeId)
        event.emitting_node = ua.NodeId(ua.ObjectIds.Server)
        event.SourceName = alarm.bay or "Gateway"
        event.ConditionClassId = ua.NodeId(ua.ObjectIds.ProcessConditionClassType)
        event.ConditionClassName = ua.LocalizedText("ProcessConditionClass")
        event.ConditionName = row.title
        event.BranchId = ua.NodeId()
        event.Retain = alarm.state is not AlarmState.NORMAL
        event.Quality = ua.StatusCode(ua.StatusCodes.Good if current else ua.StatusCodes.BadNoCommunication)
        event.Comment = ua.LocalizedText(alarm.note)
        event.ClientUserId = alarm.who
        hidden = alarm.state in (AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE)
        event.SuppressedOrShelved = hidden
        latched = alarm.state in (AlarmState.LATCHED_ACKNOWLEDGED, AlarmState.LATCHED_UNACKNOWLEDGED)
        _state(event, "EnabledState", True, "Enabled", "Disabled")
        _state(event, "ActiveState", alarm.active, "Active", "Inactive")
        _state(event, "AckedState", hidden or alarm.state in ACKNOWLEDGED, "Acknowledged", "Unacknowledged")
        _state(event, "SuppressedState", alarm.state is AlarmState.SUPPRESSED, "Suppressed", "Unsuppressed")
        _state(event, "OutOfServiceState", alarm.state is AlarmState.OUT_OF_SERVICE, "Out of service", "In service")
        _state(event, "LatchedState", latched, "Latched", "Unlatched")
        self._newest[condition] = await self._send(event, alarm.since_ns + offset_ns), alarm

    async def visit(self, bay: str, summary: VisitSummary, unix_ns: int) -> None:
        """A truck's visit is over."""
        event = await events.get_event_obj_from_type_node(self._visit)
        event.SourceNode, event.SourceName = node_id(bay), bay
        event.emitting_node = ua.NodeId(ua.ObjectIds.Server)
        event.Severity = VISIT_SEVERITY
        event.Message = ua.LocalizedText(summary.text)
        event.Bay = bay
        for row in VISIT_ROWS:
            if row.name in VISIT_FIELDS:
                setattr(event, row.name, plain(row, summary, 3))
        await self._send(event, unix_ns)

    async def _send(self, event: Any, unix_ns: int) -> bytes:
        event.EventId = secrets.token_bytes(16)
        event.Time = at(unix_ns)
        event.ReceiveTime = at(self._client.clock.wall_ns())
        sent = SentEvent(event)
        self._history.note_event(sent)
        await self._server.iserver.subscription_service.trigger_event(sent)
        return bytes(event.EventId)

    async def acknowledge(self, condition: ua.NodeId, event_id: ua.Variant, comment: ua.Variant) -> ua.StatusCode:
        """The method Acknowledge of a condition."""
        caller = CALLER.get()
        if not caller.writes:
            return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
        known, alarm = self._newest.get(condition, (b"", None))
        if alarm is None or event_id.Value != known:
            return ua.StatusCode(ua.StatusCodes.BadEventIdUnknown)
        if alarm.state in ACKNOWLEDGED:
            return ua.StatusCode(ua.StatusCodes.BadConditionBranchAlreadyAcked)
        text = getattr(comment.Value, "Text", None) or ""
        who = Writer(caller.address, caller.subject, caller.role)
        action = OperatorAction(
            alarm.id, AlarmEvent.ACKNOWLEDGE, caller.subject, text[:MAX_NOTE], occurrence=alarm.occurrences
        )
        return await done(self._client.command(action, who))


async def done(command: Any) -> ua.StatusCode:
    """What a command to the gateway ends with."""
    try:
        await command
    except RefusedError:
        return ua.StatusCode(ua.StatusCodes.BadInvalidState)
    except LinkError:
        return ua.StatusCode(ua.StatusCodes.BadNoCommunication)
    return ua.StatusCode()


def _state(event: Any, name: str, on: bool, yes: str, no: str) -> None:
    setattr(event, name, ua.LocalizedText(yes if on else no, "en"))
    setattr(event, f"{name}/Id", on)
