"""Home Assistant's MQTT discovery: each bay appears as one device, without any YAML. Pure.

One retained message a bay states which entities there are and how they are read from the state topic (device discovery,
Home Assistant 2024.12 and later). A dead bay never looks alive: every entity is unavailable while the gateway's status
is not online, and expires when no state has arrived for `stale_after_ms`.
"""

import json
import math
from dataclasses import dataclass, field
from typing import Any

from gateway.core.detection import Tracking
from gateway.core.readings import Quality
from gateway.core.state import Moved, Reason, VisitPhase
from gateway.sinks.mqtt.topics import Gateway, Topics

QOS = 1


@dataclass(frozen=True, slots=True)
class Entity:
    """One row: a key of Home Assistant's, its platform, and the field of the state payload that it shows."""

    key: str
    platform: str  # sensor or binary_sensor
    name: str
    shows: str  # field of StatePayload, dotted
    options: dict[str, Any] = field(default_factory=dict)


def _measured(unit: str, digits: int, device_class: str | None = None) -> dict[str, Any]:
    found: dict[str, Any] = {
        "unit_of_measurement": unit,
        "state_class": "measurement",
        "suggested_display_precision": digits,
    }
    return found | ({"device_class": device_class} if device_class else {})


def _named(names: list[str]) -> dict[str, Any]:
    return {"device_class": "enum", "options": names}


_DIAGNOSTIC = {"entity_category": "diagnostic"}
_QUALITIES = _named([quality.name for quality in Quality])

ENTITIES: tuple[Entity, ...] = (
    Entity("stop", "binary_sensor", "Stop", "stop", {"device_class": "safety", "icon": "mdi:hand-back-left"}),
    Entity("may_move", "binary_sensor", "Truck may move", "may_move", {"icon": "mdi:truck-fast-outline"}),
    Entity("in_place", "binary_sensor", "Truck in place", "in_place", {"icon": "mdi:map-marker-check"}),
    Entity("held", "binary_sensor", "Held by the ranger alone", "held", {"icon": "mdi:eye-off-outline"}),
    Entity("moved", "sensor", "Truck moved", "moved", _named([moved.name for moved in Moved])),
    Entity("phase", "sensor", "Visit", "phase", _named([phase.name for phase in VisitPhase])),
    Entity("reason", "sensor", "Reason", "reason.name", _named([reason.name for reason in Reason])),
    Entity("reason_text", "sensor", "Reason in words", "reason.text", {"icon": "mdi:message-text"}),
    Entity("distance", "sensor", "Distance", "distance_mm", _measured("mm", 0, "distance")),
    Entity("radius", "sensor", "Marker radius", "radius_px", _measured("px", 1)),
    Entity("u", "sensor", "Marker u", "u", _measured("px", 1)),
    Entity("v", "sensor", "Marker v", "v", _measured("px", 1)),
    Entity("z_vision", "sensor", "Distance seen by the camera", "z_vision_mm", _measured("mm", 0, "distance")),
    Entity("confidence", "sensor", "Confidence", "confidence", _measured("", 2)),
    Entity("tracking", "sensor", "Tracking", "tracking", _named([tracking.name for tracking in Tracking])),
    Entity("vision", "sensor", "Camera", "vision.quality.name", _QUALITIES | _DIAGNOSTIC),
    Entity("range", "sensor", "Ranger", "range.quality.name", _QUALITIES | _DIAGNOSTIC),
    Entity("vision_rate", "sensor", "Camera rate", "rates.vision_hz", _measured("Hz", 1, "frequency") | _DIAGNOSTIC),
    Entity("range_rate", "sensor", "Ranger rate", "rates.range_hz", _measured("Hz", 1, "frequency") | _DIAGNOSTIC),
    Entity("latency", "sensor", "Camera latency", "rates.vision_latency_ms",
           _measured("ms", 1, "duration") | _DIAGNOSTIC),
)  # fmt: skip


def topic(prefix: str, topics: Topics, bay: str) -> str:
    """Where Home Assistant looks."""
    return f"{prefix}/device/{device_id(topics, bay)}/config"


def device_id(topics: Topics, bay: str) -> str:
    """A bay's name is unique in its line."""
    return "_".join(("loading", topics.site, *topics.levels, bay))


def discovery(gateway: Gateway, bay: str, stale_after_ms: int) -> bytes:
    """The message that makes the bay appear; to be retained."""
    device = device_id(gateway.topics, bay)
    expire_s = math.ceil(stale_after_ms / 1000)
    message = {
        "device": {
            "identifiers": [device],
            "name": f"Loading bay {bay}",
            "manufacturer": "PLC loading gateway",
            "model": "Loading bay",
            "sw_version": gateway.version,
            "suggested_area": gateway.topics.site,
        },
        "origin": {"name": "PLC loading gateway", "sw_version": gateway.version},
        "components": {entity.key: _component(entity, device, expire_s) for entity in ENTITIES},
        "state_topic": gateway.topics.state(bay),
        "availability": [
            {
                "topic": gateway.topics.status,
                "value_template": "{{ value_json.status }}",
                "payload_available": "online",
                "payload_not_available": "offline",
            }
        ],
        "qos": QOS,
    }
    return json.dumps(message, ensure_ascii=False, separators=(",", ":")).encode()


def _component(entity: Entity, device: str, expire_s: int) -> dict[str, Any]:
    value = f"value_json.{entity.shows}"
    if entity.platform == "binary_sensor":
        template = f"{{{{ 'ON' if {value} else 'OFF' }}}}"
    else:  # Home Assistant takes the word None for "unknown"
        template = f"{{{{ {value} if {value} is not none else none }}}}"
    options = {key: option for key, option in entity.options.items() if option != ""}
    return {
        "platform": entity.platform,
        "name": entity.name,
        "unique_id": f"{device}_{entity.key}",
        "value_template": template,
        "expire_after": expire_s,
        **options,
    }
