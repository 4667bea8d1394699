"""One value, one topic: what changed at once, all of it once a period, and nothing that stays when the gateway dies."""

import json
from typing import Any

from gateway.config import MqttConfig
from gateway.sinks.mqtt.messages import StatePayload
from gateway.sinks.mqtt.topics import Topics
from gateway.sinks.mqtt.value_topics import ValueTopics
from tools import mqtt

S = 1_000_000_000
EXAMPLE = StatePayload.model_validate(mqtt.examples()["state"].model_dump())
PREFIX = "acme/works/packing/line2/bay1/value/"


def values(period_s: float = 5.0) -> ValueTopics:
    config = MqttConfig(url="mqtt://b", root="acme", area="packing", line="line2")
    return ValueTopics(Topics.of_config(config, "works", "gw"), "bay1", period_s)


def published(topics: ValueTopics, now_s: float, **change: Any) -> dict[str, Any]:
    found = topics.messages(EXAMPLE.model_copy(update={"timestamp_ms": round(1000 * now_s)} | change), round(now_s * S))
    assert {(message.retain, message.qos) for message in found} <= {(False, 0)}
    assert all(message.topic.startswith(PREFIX) for message in found)
    return {message.topic.removeprefix(PREFIX): json.loads(message.payload) for message in found}


def test_the_first_state_is_published_completely() -> None:
    found = published(values(), 1)
    state = EXAMPLE.model_dump(mode="json")
    assert found["stop"] is state["stop"]
    assert found["radius_px"] == state["radius_px"]
    assert found["reason/name"] == state["reason"]["name"]
    assert found["counters/frames"] == state["counters"]["frames"]
    assert found["ne107/active"] == list(state["ne107"]["active"])
    assert not {"site", "bay", "seq", "timestamp", "status_topic"} & set(found)
    assert list(found)[-1] == "timestamp_ms"


def test_then_only_what_has_changed_until_the_period_is_over() -> None:
    topics = values()
    everything = published(topics, 1)
    assert published(topics, 1.5) == {}
    assert published(topics, 2, stop=not EXAMPLE.stop) == {"stop": not EXAMPLE.stop, "timestamp_ms": 2000}
    assert published(topics, 2.5, stop=not EXAMPLE.stop, heartbeat=99, frame_id=7) == {}
    assert set(published(topics, 5.9, stop=not EXAMPLE.stop)) == set()
    again = published(topics, 6, stop=not EXAMPLE.stop, heartbeat=99)
    assert set(again) == set(everything)
    assert again["heartbeat"] == 99


def test_a_group_that_ends_is_null_and_not_left_as_it_was() -> None:
    topics = values()
    reading = {"u": 1.0, "v": 2.0, "radius_px": 3.0}
    predicted = StatePayload.model_validate(EXAMPLE.model_dump(mode="json") | {"predicted": reading}).predicted
    assert published(topics, 1, predicted=predicted)["predicted/u"] == 1.0
    ended = published(topics, 2, predicted=None)
    assert {path: value for path, value in ended.items() if path.startswith("predicted/")} == dict.fromkeys(
        ("predicted/u", "predicted/v", "predicted/radius_px")
    )
    assert published(topics, 3, predicted=predicted)["predicted/u"] == 1.0
    assert "predicted" not in published(topics, 9, predicted=None)  # a level, and no value


def test_a_value_that_becomes_unknown_is_null() -> None:
    topics = values()
    published(topics, 1, radius_px=150.0)
    assert published(topics, 2, radius_px=None)["radius_px"] is None
