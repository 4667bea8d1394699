"""Alarms, links, events and registers, made from the gateway client's data. Pure."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from gateway.alarms.definition import AlarmDefinition
from gateway.alarms.records import Alarm, AlarmChange
from gateway.alarms.states import AlarmState
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.config import BayConfig
from gateway.core.readings import DEAD
from gateway.core.state import FunctionCheck
from gateway.errors import ProtocolError
from gateway.modbus.registers.register import Register
from gateway.modbus.registers.register_map import REGISTERS, decode
from gateway.sinks.contract import LinkStatus
from gateway.sinks.mqtt import payloads
from gateway.sinks.mqtt.topics import Gateway
from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.models import (
    AlarmChangeView,
    AlarmSummary,
    AlarmsView,
    AlarmView,
    BitView,
    EventsView,
    EventView,
    LinksView,
    ModbusView,
    MqttView,
    RegistersView,
    RegisterView,
    SinkView,
    SparkplugView,
    TaskView,
    view_of,
)

HIDDEN = frozenset({AlarmState.NORMAL, AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE})


# Alarms.


def alarm_view(client: GatewayClient, alarm: Alarm) -> AlarmView:
    times = {
        "since_ms": client.unix_ms(alarm.since_ns),
        "raised_ms": client.unix_ms(alarm.raised_ns),
        "shelved_until_ms": client.unix_ms(alarm.shelved_until_ns),
    }
    return AlarmView.model_validate(_fields(ALARM_DEFINITIONS[alarm.kind]) | _fields(alarm) | times)


def alarm_summary(client: GatewayClient) -> AlarmSummary:
    reported = client.links.alarms
    count = Counter(dict(reported.counts))
    shown = [alarm for alarm in reported.alarms if alarm.state not in HIDDEN]
    states = [report.now.state for bay in client.bays if (report := client.report(bay)) is not None]
    return AlarmSummary(
        age_ms=client.age_ms(client.answered_ns if client.answers else None),
        unacknowledged=count[AlarmState.UNACKNOWLEDGED]
        + count[AlarmState.RETURNED]
        + count[AlarmState.LATCHED_UNACKNOWLEDGED],
        shown=sum(number for state, number in count.items() if state not in HIDDEN),
        active=count[AlarmState.UNACKNOWLEDGED] + count[AlarmState.ACKNOWLEDGED],
        latched=count[AlarmState.LATCHED_UNACKNOWLEDGED] + count[AlarmState.LATCHED_ACKNOWLEDGED],
        shelved=count[AlarmState.SHELVED],
        suppressed=count[AlarmState.SUPPRESSED],
        out_of_service=count[AlarmState.OUT_OF_SERVICE],
        silent_sensors=sum(at.quality in DEAD for state in states for at in (state.vision, state.range)),
        function_checks=sum(state.function_check is not FunctionCheck.OFF for state in states),
        by_bay=dict(Counter(alarm.bay for alarm in shown if alarm.bay is not None)),
        highest_by_bay={
            alarm.bay: ALARM_DEFINITIONS[alarm.kind].priority.name.lower()
            for alarm in reversed(shown)
            if alarm.bay is not None
        },
        first=alarm_view(client, shown[0]) if shown else None,
        newest_change=reported.newest_change,
    )


def alarms_view(client: GatewayClient) -> AlarmsView:
    reported = client.links.alarms
    return AlarmsView(
        server_time_ms=client.server_time_ms,
        summary=alarm_summary(client),
        alarms=tuple(alarm_view(client, alarm) for alarm in reported.alarms),
        omitted=reported.omitted,
        changes=tuple(_change_view(client, change) for change in client.links.changes),
    )


def _change_view(client: GatewayClient, change: AlarmChange) -> AlarmChangeView:
    more = {"time_ms": client.unix_ms(change.t_ns), "title": ALARM_DEFINITIONS[change.kind].title}
    return AlarmChangeView.model_validate(_fields(change) | more)


def _fields(record: Alarm | AlarmChange | AlarmDefinition[Any]) -> dict[str, Any]:
    return {field.name: getattr(record, field.name) for field in fields(record)}


# Links.


def links_view(client: GatewayClient) -> LinksView:
    links = client.links
    mqtt, sparkplug = links.sink("mqtt"), links.sink("sparkplug")
    return LinksView(
        age_ms=client.age_ms(client.links_ns),
        modbus=tuple(map(ModbusView.model_validate, links.modbus)),
        mqtt=None if mqtt is None else _mqtt_view(mqtt),
        sparkplug=None if sparkplug is None else SparkplugView.model_validate(sparkplug.figures),
        sinks=tuple(map(SinkView.model_validate, links.sinks)),
        tasks=tuple(TaskView.model_validate(task) for task in links.tasks if not task.running or task.starts > 1),
        events_dropped=links.events_dropped,
    )


def _mqtt_view(link: LinkStatus) -> MqttView:
    store = payloads.store_payload(link.store)
    return MqttView.model_validate({**link.figures, "broker": link.peer, "connected": link.connected, "store": store})


# Events.


def events_view(client: GatewayClient, gateway: Gateway, bay: str | None, after: int, most: int) -> EventsView:
    """The oldest `most` of those after number `after`. `bay` None: of all."""
    offset_ns = client.clock.wall_ns() - client.clock.now_ns()
    rows = [row for row in client.events if row.number > after and bay in (None, row.event.bay)][:most]
    return EventsView(
        newest=client.newest_event,
        events=tuple(
            EventView(number=row.number, event=payloads.event_payload(row.event, row.number, gateway, offset_ns))
            for row in rows
        ),
    )


# Registers.


def registers_view(client: GatewayClient, config: BayConfig) -> RegistersView | None:
    """None: nothing known yet, or only an invalid image. Words and values are of one image."""
    report = client.report(config.name)
    if report is None:
        return None
    image = report.now.image
    try:
        values = decode(image)
    except ProtocolError:
        return None
    return RegistersView(
        bay=config.name,
        unit_id=config.unit_id,
        word_order=client.about.config.modbus.word_order,
        age_ms=client.age_ms(report.now.state.t_ns),
        registers=tuple(_register_view(register, values[register.name], image) for register in REGISTERS),
    )


def _register_view(register: Register, value: float | None, image: Sequence[int]) -> RegisterView:
    named = register.codes.get(int(value)) if register.codes is not None and value is not None else None
    bits = (
        BitView(bit=bit, name=name, on=value is not None and bool(int(value) >> bit & 1))
        for bit, (name, _) in (register.bits or {}).items()
    )
    return view_of(
        RegisterView,
        register,
        words=tuple(image[register.address : register.address + register.words]),
        type=register.kind.name,
        value=value,
        text=None if named is None else named[0],
        bits=tuple(bits),
    )
