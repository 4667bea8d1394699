"""Converts states and events to the messages of gateway.sinks.mqtt.messages. Pure.

Times are Unix time; `offset_ns` is what turns the monotonic clock into it (wall minus monotonic, ns).
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from pydantic import BaseModel

from gateway.core import fusion
from gateway.core.events import Event, EventKind
from gateway.core.state import Reason, StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_MS
from gateway.sinks.contract import BayAlarms, StoreStatus
from gateway.sinks.mqtt.messages import (
    SCHEMA_VERSION,
    SENSORS,
    ActiveAlarmsPayload,
    BayHealthPayload,
    Cause,
    DeliveryPayload,
    EventPayload,
    GatewayPayload,
    LastVisitPayload,
    Life,
    QualityPayload,
    StatePayload,
    StatusPayload,
    StorePayload,
    WritePayload,
)
from gateway.sinks.mqtt.topics import Gateway
from gateway.sinks.mqtt.values import LAST_MS, iso
from gateway.sinks.mqtt.visit_payload import VISIT, visit_payload
from gateway.sinks.outbox.outbox import OutboxEntry
from gateway.values.bay_values import BAY_VALUES
from gateway.values.gateway_values import GATEWAY_VALUES, GatewayFacts
from gateway.values.models import Filler

MAX_TEXT_CHARS = 500
# A change of stop is what the plant's records are kept for: dropped last.
DROPPED_LAST = frozenset({EventKind.STOP_RAISED, EventKind.STOP_CLEARED})


def final(state: StateVector, now_ns: int) -> StateVector:
    """The state that stays behind when the gateway ends: stop on, no value."""
    return state if state.reason is Reason.SHUTDOWN else fusion.forced_stop(state, Reason.SHUTDOWN, now_ns)


def state_payload(state: StateVector, gateway: Gateway, offset_ns: int, stale_after_ms: int) -> StatePayload:
    return BAY.fill(
        StatePayload,
        state,
        offset_ns,
        **_head(state, gateway, offset_ns),
        status_topic=gateway.topics.status,
        stale_after_ms=stale_after_ms,
    )


def event_payload(event: Event, number: int, gateway: Gateway, offset_ns: int) -> EventPayload:
    """`number` counts the events of this start from 1."""
    sensor = event.sensor if event.sensor in SENSORS else None
    state = replace(event.state, t_ns=event.t_ns)  # ages are those at the event
    return BAY.fill(
        EventPayload,
        state,
        offset_ns,
        **_head(state, gateway, offset_ns),
        id=f"{gateway.boot}-{number}",
        kind=event.kind,
        sensor=sensor,
        quality=QualityPayload(name=event.quality.name, code=event.quality) if sensor in ("vision", "range") else None,
        write=_write(event),
        visit=None if event.summary is None else visit_payload(event.summary),
        detail=text(event.detail),
    )


def outbox_entry(event: Event, number: int, gateway: Gateway, offset_ns: int) -> OutboxEntry:
    """The event as it waits for its acknowledgement; see `event_payload`."""
    payload = event_payload(event, number, gateway, offset_ns)
    drop_last = event.kind in DROPPED_LAST
    return OutboxEntry(payload.id, gateway.topics.event(event.bay), encode(payload), drop_last, payload.timestamp_ms)


def status_payload(
    gateway: Gateway,
    cause: Cause,
    wall_ns: int | None = None,
    delivery: DeliveryPayload | None = None,
    own: GatewayPayload | None = None,
    health: Iterable[BayHealthPayload] = (),
) -> StatusPayload:
    return StatusPayload(
        schema_version=SCHEMA_VERSION,
        site=gateway.topics.site,
        instance=gateway.topics.instance,
        status=Life.ONLINE if cause == "running" else Life.OFFLINE,
        cause=cause,
        version=gateway.version,
        boot=gateway.boot,
        bays=gateway.bays,
        timestamp_ms=None if wall_ns is None else unix_ms(wall_ns),
        timestamp=None if wall_ns is None else iso(unix_ms(wall_ns)),
        delivery=delivery,
        gateway=own,
        health=tuple(health),
    )


def gateway_payload(facts: GatewayFacts, mqtt_days: int | None) -> GatewayPayload:
    """`mqtt_days`: until the first certificate of the broker's link ends; None: without TLS."""
    days = dict(facts.certificate_days) | ({} if mqtt_days is None else {"mqtt": mqtt_days})
    return Filler(GATEWAY_VALUES, {}, {}).fill(GatewayPayload, facts, 0, certificate_days=days)


def bay_health(
    state: StateVector, title: str, alarms: BayAlarms, last_visit: VisitSummary | None, offset_ns: int
) -> BayHealthPayload:
    active = ActiveAlarmsPayload(**alarms.by_priority) if alarms.evaluated else None
    return BAY.fill(
        BayHealthPayload,
        state,
        offset_ns,
        bay=state.bay,
        title=title,
        veil=None if (veil := BAY_VALUES["picture.veil"].of(state)) is None else round(veil, 2),
        alarms=active,
        last_visit=None if last_visit is None else VISIT.fill(LastVisitPayload, last_visit, 0),
    )


def store_payload(store: StoreStatus | None) -> StorePayload | None:
    if store is None:
        return None
    return StorePayload(
        ok=not store.fault,
        detail=text(store.fault),
        faults=store.faults,
        recovered=store.recovered,
        unwritten=store.unwritten,
    )


def encode(payload: BaseModel) -> bytes:
    """The bytes on the wire: compact JSON, UTF-8."""
    return payload.model_dump_json().encode()


def _head(state: StateVector, gateway: Gateway, offset_ns: int) -> dict[str, Any]:
    timestamp_ms = unix_ms(state.t_ns + offset_ns)
    return {
        "schema_version": SCHEMA_VERSION,
        "site": gateway.topics.site,
        "bay": state.bay,
        "instance": gateway.topics.instance,
        "timestamp_ms": timestamp_ms,
        "timestamp": iso(timestamp_ms),
    }


def _newest_ms(state: StateVector, offset_ns: int) -> int | None:
    scale = state.memory.scale
    return None if scale is None else min(max(0, scale.newest.date_s(offset_ns) * 1000), LAST_MS)


BAY = Filler(
    BAY_VALUES,
    {
        **{"px": 3, "mm": 2, "mm/s": 1, "Hz": 2, "ms": 1, "deg": 2, "dB": 2, "px mm": 1, "": 4},
        **{"x_n": 6, "y_n": 6, "picture.shift_px": 2, "exposure.time_ms": 3, "rates.vision_latency_ms": 2},
        **{f"guidance.{name}": 1 for name in ("amount_mm", "offset_mm", "to_go_mm")},
        **{f"guidance.{name}": 2 for name in ("offset_u_px", "offset_v_px")},
    },
    {
        "vision.detail": lambda state, _: text(state.vision.detail),
        "range.detail": lambda state, _: text(state.range.detail),
        "scale.newest_ms": _newest_ms,
    },
)


def _write(event: Event) -> WritePayload | None:
    if event.writer is None:
        return None
    change = event.change
    return WritePayload(
        address=text(event.writer.address),
        subject=text(event.writer.subject),
        role=text(event.writer.role),
        name=change.register if change else None,
        old=change.old if change else None,
        new=change.new if change else None,
    )


def text(text: str) -> str:
    """At most MAX_TEXT_CHARS characters, all of which UTF-8 can carry (a file name from the system may hold others)."""
    return text[:MAX_TEXT_CHARS].encode("utf-8", "replace").decode()


def unix_ms(unix_ns: int) -> int:
    return min(max(0, unix_ns // NS_PER_MS), LAST_MS)
