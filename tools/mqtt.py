"""The written contract, made from the code: JSON Schemas, tables and examples for docs/mqtt.md. Pure.

`docs/generate.py` puts them into place.
"""

import json
from collections.abc import Callable
from functools import partial

from pydantic import BaseModel

from gateway.core.detection import Circle
from gateway.core.events import Event, EventKind
from gateway.core.readings import Quality, RangeReading, RangeStats, VisionReading, VisionStats
from gateway.core.scale import MarkerScale, ScaleSample
from gateway.core.state import FusionMemory, Reason, StateVector
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.modbus.exports.tables import markdown_table
from gateway.sinks.contract import BayAlarms, ShownAlarm
from gateway.sinks.mqtt import home_assistant, messages, payloads, topic_plan
from gateway.sinks.mqtt.alarm_topic import alarms_payload
from gateway.sinks.mqtt.topics import Gateway, Topics
from gateway.values.gateway_values import GatewayFacts

DIALECT = "https://json-schema.org/draft/2020-12/schema"
MS = 1_000_000
ALARM = ShownAlarm("bay1.camera_down", "camera_down", "Camera down", "high", "acknowledged", False, True,
                   580_000 * MS, 570_000 * MS, 1, "cannot be opened", "ann", "the cable is being replaced")  # fmt: skip
WALL_NS = 1_795_000_000_000 * MS  # 2026-11-18T09:46:40Z

EVENT_MEANING: dict[EventKind, str] = {
    EventKind.START: "the gateway has begun to serve this bay; `stop` is on",
    EventKind.SHUTDOWN: "the gateway ends as requested; `stop` stays on",
    EventKind.OUTPUTS_WITHDRAWN: "the control task did not run: since then every output has shown `stop`, no values",
    EventKind.OUTPUTS_RETURNED: "the control task runs again; `detail` has for how long it did not",
    EventKind.STOP_RAISED: "`stop` changed from off to on; `reason` has the reason",
    EventKind.STOP_CLEARED: "`stop` went from on to off",
    EventKind.TARGET_FOUND: "the marker came into sight",
    EventKind.TARGET_LOST: "the marker went out of sight",
    EventKind.IN_PLACE: "the truck is now in place; `detail` has the position",
    EventKind.IN_PLACE_ENDED: "the truck is not in place any more, or it can't be confirmed; `detail` has the reason",
    EventKind.MOVED: "a truck that was in place has moved without release; `detail` has the values before and after",
    EventKind.ROLLING: "a truck that is in place begins to move without release; `detail`: sensor, before, now",
    EventKind.RELEASED: "the PLC has released the truck: loading is over",
    EventKind.VISIT_ENDED: "the truck that was in place has left the bay",
    EventKind.VISIT: "the visit of a truck is over; `visit` has its times, position and faults",
    EventKind.SENSOR_FAULT: "`sensor` became unusable, or its fault changed; `quality` and `detail` describe it",
    EventKind.SENSOR_RECOVERED: "`sensor` can be used again",
    EventKind.PLC_LOST: "the PLC's heartbeat has not changed for longer than its deadline",
    EventKind.PLC_RETURNED: "the PLC's heartbeat arrived for the first time, or again",
    EventKind.PLC_WRITE: "the PLC changed a register of the handshake block; `write` has the writer and both values",
    EventKind.WRITE_REFUSED: "a write had no effect; `detail` has the reason",
    EventKind.OWNER_CHANGED: "another PLC writes the handshake block from now on; `detail` names it",
    EventKind.LATCH_RELEASED: "the latched stop was ended; `detail` has the cause",
    EventKind.RECIPE_CHANGED: "another recipe is in force",
    EventKind.FUNCTION_CHECK_BEGUN: "a technician works on the bay",
    EventKind.FUNCTION_CHECK_ENDED: "the technician has finished",
    EventKind.SETTINGS_CHANGED: "other settings are in force; `detail` has the user and the changes",
    EventKind.OPERATOR_MARK: "a person wants this moment to be looked at later; `detail` has who, and the note",
    EventKind.OPERATION_RELEASED: "a technician has signed the checklist of the bay; `detail` has who",
    EventKind.OPERATION_RELEASE_VOID: "the bay is not released for operation any more; `detail` has the changed keys",
}


def schemas() -> dict[str, str]:
    """File name under docs/schemas -> text. Open on purpose: a reader must accept unknown fields."""
    return {kind.schema: _schema(kind.schema, kind.model) for kind in topic_plan.PLAN}


