"""Alarms, links, events and registers, made from the gateway client's data. Pure."""

from collections import Counter
from collections.abc import Iterable

from gateway.alarms.records import Alarm, AlarmChange
from gateway.alarms.states import AlarmState
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.clock import NS_PER_MS
from gateway.config import BayConfig
from gateway.errors import ProtocolError
from gateway.modbus.registers.register import Register
from gateway.modbus.registers.register_map import REGISTERS, decode
from gateway.modbus.server.traffic import ServerNow
from gateway.sinks.contract import LinkStatus
from gateway.sinks.mqtt import payloads
from gateway.sinks.mqtt.topics import Gateway
from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.models import (
    PRIORITY_NAME,
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
    PeerView,
    RegistersView,
    RegisterView,
    SinkView,
    SparkplugView,
    TaskView,
)

HIDDEN = frozenset({AlarmState.NORMAL, AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE})
MS_PER_S = 1000


def unix_ms(client: GatewayClient, t_ns: int) -> int:
    """Unix time of a time of the gateway's clock."""
    return max(0, t_ns + client.clock.wall_ns() - client.clock.now_ns()) // NS_PER_MS


# Alarms.


def alarm_view(client: GatewayClient, alarm: Alarm) -> AlarmView:
    kind = ALARM_DEFINITIONS[alarm.kind]
    until_ns, raised_ns = alarm.shelved_until_ns, alarm.raised_ns
    return AlarmView(
        id=alarm.id,
        kind=alarm.kind,
        bay=alarm.bay,
        title=kind.title,
        priority=PRIORITY_NAME[kind.priority],
        state=alarm.state,
        active=alarm.active,
        since_ms=unix_ms(client, alarm.since_ns),
        raised_ms=None if raised_ns is None else unix_ms(client, raised_ns),
        occurrences=alarm.occurrences,
        detail=alarm.detail,
        who=alarm.who,
        note=alarm.note,
        shelved_until_ms=None if until_ns is None else unix_ms(client, until_ns),
        meaning=kind.meaning,
        consequence=kind.consequence,
        causes=kind.causes,
        action=kind.action,
        respond_min=kind.respond_min,
    )


def alarm_summary(client: GatewayClient) -> AlarmSummary:
    standing = client.links.alarms
    count = Counter(dict(standing.counts))
    shown = [alarm for alarm in standing.alarms if alarm.state not in HIDDEN]
    return AlarmSummary(
        unacknowledged=count[AlarmState.UNACKNOWLEDGED]
        + count[AlarmState.RETURNED]
        + count[AlarmState.LATCHED_UNACKNOWLEDGED],
        active=count[AlarmState.UNACKNOWLEDGED] + count[AlarmState.ACKNOWLEDGED],
        latched=count[AlarmState.LATCHED_UNACKNOWLEDGED] + count[AlarmState.LATCHED_ACKNOWLEDGED],
        shelved=count[AlarmState.SHELVED],
        suppressed=count[AlarmState.SUPPRESSED],
        out_of_service=count[AlarmState.OUT_OF_SERVICE],
        by_bay=dict(Counter(alarm.bay for alarm in shown if alarm.bay is not None)),
        first=alarm_view(client, shown[0]) if shown else None,
        newest_change=standing.newest_change,
    )


def alarms_view(client: GatewayClient) -> AlarmsView:
    standing = client.links.alarms
    return AlarmsView(
        server_time_ms=max(0, client.clock.wall_ns()) // NS_PER_MS,
        summary=alarm_summary(client),
        alarms=tuple(alarm_view(client, alarm) for alarm in standing.alarms),
        omitted=standing.omitted,
        changes=tuple(_change_view(client, change) for change in client.links.changes),
    )


def _change_view(client: GatewayClient, change: AlarmChange) -> AlarmChangeView:
    return AlarmChangeView(
        number=change.number,
        time_ms=unix_ms(client, change.t_ns),
        id=change.id,
        title=ALARM_DEFINITIONS[change.kind].title,
        bay=change.bay,
        cue=change.event,
        before=change.before,
        after=change.after,
        detail=change.detail,
        who=change.who,
        note=change.note,
    )


# Links.


def links_view(client: GatewayClient) -> LinksView:
    links = client.links
    mqtt, sparkplug = links.sink("mqtt"), links.sink("sparkplug")
    known_ns = client.links_ns
    return LinksView(
        age_ms=None if known_ns is None else round(max(0, client.clock.now_ns() - known_ns) / NS_PER_MS, 1),
        modbus=tuple(_modbus_view(server) for server in links.modbus),
        mqtt=None if mqtt is None else _mqtt_view(mqtt),
        sparkplug=None if sparkplug is None else _sparkplug_view(sparkplug),
        sinks=tuple(
            SinkView(name=link.sink, connected=link.connected, detail=link.detail, peer=link.peer)
            for link in links.sinks
        ),
        tasks=tuple(
            TaskView.model_validate(task, from_attributes=True)
            for task in links.tasks
            if not task.running or task.starts > 1
        ),
        events_dropped=links.events_dropped,
    )


def _modbus_view(server: ServerNow) -> ModbusView:
    return ModbusView(
        transport="tls" if server.tls else "tcp",
        port=server.port,
        open=server.open,
        connections=server.connections,
        requests=server.requests,
        exceptions=server.exceptions,
        image_faults=server.image_faults,
        refused={why.name.lower(): count for why, count in server.refused if count},
        plc_quiet_ms=None if server.plc_quiet_s is None else round(MS_PER_S * server.plc_quiet_s),
        peers=tuple(
            PeerView(
                address=peer.address,
                plc=peer.is_plc,
                connections=peer.connections,
                requests=peer.requests,
                quiet_ms=round(MS_PER_S * peer.quiet_s),
            )
            for peer in server.peers
        ),
    )


def _mqtt_view(link: LinkStatus) -> MqttView:
    return MqttView(
        broker=link.peer,
        connected=link.connected,
        published=link.figures["published"],
        failed=link.figures["failed"],
        reconnects=link.figures["reconnects"],
        dropped=link.figures["events_dropped"],
        queued=link.figures["outbox_events"],
        store=payloads.store_payload(link.store),
    )


def _sparkplug_view(link: LinkStatus) -> SparkplugView:
    return SparkplugView(
        connected=bool(link.figures["connected"]),
        born=bool(link.figures["born"]),
        births=link.figures["births"],
        rebirths=link.figures["rebirths"],
        data=link.figures["data_messages"],
        refused=link.figures["commands_refused"],
        history_dropped=link.figures["history_dropped"],
        history_waiting=link.figures["history_waiting"],
    )


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
        age_ms=round(max(0, client.clock.now_ns() - report.now.state.t_ns) / NS_PER_MS, 1),
        registers=tuple(_register_view(register, values[register.name], image) for register in REGISTERS),
    )


def _register_view(register: Register, value: float | None, image: Iterable[int]) -> RegisterView:
    words = tuple(image)[register.address : register.address + register.words]
    named = register.codes.get(int(value)) if register.codes is not None and value is not None else None
    bits = register.bits or {}
    return RegisterView(
        address=register.address,
        words=words,
        name=register.name,
        type=register.kind.name,
        unit=register.unit,
        scale=register.scale,
        value=value,
        text=None if named is None else named[0],
        bits=tuple(
            BitView(bit=bit, name=name, on=value is not None and bool(int(value) >> bit & 1))
            for bit, (name, _) in bits.items()
        ),
        meaning=register.meaning,
        writable=register.writable,
    )
