"""Each value of a bay on a topic of its own, for unified namespaces and clients that read no JSON objects. Pure.

`<bay>/value/<path>`: the path of the field in the state payload, the JSON scalar as payload. What changed is published
at once, everything once a period. Nothing is retained: a value that a broker keeps for a gateway that is dead would
look like one of now.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any, get_args

from pydantic import BaseModel

from gateway.durations import NS_PER_S
from gateway.sinks.mqtt.messages import StatePayload
from gateway.sinks.mqtt.topics import MqttMessage, Topics

LEVEL = "value"
TIME = "timestamp_ms"  # the last one of what is published together
# The same in every message, or in one for people.
OMITTED = frozenset({"schema_version", "site", "bay", "instance", "seq", "timestamp", "status_topic", "stale_after_ms"})
# They change all the time and are no reason to publish by themselves.
PERIODIC = frozenset(
    {
        "heartbeat",
        "frame_id",
        "vision/age_ms",
        "range/age_ms",
        "plc/age_ms",
        "plc/writes",
        "in_place_ms",
        "held_ms",
        "beacon/latency_ms",
    }
)
PERIODIC_GROUPS = ("rates/", "counters/", "picture/", "exposure/")
OBJECTS = frozenset(  # that may be null: then they have no values
    name
    for name, field in StatePayload.model_fields.items()
    if any(isinstance(part, type) and issubclass(part, BaseModel) for part in get_args(field.annotation))
)


class ValueTopics:
    """One bay's. `period_s`: how often all values are published."""

    def __init__(self, topics: Topics, bay: str, period_s: float) -> None:
        self._prefix = topics.of(bay, LEVEL)
        self._period_ns = round(period_s * NS_PER_S)
        self._sent: dict[str, str] = {}
        self._all_ns: int | None = None  # when all were published last

    def messages(self, payload: BaseModel, now_ns: int) -> list[MqttMessage]:
        """What is to be published of this state. A value that is not there any more is null."""
        every = self._all_ns is None or now_ns - self._all_ns >= self._period_ns
        values = dict.fromkeys(self._sent, "null") | dict(_flat(payload.model_dump(mode="json")))
        time = values.pop(TIME)
        chosen = {
            path: value
            for path, value in values.items()
            if every or (value != self._sent.get(path) and not _is_periodic(path))
        }
        if every:
            self._all_ns = now_ns
        if not chosen:
            return []
        self._sent |= chosen
        return [
            MqttMessage(f"{self._prefix}/{path}", value.encode(), qos=0)
            for path, value in (chosen | {TIME: time}).items()
        ]


def _is_periodic(path: str) -> bool:
    return path in PERIODIC or path.startswith(PERIODIC_GROUPS)


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Path and JSON of each scalar; a list is one value."""
    for name, value in values.items():
        path = prefix + name
        if path in OMITTED or (value is None and path in OBJECTS):
            continue
        if isinstance(value, Mapping):
            yield from _flat(value, f"{path}/")
        else:
            yield path, json.dumps(value, ensure_ascii=False)