def _schema(name: str, model: type[BaseModel]) -> str:
    schema = {"$schema": DIALECT, "$id": name} | model.model_json_schema(mode="serialization")
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def events_markdown() -> str:
    return markdown_table(("kind", "meaning"), ((f"`{kind.value}`", EVENT_MEANING[kind]) for kind in EventKind))


def topics_markdown() -> str:
    return markdown_table(
        ("topic", "QoS", "retained", "payload", "meaning"),
        (
            (
                f"`{kind.pattern.replace('{', '<').replace('}', '>')}`",
                str(kind.qos),
                "yes" if kind.retained else "no",
                f"[{kind.schema}](schemas/{kind.schema})",
                kind.meaning,
            )
            for kind in topic_plan.PLAN
        ),
    )


def home_assistant_markdown() -> str:
    return ", ".join(f"{one.name} (`{one.shows}`)" for one in home_assistant.ENTITIES) + "."


VISIT = VisitSummary(
    WALL_NS // MS - 900_000,
    612.4,
    VisitEnd.CLEAR,
    in_place_s=480.0,
    times_in_place=1,
    faults=((Reason.RANGE_STALE, 1, 2.5),),
)
FACTS = GatewayFacts("3f5a" * 16, "3f5a" * 16, "ended", "updated", {"hmi": 83}, "https://bay-1.plant.example:8080/")


def examples() -> dict[str, BaseModel]:
    """One message of each kind, of a truck that has just reached its place."""
    gateway = Gateway(Topics("loading", "site1", "gateway"), ("bay1",), "0.1.0", "9f86d081884c7d65")
    state = StateVector(
        bay="bay1",
        t_ns=600_000 * MS,
        seq=41_873,
        heartbeat=29_990,
        vision=VisionReading(
            t_ns=600_000 * MS - 21 * MS,
            quality=Quality.GOOD,
            circle=Circle(643.21, 358.875, 180.4),
            frame_id=17_941,
            stats=VisionStats(frames=17_940, skipped=1, rate_hz=30.0, latency_ms=11.42),
        ),
        range=RangeReading(
            t_ns=600_000 * MS - 44 * MS,
            quality=Quality.GOOD,
            distance_mm=296.5,
            seq=11_907,
            stats=RangeStats(lines=11_905, damaged=2, gaps=2, rate_hz=20.0),
        ),
        memory=FusionMemory(
            scale=MarkerScale(
                px_mm=53_520.0,
                distance_mm=292.0,
                spread=0.011,
                visits=17,
                newest=ScaleSample(0, 181.9, 294.5, unix_s=1_794_996_413),
            )
        ),
        d=True,
        stop=True,
        reason=Reason.TARGET_REACHED,
    )
    offset_ns = WALL_NS - state.t_ns
    delivery = messages.DeliveryPayload(
        published=1342,
        failed=1,
        reconnects=1,
        dropped=0,
        queued=0,
        store=messages.StorePayload(ok=True, detail="", faults=0, recovered=0, unwritten=0),
    )
    return {
        "status": payloads.status_payload(
            gateway,
            "running",
            WALL_NS,
            delivery,
            payloads.gateway_payload(FACTS, 61),
            [payloads.bay_health(state, "Loading bay 3", BayAlarms((ALARM,), (), True), VISIT, offset_ns)],
        ),
        "will": payloads.status_payload(gateway, "connection lost"),
        "state": payloads.state_payload(state, gateway, offset_ns, stale_after_ms=2500),
        "event": payloads.event_payload(
            Event(EventKind.STOP_RAISED, "bay1", state.t_ns, state), 17, gateway, offset_ns
        ),
        "alarms": alarms_payload(BayAlarms((ALARM,), (), True), "bay1", gateway, state.t_ns, offset_ns, 31_000),
    }


def _example(name: str) -> str:
    shown = examples()[name].model_dump(mode="json")
    if name == "event":  # what it has of the state is in the state's example
        shown = {key: value for key, value in shown.items() if key not in messages.StatePayload.model_fields}
    return f"```json\n{json.dumps(shown, indent=2, ensure_ascii=False)}\n```\n"


BLOCKS: dict[str, Callable[[], str]] = {
    "topics": topics_markdown,
    "events": events_markdown,
    "home assistant": home_assistant_markdown,
    **{f"example {name}": partial(_example, name) for name in ("status", "state", "event", "alarms")},
}
