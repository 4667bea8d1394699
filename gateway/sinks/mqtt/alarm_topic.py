"""`<bay>/alarms`, retained: the alarms of a bay and of its gateway that are not normal, as ISA-18.2 has them. Pure."""

from typing import Literal

from pydantic import Field

from gateway.sinks.contract import ALARM_PRIORITIES, BayAlarms, ShownAlarm
from gateway.sinks.mqtt import payloads
from gateway.sinks.mqtt.messages import SCHEMA_VERSION
from gateway.sinks.mqtt.topics import Gateway
from gateway.sinks.mqtt.values import Count, Payload, iso


class AlarmPayload(Payload):
    """One alarm that is not normal. Times are Unix time, ms."""

    id: str = Field(description="`<bay>.<kind>`, or `<kind>` of the gateway itself")
    kind: str = Field(description="a row of docs/alarms.md")
    title: str = Field(description="in words, for people; never to be parsed")
    priority: str = Field(json_schema_extra={"enum": list(ALARM_PRIORITIES)})
    state: str = Field(description="of ISA-18.2, by its name in docs/alarms.md")
    active: bool = Field(description="its cause holds, delays counted; false while suppressed")
    unacknowledged: bool = Field(description="it waits for an operator")
    since_ms: Count = Field(description="in this state")
    raised_ms: Count | None = Field(description="last announced; null: never")
    occurrences: Count = Field(description="times announced since the start of the gateway")
    detail: str = Field(description="in words, when it was last announced; never to be parsed")
    who: str = Field(description="who acted on it last since it was announced; empty: nobody")
    note: str = Field(description="and why")
    shelved_until_ms: Count | None = Field(description="null unless shelved")


class AlarmsPayload(Payload):
    """Valid only while the status topic is online and it keeps arriving."""

    schema_version: Literal[1] = Field(description="raised when a field is removed or changes its meaning")
    site: str
    bay: str
    instance: str = Field(description="the gateway that reports for this bay")
    timestamp_ms: Count = Field(description="when this was made, Unix time, ms")
    timestamp: str = Field(description="the same, ISO 8601, UTC", json_schema_extra={"format": "date-time"})
    status_topic: str = Field(description="topic with the status of this bay's gateway")
    stale_after_ms: Count = Field(description="no newer message for this time: the alarms are not known")
    evaluated: bool = Field(description="false: nothing evaluates the alarms now; all that follows is null")
    active: Count | None = Field(description="alarms of bay and gateway whose cause holds")
    unacknowledged: Count | None = Field(description="alarms of bay and gateway that wait for an operator")
    highest_priority: str | None = Field(
        description="of the active ones; null: none is", json_schema_extra={"enum": [*ALARM_PRIORITIES, None]}
    )
    alarms: tuple[AlarmPayload, ...] | None = Field(description="of the bay, the most important first")
    gateway_alarms: tuple[AlarmPayload, ...] | None = Field(description="of the gateway itself, likewise")


def alarms_payload(
    known: BayAlarms, bay: str, gateway: Gateway, now_ns: int, offset_ns: int, stale_after_ms: int
) -> AlarmsPayload:
    """`known`: as they may be shown at `now_ns` (monotonic); `offset_ns`: Unix time minus monotonic time."""
    timestamp_ms = payloads.unix_ms(now_ns + offset_ns)
    on = known.evaluated
    return AlarmsPayload(
        schema_version=SCHEMA_VERSION,
        site=gateway.topics.site,
        bay=bay,
        instance=gateway.topics.instance,
        timestamp_ms=timestamp_ms,
        timestamp=iso(timestamp_ms),
        status_topic=gateway.topics.status,
        stale_after_ms=stale_after_ms,
        evaluated=on,
        active=known.active if on else None,
        unacknowledged=known.unacknowledged if on else None,
        highest_priority=known.highest_priority if on else None,
        alarms=_listed(known.bay, offset_ns) if on else None,
        gateway_alarms=_listed(known.gateway, offset_ns) if on else None,
    )


def _listed(alarms: tuple[ShownAlarm, ...], offset_ns: int) -> tuple[AlarmPayload, ...]:
    return tuple(_alarm(alarm, offset_ns) for alarm in alarms if not alarm.normal)


def _alarm(alarm: ShownAlarm, offset_ns: int) -> AlarmPayload:
    def unix_ms(t_ns: int | None) -> int | None:
        return None if t_ns is None else payloads.unix_ms(t_ns + offset_ns)

    return AlarmPayload(
        id=alarm.id,
        kind=alarm.kind,
        title=alarm.title,
        priority=alarm.priority,
        state=alarm.state,
        active=alarm.active,
        unacknowledged=alarm.unacknowledged,
        since_ms=payloads.unix_ms(alarm.since_ns + offset_ns),
        raised_ms=unix_ms(alarm.raised_ns),
        occurrences=alarm.occurrences,
        detail=payloads.text(alarm.detail),
        who=payloads.text(alarm.who),
        note=payloads.text(alarm.note),
        shelved_until_ms=unix_ms(alarm.shelved_until_ns),
    )
