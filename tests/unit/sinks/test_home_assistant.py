"""Home Assistant's discovery messages, their templates rendered by the engine that Home Assistant uses."""

import json
from dataclasses import replace
from typing import Any

import jinja2

from gateway.sinks.mqtt import home_assistant, payloads
from gateway.sinks.mqtt.topics import Gateway, Topics
from tools import mqtt

GATEWAY = Gateway(Topics("loading", "site1", "gateway"), ("bay1", "bay2"), "1.2.3", "0" * 16)


def shown(state: dict[str, Any]) -> dict[str, str]:
    """What Home Assistant would show of a state, by entity."""
    message = json.loads(home_assistant.discovery(GATEWAY, "bay1", 2500))
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined)
    return {
        key: environment.from_string(component["value_template"]).render(value_json=state)
        for key, component in message["components"].items()
    }


def example() -> dict[str, Any]:
    state: dict[str, Any] = json.loads(payloads.encode(mqtt.examples()["state"]))
    return state


def test_every_entity_shows_its_field_of_a_real_state() -> None:
    state = example()
    found = shown(state)
    assert found["stop"] == "ON"
    assert found["may_move"] == "OFF"
    assert found["reason"] == "TARGET_REACHED"
    assert (found["distance"], found["radius"]) == ("296.5", "180.4")
    assert found["vision"] == found["range"] == "GOOD"
    assert found["z_vision"] == "None"  # null is shown as unknown


def test_a_blind_bay_shows_nothing_that_looks_good() -> None:
    state = example() | {"u": None, "v": None, "radius_px": None, "distance_mm": None, "confidence": None, "stop": True}
    found = shown(state)
    assert [found[key] for key in ("u", "v", "radius", "distance", "confidence")] == ["None"] * 5
    assert found["stop"] == "ON"


def test_a_dead_bay_never_looks_alive() -> None:
    message = json.loads(home_assistant.discovery(GATEWAY, "bay1", 2500))
    (availability,) = message["availability"]
    assert availability["topic"] == GATEWAY.topics.status
    template = jinja2.Environment().from_string(availability["value_template"])
    will = json.loads(payloads.encode(payloads.status_payload(GATEWAY, "connection lost")))
    assert template.render(value_json=will) == availability["payload_not_available"] == "offline"
    live = json.loads(payloads.encode(payloads.status_payload(GATEWAY, "running", 0)))
    assert template.render(value_json=live) == availability["payload_available"] == "online"
    assert {component["expire_after"] for component in message["components"].values()} == {3}


def test_values_of_an_enum_are_among_its_options_and_ids_are_unique() -> None:
    message = json.loads(home_assistant.discovery(GATEWAY, "bay1", 2500))
    found = shown(example())
    for key, component in message["components"].items():
        if component.get("device_class") == "enum":
            assert found[key] in component["options"]
    ids = [
        component["unique_id"]
        for bay in GATEWAY.bays
        for component in json.loads(home_assistant.discovery(GATEWAY, bay, 2500))["components"].values()
    ]
    assert len(set(ids)) == len(ids)


def test_where_home_assistant_looks() -> None:
    line = replace(GATEWAY.topics, levels=("north", "line2"))  # where another bay1 may be in line1
    assert home_assistant.device_id(line, "bay1") == "loading_site1_north_line2_bay1"
    assert (
        home_assistant.topic("homeassistant", GATEWAY.topics, "bay1")
        == "homeassistant/device/loading_site1_bay1/config"
    )
    assert json.loads(home_assistant.discovery(GATEWAY, "bay1", 2500))["state_topic"] == "loading/site1/bay1/state"
